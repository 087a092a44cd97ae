"""A hostile object store."""

import shutil

from attack import Attack
from case import Case, Setting
from judge import FAILED, INVALID, SUCCESS
from process import Limits
from program import Program, set_options
from recipes import Recipe
from store_faults import BODIES, LISTINGS
from store_server import Store

CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "SECRET-9b1e", "AWS_REGION": "us-east-1",
    "NO_PROXY": "*", "no_proxy": "*",
}
SECRET = CREDENTIALS["AWS_SECRET_ACCESS_KEY"]
STORE = ["data.store.timeout_seconds=1", "data.store.max_retries=1", "data.cache.disk_mib=0"]
ABSENT = "build kinegrad with the Cargo feature"
"""In the message of a build without buckets."""
TARGETS = ["manifest", "motion/", "audio_features/"]
"""Objects with a fault."""
MUST_FAIL = ["too short", "too long", "negative length", "bad chunk", "huge length", "nothing", "noise"]
"""Faults that no object survives."""
LIMITS = Limits(cpu=20, wall=60)


class Stores(Attack):
    """Datasets in `s3://`, `gs://` and `http://` whose server misbehaves."""

    name = "stores"
    weight = 3

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        folder = setting.shared / "bucket"
        shutil.rmtree(folder, ignore_errors=True)
        program = Program(setting.binary, setting.out, setting.environment())
        program.run("data", "synth", "--out", folder, "--phrases", 4, "--frames", 48)
        found = self.recipe_of_phrases(program, str(folder))
        self.units: list[tuple[str, str, str]] = []
        """Service, target, and the name of the fault."""
        if not found:
            return
        self.recipe, self.kind = found
        at_once = ["data.source=gs://bucket/x", "data.store.endpoint=http://127.0.0.1:1",
                   "data.store.anonymous=true", *STORE]
        asked = program.run("train", self.recipe.shortest, *set_options([self.kind, *at_once]))
        if ABSENT in asked.stderr:
            self.not_applicable = "the binary is built without buckets"
            return
        self.store = Store(folder)
        services = ["s3", "gs"]
        self.units = [(service, "list", name) for name in LISTINGS for service in services]
        self.units += [
            (service, target, name) for name in BODIES
            for target in ["list", *TARGETS] for service in [*services, "http"]
            if service != "http" or target == "manifest"
        ]

    def recipe_of_phrases(self, program: Program, folder: str) -> tuple[Recipe, str] | None:
        """A recipe that trains on the folder, and the setting of its kind of data."""
        for recipe in self.setting.recipes:
            for kind in program.choices(recipe.shortest, "data.kind"):
                if kind.startswith("synthetic"):
                    continue
                settings = [f"data.kind={kind}", f"data.source={folder}"]
                runs = ["--runs-dir", self.setting.shared / "bucket runs" / recipe.name / kind]
                if program.run("train", recipe.shortest, *set_options(settings), *runs).code == SUCCESS:
                    return recipe, settings[0]
        return None

    def total(self) -> int | None:
        """Every fault of every kind of request."""
        return len(self.units)

    def attack(self, case: Case) -> None:
        """Trains on a store with one fault."""
        # A stride that shares no factor with the number of units mixes the kinds.
        service, target, name = self.units[case.number * 37 % len(self.units)]
        case.label = f"{service} {target}, {name}"
        case.variables |= CREDENTIALS
        scene = f"c{case.number}"
        self.store.faults[scene] = (target, (LISTINGS | BODIES)[name] if target == "list" else BODIES[name])
        endpoint = self.store.endpoint
        source = {
            "s3": f"s3://bucket/{scene}", "gs": f"gs://bucket/{scene}",
            "http": f"{endpoint}/bucket/{scene}",
        }[service]
        settings = [self.kind, f"data.source={source}", *STORE]
        if service != "http":
            settings.append(f"data.store.endpoint={endpoint}")
        if service == "gs":
            settings.append("data.store.anonymous=true")
        config = f"shared/recipes/{self.recipe.name}/shortest.toml"
        ended = case.run("train", config, *set_options(settings), "--runs-dir", "runs", limits=LIMITS)
        case.counts["faults served"] += self.store.served.get(scene, 0)
        case.counts["not asked"] += scene not in self.store.served
        case.counts["taken"] += ended.code == SUCCESS
        if SECRET in ended.stdout + ended.stderr:
            case.wrong("secret shown", name, "the secret key is printed", "no key", ended)
        if ended.code in (FAILED, INVALID) and "bucket" not in ended.stderr:
            case.wrong("no reason", name, ended.stderr[:300], "the object by name", ended)
        if ended.code == SUCCESS and scene in self.store.served and name in MUST_FAIL:
            case.wrong("false success", name, "exit code 0", "1 or 2", ended)

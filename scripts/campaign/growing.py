"""Inputs of any size for the readers of arrays, datasets and runs."""

import io
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import seeds
from recipes import Recipe

Files = Callable[[int], dict[str, bytes]]


@dataclass(frozen=True)
class Reader:
    """A reader with inputs that grow."""

    name: str
    files: Files
    """The files of a size, in the folder `in`."""
    command: list[str]
    start: int = 64
    most: int = 1 << 24
    """Largest size."""


CHECK = ["check", "in/motion.npy"]
PREPARE = ["data", "prepare", "in/plan.toml", "--out", "out"]
INSPECT = ["data", "inspect", "in"]


def arrays() -> Iterator[Reader]:
    """Arrays and archives."""
    one = lambda content: {"motion.npy": content}
    yield Reader("npy frames", lambda n: one(seeds.npy((n, 25), seeds.phrase(n))), CHECK)
    yield Reader("npy axes", lambda n: one(seeds.npy((3000, *(1,) * n))), CHECK, 8, 8192)
    yield Reader("npy axes, Fortran order", lambda n: one(seeds.npy((3000, *(1,) * n), fortran=True)),
                 CHECK, 8, 8192)
    axes = lambda n: one(seeds.npy((1,) * n, fortran=True, version=2))
    yield Reader("npy axes of one, Fortran order", axes, CHECK, 8, 1 << 18)
    column = lambda n: one(seeds.npy((n, 25), seeds.phrase(n), "<f8", fortran=True))
    yield Reader("npy frames, Fortran order", column, CHECK)
    joints = lambda n: one(seeds.npy((4, n, 3)))
    yield Reader("npy joints", joints, ["view", "in/motion.npy", "--out", "out/page.html"])
    plan = seeds.PLAN.replace("motion.bvh", "motion.npz").replace('units = "cm"\nup = "y"\n', "")
    arrays_of = {
        "position.npy": seeds.npy((40, 3)),
        "quaternion.npy": seeds.npy((40, 4), [1.0, 0, 0, 0] * 40),
    }

    members = lambda n: stored({**arrays_of, **{f"x{k}.npy": b"" for k in range(n)}})
    yield Reader("npz members", lambda n: {"plan.toml": plan.encode(), "motion.npz": members(n)},
                 PREPARE)


def lists() -> Iterator[Reader]:
    """Texts and lists of a dataset of clips."""
    clip, ones = seeds.npy((44, 263)), seeds.npy((263,), [1.0] * 263)
    beside = {"new_joint_vecs/a.npy": clip, "Mean_abs_3d.npy": ones, "Std_abs_3d.npy": ones}
    caption = b"a person walks#a/DET person/NOUN walk/VERB#0.0#0.0\n"
    yield Reader("texts captions", lambda n: {
        **beside, "train.txt": b"a\n", "texts/a.txt": n * caption}, INSPECT)
    words = lambda n: caption.replace(b"walks", b"walks " * n)
    yield Reader("texts words", lambda n: {**beside, "train.txt": b"a\n", "texts/a.txt": words(n)}, INSPECT)
    names = lambda n: b"".join(b"%d\n" % k for k in range(n))
    yield Reader("list of clips", lambda n: {
        **beside, "train.txt": b"a\n" + names(n), "texts/a.txt": caption}, INSPECT)


def of_runs(recipes: list[Recipe]) -> Iterator[Reader]:
    """Files that a run reads or has."""
    if not recipes:
        return
    first = f"shared/recipes/{recipes[0].name}"
    config = (recipes[0].shortest).read_text()
    metrics = (recipes[0].reference / "metrics.jsonl").read_bytes()
    kept = {"run/config.toml": (recipes[0].reference / "config.toml").read_bytes()}
    yield Reader("metrics", lambda n: {**kept, "run/metrics.jsonl": n * metrics},
                 ["plot", "in/run", "--out", "out.svg"])
    yield Reader("runs", lambda n: {f"{k}/config.toml": config.encode() for k in range(n)}, ["runs", "in"],
                 8, 1024)
    for name, more in [("keys", lambda n: "".join(f"a{k}=1\n" for k in range(n))),
                       ("tables", lambda n: "".join(f"[t{k}]\n" for k in range(n))),
                       ("comments", lambda n: "# comment\n" * n)]:
        files = lambda n, more=more: {"config.toml": (more(n) + config).encode()}
        yield Reader(f"config {name}", files, ["config", "show", "in/config.toml"])
    identities = lambda n: {"ids.txt": b"".join(b"synthetic_%05d\n" % k for k in range(n))}
    train = ["train", f"{first}/shortest.toml", "--runs-dir", "runs"]
    yield Reader("ids", identities, [*train, "--set", "data.validation.ids_file=in/ids.txt"])
    stars = lambda n: {"ids.txt": b"s" + b"*0" * n + b"x\n"}
    yield Reader("ids stars", stars, [*train, "--set", "data.validation.ids_file=in/ids.txt"])
    arch = ["import", "in/weights.pt", "--arch", "gmd_trajectory", "--mean", "in/m.npy", "--std",
            "in/m.npy", "--out", "out"]
    ones = seeds.npy((263,), [1.0] * 263)
    for name, pickle in [("deep pickle", lambda n: b"\x80\x02" + b"]" * n + b"a" * (n - 1) + b"."),
                         ("wide pickle", lambda n: b"\x80\x02](" + b"K\x01" * n + b"e."),
                         ("pickle memo", lambda n: b"\x80\x02]" + b"q\x01h\x01a" * n + b".")]:
        yield Reader(name, lambda n, pickle=pickle: {
            "weights.pt": stored({"a/data.pkl": pickle(n), "a/version": b"3\n"}), "m.npy": ones}, arch)
    for recipe in [recipe for recipe in recipes if recipe.generates][:1]:
        sample = ["sample", f"shared/recipes/{recipe.name}/runs/small", "--steps", "1", "--out", "out"]
        entry = lambda k: f'"t{k}":{{"dtype":"F32","shape":[1],"data_offsets":[{4 * k},{4 * k + 4}]}}'
        header = lambda n: ("{" + ",".join(map(entry, range(n))) + "}").encode()
        yield Reader("tensors", lambda n: {"text.safetensors": (
            len(header(n)).to_bytes(8, "little") + header(n) + bytes(4 * n))},
            [*sample, "--text-embedding", "in/text.safetensors#t0"])


def stored(members: dict[str, bytes]) -> bytes:
    """A zip archive."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return file.getvalue()

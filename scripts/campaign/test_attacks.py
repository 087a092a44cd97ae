#!/usr/bin/env python3
"""Attacks find the faults of programs that have them: each stand-in program has one."""

import sys
import tempfile
import unittest
from pathlib import Path

import judge
import texts
from attack import Attack
from case import Case, Setting
from exporters import FAULTY, Exporters
from findings import Findings
from growth import Growth
from growing import Reader
from links import Links
from names import Names
from process import Ended
from recipes import Recipe
from store_faults import BODIES
from stores import Stores
from turns import Turns
from writers import Writers

HEAD = f"""#!{sys.executable}
import os, pathlib, sys, time, urllib.request
words = sys.argv[1:]
out = [words[n + 1] for n, word in enumerate(words[:-1]) if word in ('--out', '--mp4', '--bvh')]
option = [word.partition('=')[2] for word in words if word.startswith('--out=')]
def files(top):
    return [p for p in pathlib.Path(top).rglob('*') if p.is_file()] if os.path.isdir(top) else []
"""
READS_LINKS = """
for top in ('runs', 'set', 'top'):
    for path in files(top):
        print(path.read_bytes().decode(errors='replace'))
"""
WRITES_LINKS = """
for top in ('runs', 'set', 'top'):
    for path in files(top):
        with open(path, 'a') as file:
            file.write('x')
"""
WRITES_NAMES = """
for name in [*out, *option]:
    pathlib.Path('other.svg').write_text('<title>' + name + '</title>', errors='surrogateescape')
"""
QUADRATIC = """
size = len(pathlib.Path('in/file').read_bytes())
end = time.process_time() + (size / 1000) ** 2
while time.process_time() < end:
    pass
"""
HALF_FILM = "pathlib.Path(out[0]).write_text('half')\n"
MISREADS = """
if out and out[0].endswith('.bvh'):
    pathlib.Path(out[0]).write_text('OFFSET\\nMOTION\\nFrames: 1\\nFrame Time: 1\\n0 0 0\\n')
else:
    print(' song.wav | 9.99 | 9')
"""
PRINTS_KEY = "print(os.environ.get('AWS_SECRET_ACCESS_KEY'))\n"


class Faults(unittest.TestCase):
    """Every attack on a stand-in for the program."""

    def setUp(self) -> None:
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)
        self.top = Path(place.name)
        for name in ("work", "shared", "findings", "home"):
            (self.top / name).mkdir()

    def setting(self, program: str) -> Setting:
        """A setting with a stand-in, and one recipe with a run."""
        binary = self.top / "kinegrad"
        binary.write_text(HEAD + program)
        binary.chmod(0o755)
        findings = Findings(self.top / "findings", binary)
        setting = Setting(self.top, self.top, binary, 1, Turns(1), findings, lambda _: None)
        setting.memory = setting.work
        run = setting.shared / "recipes/one/runs/small"
        (run / "checkpoints").mkdir(parents=True)
        for name in ("config.toml", "metrics.jsonl", "checkpoints/best.json"):
            (run / name).write_text("{}\n")
        config = setting.shared / "recipes/one/shortest.toml"
        config.write_text("")
        setting.recipes = [Recipe("one", config, config, run, 0.1, {}, True)]
        for name in ("phrases", "walks", "set"):
            (setting.shared / "linked" / name).mkdir(parents=True)
        return setting

    def kinds(self, attack: Attack, cases: range) -> set[str]:
        """The kinds of faults that some cases find."""
        for number in cases:
            with Case(attack.setting, attack.name, number) as case:
                attack.attack(case)
        return {kind for _, kind, _ in attack.setting.findings.counts}

    def test_links_are_read(self) -> None:
        self.assertIn("secret shown", self.kinds(Scene(self.setting(READS_LINKS)), range(20)))

    def test_links_are_written_through(self) -> None:
        self.assertIn("outside changed", self.kinds(Scene(self.setting(WRITES_LINKS)), range(20)))

    def test_names(self) -> None:
        attack = Named(self.setting(WRITES_NAMES))
        self.assertLessEqual({"another name", "raw name"}, self.kinds(attack, range(120)))

    def test_growth(self) -> None:
        attack = Growth(self.setting(QUADRATIC))
        attack.readers = [Reader("file", lambda n: {"file": bytes(n)}, ["read"], 256, 2048)]
        self.assertIn("growth", self.kinds(attack, range(1)))

    def test_films(self) -> None:
        attack = Exporters(self.setting(HALF_FILM))
        found = self.kinds(attack, range(4 * list(FAULTY).index("exits") + 1))
        self.assertLessEqual({"half a film", "false success"}, found)

    def test_writers(self) -> None:
        self.assertLessEqual({"misread"}, self.kinds(Writers(self.setting(MISREADS)), range(40)))

    def test_stores(self) -> None:
        setting = self.setting(PRINTS_KEY)
        attack = Stores(setting)
        self.assertEqual(attack.total(), 0, "the stand-in names no kinds of data")
        attack.recipe, attack.kind, attack.units = setting.recipes[0], "x=1", [("s3", "list", "silence")]
        self.assertIn("silence", BODIES)
        attack.store = type("Store", (), {"faults": {}, "served": {}, "endpoint": "http://127.0.0.1:1"})
        self.assertIn("secret shown", self.kinds(attack, range(1)))

    def test_texts(self) -> None:
        ended = Ended(["check"], 2, "\x1b[31m", "error: " + "x" * 9000, 0, 0, 0, None, False, (True, False))
        found = {fault.kind for fault in judge.judged(ended, "a file", (2,), 1 << 30)}
        self.assertLessEqual({"control characters", "long message", "not text"}, found)
        (self.top / "table.csv").write_text("a,-1\n\"=1+1\",b\n")
        self.assertEqual([kind for kind, _ in texts.table_faults(self.top, 0)], ["formula"])
        self.assertIsNone(texts.formula("-1.5,+inf,a=b\n"))


class Scene(Links):
    """Links in runs only: a stand-in makes no datasets."""

    def attack(self, case: Case) -> None:
        """A run with a link."""
        self.scenes = [self.run_folder]
        super().attack(case)


class Named(Names):
    """Names of results only."""

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        self.kinds = [kind for kind in self.kinds if not hasattr(kind, "__self__")]


if __name__ == "__main__":
    unittest.main()

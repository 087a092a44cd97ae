"""The types that editors and type checkers see."""

import subprocess
import sys

from conftest import ROOT

PACKAGE = ROOT / "crates" / "python" / "python"


def checked(*arguments, cwd):
    done = subprocess.run(
        [sys.executable, "-m", *arguments], capture_output=True, text=True, cwd=cwd, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_stubs_are_those_of_the_module(tmp_path):
    checked("mypy.stubtest", "kinegrad", cwd=tmp_path)


def test_the_package_is_typed(tmp_path):
    checked("mypy", "--strict", "--cache-dir", tmp_path, PACKAGE / "kinegrad", cwd=tmp_path)


def test_users_see_the_types(tmp_path):
    (tmp_path / "user.py").write_text(
        "import kinegrad\n"
        "run = kinegrad.Run('runs/x')\n"
        "reveal_type(run.sample(count=2)[0].motion)\n"
        "run.sample(cuont=2)\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "user.py"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert "_32Bit" in done.stdout and 'argument "cuont"' in done.stdout, done.stdout


def test_everything_public_is_documented():
    import kinegrad

    for name in kinegrad.__all__:
        thing = getattr(kinegrad, name)
        if callable(thing):
            assert thing.__doc__, name
            for member, value in vars(thing).items() if isinstance(thing, type) else ():
                if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                    assert value.__doc__, f"{name}.{member}"

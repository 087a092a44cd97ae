"""A folder beside what a command works on, which it must not change, extend or show."""

import os
import shutil
from pathlib import Path

from case import Case
from judge import SUCCESS
from process import Ended, Limits

SECRET = "SECRET-4c1f0d"
"""Text that no output may contain."""
SENTINELS = {
    "text": f"{SECRET}\n".encode(),
    "settings": f'{SECRET} = "{SECRET}"\n'.encode(),
    "json": f'{{"{SECRET}": "{SECRET}", "step": 1}}\n'.encode(),
}
LIMITS = Limits(cpu=30, wall=15)


def outside_of(case: Case) -> Path:
    """The folder that no command may change or show."""
    return case.folder / "outside"


def put_outside(case: Case) -> None:
    """Creates the folder with its secrets."""
    outside = outside_of(case)
    (outside / "folder").mkdir(parents=True)
    for name, content in SENTINELS.items():
        (outside / name).write_bytes(content)
    (outside / "folder/file.npy").write_bytes(SENTINELS["text"])


def link(case: Case, path: Path) -> None:
    """Replaces a path by a link out of its folder: to a secret, to what it was, or to nothing."""
    outside = outside_of(case)
    kind = case.random.choice(["secret", "secret", "moved", "nothing", "folder"])
    target = {
        "secret": outside / case.random.choice(list(SENTINELS)),
        "moved": outside / f"moved {path.name}",
        "nothing": outside / "new",
        "folder": outside / "folder",
    }[kind]
    if kind == "moved" and path.exists() and not path.is_symlink():
        path.rename(target)
    elif path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    path.symlink_to(os.path.relpath(target, path.parent))
    case.counts[f"link to {kind}"] += 1
    case.history.append(f"# {path.relative_to(case.folder)}: a link to {target.name}")


def guarded(case: Case, command: list[str]) -> Ended:
    """Runs a command, which must not change, extend or show what is outside."""
    outside = outside_of(case)
    before = snapshot(outside)
    ended = case.run(*command, limits=LIMITS)
    after = snapshot(outside)
    for name in sorted(before.keys() | after.keys()):
        if before.get(name) != after.get(name):
            how = "is new" if name not in before else "is gone" if name not in after else "is changed"
            found = f"outside/{name} {how}"
            case.wrong("outside changed", command[0], found, "the same files", ended)
            break
    for stream, text in [("stdout", ended.stdout), ("stderr", ended.stderr)]:
        if SECRET in text:
            at = text.find(SECRET)
            found = f"{stream}: {text[max(at - 200, 0):at + 40]!r}"
            case.wrong("secret shown", f"{command[0]} {stream}", found, "no content", ended)
    files = sorted(all_files(case))
    if shown := [name for name in files if SECRET.encode() in (case.folder / name).read_bytes()]:
        case.wrong("secret copied", command[0], f"in {shown[0]}", "no content", ended)
    case.counts["taken"] += ended.code == SUCCESS
    return ended


def all_files(case: Case) -> set[str]:
    """The files that are no links, of the case's own folder but for `outside`."""
    found = set()
    for place, folders, names in os.walk(case.folder):
        if Path(place) == case.folder:
            folders[:] = [name for name in folders if name not in ("outside", "shared")]
        paths = [Path(place, name) for name in names]
        found |= {str(path.relative_to(case.folder)) for path in paths if not path.is_symlink()}
    return found


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """Every path below a folder with its bytes; none for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }

"""Paths and goals of any size."""

import math
from collections.abc import Callable, Iterator

import seeds
from growing import Reader


def paths() -> Iterator[Reader]:
    """Paths over the ground."""
    walk = [value for t in range(60) for j in range(22)
            for value in (0.02 * j, 0.05 * j, 0.05 * t + 0.01 * (j % 5))]
    joints = seeds.npy((60, 22, 3), walk)

    def reader(name: str, ending: str, text: Callable[[int], str], start: int = 64) -> Reader:
        command = ["warp", "in/joints.npy", "--path", f"in/path.{ending}", "--along", "own", "--out",
                   "out/warped"]
        command += ["--metres-per-unit", "0.01"] if ending == "svg" else []
        files = lambda n: {f"path.{ending}": text(n).encode(), "joints.npy": joints}
        return Reader(f"path, {name}", files, command, start)

    spot = lambda k: (0.1 * k, math.sin(0.1 * k))
    yield reader("csv", "csv", lambda n: "x,z\n" + "".join("%.3f,%.3f\n" % spot(k) for k in range(n)))
    points = lambda n: ",".join("[%.3f,%.3f]" % spot(k) for k in range(n))
    for more in ("", 'curve = "line"\n', "closed = true\n", 'parameterization = "chordal"\n'):
        yield reader(f"toml {more.strip()}", "toml", lambda n, more=more: f"{more}points=[{points(n)}]\n")
    drawing = lambda inner: f'<svg xmlns="http://www.w3.org/2000/svg">{inner}</svg>'
    for name, letters in [("lines", "l%.2f,%.2f"), ("curves", "c1,2,3,4,%.2f,%.2f"),
                          ("smooth curves", "t%.2f,%.2f"), ("arcs", "a3,3,0,0,1,%.2f,%.2f")]:
        line = lambda n, letters=letters: "M0,0" + "".join(letters % (1 + k % 7, k % 5) for k in range(n))
        yield reader(f"svg {name}", "svg", lambda n, line=line: drawing(f'<path d="{line(n)}"/>'))
    steps = lambda n: " ".join("%.2f,%.2f" % spot(k) for k in range(n))
    yield reader("svg polyline", "svg", lambda n: drawing(f'<polyline points="{steps(n)}"/>'))
    small = '<path d="M0,0l90,10l0,90"/>'
    yield reader("svg nested groups", "svg", lambda n: drawing("<g>" * n + small + "</g>" * n))
    yield reader("svg elements", "svg", lambda n: drawing("<rect/>" * n + small))
    yield reader("svg attributes", "svg", lambda n: drawing(
        "<g %s/>" % " ".join(f'a{k}="1"' for k in range(n)) + small))
    yield reader("svg comments", "svg", lambda n: drawing("<!--a-->" * n + small))


def goals() -> Iterator[Reader]:
    """Goals, drawn on the floor of a motion."""
    motion = seeds.npy((60, 25), seeds.phrase(60))
    round_ = lambda n: ",".join(
        "[%.4f,%.4f]" % (9 * math.cos(6.28 * k / n), 9 * math.sin(6.28 * k / n)) for k in range(n))
    discs = '[[obstacle]]\nkind="disc"\nx=%.2f\nz=2.0\nradius=0.01\n'
    one = '[[keyframe]]\nframe=9\nx=0.1\nz=0.4\n'
    for name, text in [
        ("polygon", lambda n: f'frames=60\n{one}[[obstacle]]\nkind="polygon"\nvertices=[{round_(n)}]\n'),
        ("polygons", lambda n: f"frames=60\n{one}" + n * (
            '[[obstacle]]\nkind="polygon"\nvertices=[[2.0,0.0],[3.0,0.0],[2.5,1.0]]\n')),
        ("discs", lambda n: f"frames=60\n{one}" + "".join(discs % (3 + 0.1 * k) for k in range(n))),
        ("keyframes", lambda n: f"frames={n}\n" + "".join(
            f"[[keyframe]]\nframe={k}\nx=0.1\nz={0.01 * k:.2f}\n" for k in range(n))),
        ("trajectory", lambda n: f"frames={n}\n[trajectory]\nfirst_frame=0\npoints=[" + ",".join(
            f"[0.0,{0.01 * k:.2f}]" for k in range(n)) + "]\n"),
        ("deep arrays", lambda n: f"frames=60\nx={'[' * n}{']' * n}\n"),
        ("deep keys", lambda n: f"frames=60\n{'a.' * n}b=1\n"),
        ("many keys", lambda n: "frames=60\n" + "".join(f"a{k}=1\n" for k in range(n))),
    ]:
        command = ["plot", "in/motion.npy", "--goal", "in/goal.toml", "--out", "out.svg"]
        files = lambda n, text=text: {"motion.npy": motion, "goal.toml": text(n).encode()}
        yield Reader(f"goal, {name}", files, command)

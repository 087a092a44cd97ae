"""Motion captures, plans and recordings of any size."""

import json
from collections.abc import Iterator

import seeds
from growing import PREPARE, Reader

VIEW = ["view", "in/motion.bvh", "--units", "cm", "--up", "y", "--glb", "out/motion.glb"]
FEATURES = ["audio", "features", "in/song.wav", "--out", "out"]
MATCH = ["match", "in/motion.bvh", "--out", "out.bvh"]


def captures() -> Iterator[Reader]:
    """Motion captures and plans."""
    take = seeds.PLAN[seeds.PLAN.index("[[take]]"):]
    head = seeds.PLAN[:seeds.PLAN.index("[[take]]")]
    yield Reader("bvh frames", lambda n: {"motion.bvh": seeds.bvh(n, spine=True)}, VIEW)
    yield Reader("bvh deep", lambda n: {"motion.bvh": tree(n, True)}, VIEW)
    yield Reader("bvh wide", lambda n: {"motion.bvh": tree(n, False)}, VIEW)
    yield Reader("bvh deep, checked", lambda n: {"motion.bvh": tree(n, True)},
                 ["check", "in/motion.bvh", "--units", "cm", "--up", "y"])
    written = ["view", "in/motion.bvh", "--units", "cm", "--up", "y", "--bvh", "out.bvh"]
    yield Reader("bvh deep, written", lambda n: {"motion.bvh": tree(n, True)}, written)
    ends = b" End Site\n {\n  OFFSET 0 10 0\n }\n"
    yield Reader("bvh end sites", lambda n: {"motion.bvh": seeds.bvh(9).replace(ends, n * ends)}, VIEW)
    blank = lambda n: {"motion.bvh": seeds.bvh(9).replace(b"MOTION", b" \n" * n + b"MOTION")}
    yield Reader("bvh blank lines", blank, VIEW)
    long = lambda n: {"motion.bvh": seeds.bvh(9).replace(b"Hips", b"H" * n)}
    yield Reader("bvh long name", long, VIEW)
    text = seeds.PLAN.replace("motion.bvh", "motion.c3d").replace('units = "cm"\nup = "y"\n', "").encode()
    for name, content in [("frames", lambda n: seeds.c3d(84, -0.1, n)),
                          ("analog", lambda n: seeds.c3d(84, -0.1, 80, n))]:
        yield Reader(f"c3d {name}", lambda n, content=content: {
            "plan.toml": text, "motion.c3d": content(n)}, PREPARE, 64, 1 << 15)
    takes = lambda n: head + "".join(take.replace('"one"', f'"t{k}"') for k in range(n))
    yield Reader("plan takes", lambda n: {"plan.toml": takes(n).encode()}, PREPARE)
    names = lambda n: seeds.PLAN.replace('["two_*"]', json.dumps([f"t{k}_*" for k in range(n)]))
    files = lambda n: {"plan.toml": names(n).encode(), "motion.bvh": seeds.bvh(40)}
    yield Reader("plan patterns", files, PREPARE)
    stars = lambda n: seeds.PLAN.replace("two_*", "o" + "*n*" * n + "x")
    files = lambda n: {"plan.toml": stars(n).encode(), "motion.bvh": seeds.bvh(40)}
    yield Reader("plan stars", files, PREPARE)
    beside = {"plan.toml": seeds.DANCES_PLAN.encode(), "motion.c3d": seeds.c3d(84, -0.1, 72),
              "song.wav": seeds.wav(22050, 1, 2, 2.0)}
    rows = lambda n: seeds.INTERVALS + "".join(f"motion,x{k},0,40\n" for k in range(n))
    yield Reader("dances intervals", lambda n: {
        **beside, "dances.json": seeds.DANCES.encode(), "intervals.csv": rows(n).encode()}, PREPARE)
    dance = json.loads(seeds.DANCES)[0]
    several = lambda n: json.dumps([{**dance, "dance_id": k} for k in range(n)])
    yield Reader("dances", lambda n: {
        **beside, "dances.json": several(n).encode(), "intervals.csv": b"a,b\n"}, PREPARE)
    for name, option, unit in [("parts", "--parts", seeds.PARTS), ("keyframes", "--keyframes", seeds.POSES)]:
        files = lambda n, unit=unit: {
            "motion.bvh": seeds.bvh(20, spine=True), "more.toml": (n * unit).encode()}
        yield Reader(f"match {name}", files, [*MATCH, option, "in/more.toml"])
    yield Reader("many motions", lambda n: {
        f"{k}.npy": seeds.npy((4, 25), seeds.phrase(4)) for k in range(n)}, ["check", "in"], 16, 4096)


def tree(joints: int, deep: bool) -> bytes:
    """A hierarchy of that many joints with two frames: a chain, or children of one root."""
    channels = " OFFSET 0 1 0\n CHANNELS 3 Zrotation Xrotation Yrotation\n"
    if deep:
        middle = "".join(f"JOINT j{k}\n{{\n{channels}" for k in range(joints)) + "}\n" * joints
    else:
        middle = "".join(f"JOINT j{k}\n{{\n{channels}}}\n" for k in range(joints))
    line = " ".join(["0"] * (6 + 3 * joints)) + "\n"
    return (
        "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition "
        f"Zrotation Xrotation Yrotation\n{middle}}}\nMOTION\nFrames: 2\nFrame Time: 0.0333333\n{line}{line}"
    ).encode()


def songs() -> Iterator[Reader]:
    """Recordings."""
    tone = seeds.wav(22050, 1, 2, 0.5)
    yield Reader("wav seconds", lambda n: {"song.wav": seeds.wav(22050, 1, 2, n / 64)}, FEATURES, 16, 2048)
    for name, chunk in [("chunks", b"LIST\x02\0\0\0ab"), ("odd chunks", b"LIST\x01\0\0\0a\0"),
                        ("empty chunks", b"junk\0\0\0\0"), ("formats", tone[12:36])]:
        yield Reader(f"wav {name}", lambda n, chunk=chunk: {
            "song.wav": tone[:12] + n * chunk + tone[12:]}, FEATURES)
        yield Reader(f"wav {name} behind", lambda n, chunk=chunk: {
            "song.wav": tone + n * chunk}, FEATURES)
    tag = lambda n: b"ID3\x03\0\0" + bytes([n >> 21 & 127, n >> 14 & 127, n >> 7 & 127, n & 127])
    yield Reader("mp3 tag", lambda n: {"song.wav": tag(n) + bytes(n)}, FEATURES)
    yield Reader("mp3 headers", lambda n: {"song.wav": b"\xff\xfb\x90\0" * n}, FEATURES)
    yield Reader("ogg pages", lambda n: {"song.wav": (b"OggS\0\2" + bytes(20) + b"\1\0") * n}, FEATURES)

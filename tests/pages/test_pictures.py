"""GIF and MP4 show what the page shows."""

import array
import base64
import subprocess

import pytest

from material import decoded, walk, write_npy

FIRST = "kinegrad.viewers[0]"
# Below the names, whose letters are of another font.
TOP = 28


def pictures(path, width, height):
    """RGB rows of the pictures of a GIF or a video."""
    words = ["ffmpeg", "-v", "error", "-i", str(path), "-fps_mode", "passthrough", "-f", "rawvideo",
             "-pix_fmt", "rgb24", "-"]
    data = subprocess.run(words, capture_output=True, check=True).stdout
    size = 3 * width * height
    rows = lambda frame: [[tuple(frame[at:at + 3]) for at in range(3 * width * y, 3 * width * (y + 1), 3)]
                          for y in range(height)]
    return [rows(data[at:at + size]) for at in range(0, len(data), size)]


def stage(page, width, height, frame):
    """RGB rows of the page's stage at a size and a frame."""
    picture = page.evaluate(f"""(() => {{
      const {{ style }} = {FIRST}.canvas;
      [style.width, style.height] = ["{width}px", "{height}px"];
      {FIRST}.resize();
      {FIRST}.seek({frame});
      return {FIRST}.canvas.toDataURL();
    }})()""")
    found = decoded(base64.b64decode(picture.split(",")[1]))
    assert found[:2] == (width, height)
    return found[2]


def silhouette(rows):
    return {(x, y) for y, row in enumerate(rows[TOP:]) for x, pixel in enumerate(row)
            if max(pixel) - min(pixel) > 60}


def must_agree(shown, drawn, what):
    a, b = silhouette(shown), silhouette(drawn)
    assert len(a) > 1000, what
    part = len(a & b) / len(a | b)
    pairs = [(p, q) for one, two in zip(shown[TOP:], drawn[TOP:], strict=True) for p, q in zip(one, two, strict=True)]
    # Shadows, grid and everything between the coloured pixels.
    off = sum(max(abs(i - j) for i, j in zip(p, q)) > 24 for p, q in pairs) / len(pairs)
    print(f"{what}: intersection over union {part:.3f}, {100 * off:.2f} % of pixels differ")
    assert part >= 0.9, what
    assert off < 0.02, what


@pytest.fixture(scope="module")
def materials(kinegrad, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    body = walk(60)
    giant = array.array("f", (2.1 * value for value in walk(60, seed=1)))
    write_npy(folder / "body.npy", (60, 22, 3), body)
    write_npy(folder / "giant.npy", (60, 22, 3), giant)
    (folder / "goal.toml").write_text(
        "frames = 60\n[[keyframe]]\nframe = 30\nx = 2.4\nz = 0.4\n[[keyframe]]\nframe = 59\nx = 2.3\nz = 0.8\n"
        '[[obstacle]]\nkind = "disc"\nx = 1.5\nz = 0.5\nradius = 0.3\n'
        '[[obstacle]]\nkind = "polygon"\nvertices = [[3.0, 0.0], [3.5, 0.0], [3.2, 0.6]]\n')
    kinegrad("data", "synth", "--out", "data", "--phrases", 1, "--frames", 90, cwd=folder)
    phrase = next((folder / "data" / "motion").rglob("trajectory.npy"))
    phrase.rename(folder / "phrase.npy")
    return folder


@pytest.mark.parametrize("words, size, rate", [
    (["body.npy"], (400, 360), 20),
    (["body.npy", "--goal", "goal.toml"], (400, 360), 20),
    (["phrase.npy"], (400, 360), 30),
    (["body.npy", "giant.npy"], (640, 340), 20),
])
def test_a_gif_shows_what_the_page_shows(kinegrad, show, materials, words, size, rate):
    kinegrad("view", *words, "--out", "page.html", "--gif", "page.gif", "--overwrite", cwd=materials)
    drawn = pictures(materials / "page.gif", *size)
    page = show(materials / "page.html", color_scheme="light")
    for picture in (0, 20, 38):
        # 20 pictures per second.
        frame = picture * rate // 20
        must_agree(stage(page, *size, frame), drawn[picture], f"{' '.join(words)}, picture {picture}")


def halved(rows):
    """The picture at half the size."""
    mean = lambda *pixels: tuple(sum(channel) // 4 for channel in zip(*pixels))
    return [[mean(a[x], a[x + 1], b[x], b[x + 1]) for x in range(0, len(a), 2)]
            for a, b in zip(rows[::2], rows[1::2])]


def test_a_video_shows_what_the_page_shows_at_twice_the_size(kinegrad, show, materials):
    kinegrad("view", "phrase.npy", "--out", "page.html", "--mp4", "page.mp4", "--overwrite", cwd=materials)
    drawn = pictures(materials / "page.mp4", 800, 720)
    page = show(materials / "page.html", color_scheme="light")
    must_agree(stage(page, 400, 360, 30), halved(drawn[30]), "video")

"""Source frames of a motion of `kinegrad match`, in a browser."""

import json

import pytest

from material import Capture

FIRST = "kinegrad.viewers[0]"


def colours(page, chart, places):
    """The colours of a chart's canvas at parts of its width and height, from a copy of it."""
    return page.evaluate(
        f"(places) => {{ const shown = document.querySelectorAll('.kg-chart canvas')[{chart}];"
        f"const copy = new OffscreenCanvas(shown.width, shown.height).getContext('2d', {{ willReadFrequently: true }});"
        f"copy.drawImage(shown, 0, 0);"
        f"const at = (part, size) => Math.min(size - 1, Math.round(part * size));"
        f"return places.map(([x, y]) => [...copy.getImageData(at(x, shown.width), at(y, shown.height), 1, 1).data]); }}",
        places)


def strong(pixel):
    return max(pixel[:3]) - min(pixel[:3]) > 50


@pytest.fixture(scope="module")
def matched(kinegrad, tmp_path_factory):
    folder = tmp_path_factory.mktemp("match")
    # At 60 frames a second: matched are 60 and 45 frames.
    Capture(120).write(folder / "one.bvh")
    Capture(90).write(folder / "two.bvh")
    kinegrad("match", "one.bvh", "two.bvh", "--out", "new.bvh", "--parts", "auto", "--seed", "2", cwd=folder)
    kinegrad("view", "new.bvh", "--units", "cm", "--up", "y", cwd=folder)
    return folder


def test_parts_and_examples_have_charts_with_cursors_that_follow(matched, show):
    record = json.loads((matched / "new.json").read_text())
    page = show(matched / "new.html")
    titles = page.locator("figcaption").all_text_contents()
    assert titles[:2] == ["source frame of each part", "source frames in the examples"]
    shown = page.evaluate(f"{FIRST}.scene.figures[0].origins")
    assert [part["name"] for part in shown["parts"]] == [part["name"] for part in record["parts"]]
    assert [part["runs"] for part in shown["parts"]] == [part["runs"] for part in record["parts"]]
    assert shown["examples"] == [{"name": "one", "frames": 60}, {"name": "two", "frames": 45}]
    # Every frame of every part has a colour, and so have its source frames in the examples.
    rows = len(record["parts"])
    assert all(map(strong, colours(page, 0, [[0.6, (row + 0.2) / rows] for row in range(rows)])))
    seen = [False] * 60
    for part in record["parts"]:
        for _, example, first, frames in part["runs"]:
            if example == 0:
                seen[first:first + frames] = [True] * frames
    clear = [frame for frame in range(5, 55) if len(set(seen[frame - 2:frame + 3])) == 1]
    found = colours(page, 1, [[(frame + 0.5) / 60, 0.08] for frame in clear])
    assert list(map(strong, found)) == [seen[frame] for frame in clear]
    # The cursor is at the source frame of the first part.
    for frame in (10, 150):
        page.evaluate(f"{FIRST}.seek({frame})")
        page.wait_for_timeout(100)
        start, example, first, _ = next(
            run for run in record["parts"][0]["runs"] if run[0] <= frame < run[0] + run[3])
        area = page.locator(".kg-area").nth(1).bounding_box()
        cursor = page.locator(".kg-cursor").nth(1).bounding_box()
        wanted = (first + frame - start) / 60
        assert (cursor["x"] - area["x"]) / area["width"] == pytest.approx(wanted, abs=0.02)
        assert (cursor["y"] - area["y"]) / area["height"] == pytest.approx(example / 2, abs=0.06)


def test_a_click_on_an_example_seeks_a_moment_that_shows_it(matched, show):
    record = json.loads((matched / "new.json").read_text())
    page = show(matched / "new.html")
    start, _, first, frames = max(
        (run for part in record["parts"] for run in part["runs"] if run[1] == 0), key=lambda run: run[3])
    area = page.locator(".kg-area").nth(1)
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    page.mouse.click(box["x"] + box["width"] * (first + frames / 2) / 60, box["y"] + 4)
    frame = page.evaluate(f"{FIRST}.frame")
    shows = [
        run[2] + frame - run[0]
        for part in record["parts"] for run in part["runs"] if run[1] == 0 and run[0] <= frame < run[0] + run[3]
    ]
    assert any(abs(found - (first + frames / 2)) <= 2 for found in shows)


def test_a_motion_without_its_record_has_none(matched, kinegrad, show):
    (matched / "new.bvh").rename(matched / "alone.bvh")
    kinegrad("view", "alone.bvh", "--units", "cm", "--up", "y", cwd=matched)
    page = show(matched / "alone.html")
    assert "source frames in the examples" not in page.locator("figcaption").all_text_contents()

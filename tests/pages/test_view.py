"""Pages of `kinegrad view`, in a browser."""

import array
import math
import time

import pytest

from material import Capture, decoded, read_npy, walk, write_npy, write_song

FIRST = "kinegrad.viewers[0]"


def coloured(page, columns=1):
    """Pixels with strong colours, for each of `columns` parts of the stage."""
    width, height, pixels = decoded(page.locator(".kg-stage").first.screenshot())
    parts = [set() for _ in range(columns)]
    # Below the labels, which have the figures' colours too.
    for y in range(40, height):
        for x in range(width):
            if max(pixels[y][x]) - min(pixels[y][x]) > 70:
                parts[min(columns - 1, x * columns // width)].add((x, y))
    return parts


def until(page, condition, seconds=8):
    """Waits for `condition`. Playwright's own function evaluates text in the page, which the policy
    forbids."""
    end = time.monotonic() + seconds
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(20)


def joints(page, figure, frame):
    return page.evaluate(f"{FIRST}.joints({figure}, {frame})")


def apart(a, b):
    return max(math.dist(p, q) for p, q in zip(a, b, strict=True))


@pytest.fixture(scope="session")
def phrase(kinegrad, tmp_path_factory):
    """A phrase with a song that it starts 1.5 s into."""
    folder = tmp_path_factory.mktemp("phrase")
    kinegrad("data", "synth", "--out", "data", "--phrases", 2, "--frames", 90, cwd=folder)
    motion = sorted((folder / "data/motion").glob("*/trajectory.npy"))[0]
    # Shorter than what it would be as uncompressed music, so that the file itself goes in.
    write_song(folder / "song.wav", 6)
    kinegrad("view", motion, "--audio", "song.wav", "--start", "1.5", "--out", "page.html", cwd=folder)
    return motion, folder / "page.html"


def test_a_goal_of_many_points_is_shown(phrase, show):
    page = show(phrase[1])
    x = page.evaluate(
        f"""() => {{
          const viewer = {FIRST};
          viewer.following = false;
          viewer.scene.floor.path = Array.from({{ length: 200000 }}, (_, i) => [i / 1000, 0]);
          return viewer.framing({{ figures: [0], ground: 0, width: 100, height: 100 }}).x;
        }}"""
    )
    assert 90 < x < 110


def test_a_phrase_moves_as_in_its_file_and_in_step_with_its_song(phrase, show):
    motion, path = phrase
    (frames, channels), values = read_npy(motion)
    page = show(path)
    assert page.evaluate(f"{FIRST}.frames") == frames
    for frame in (0, 17, frames - 1):
        place = list(values[frame * channels:frame * channels + 3])
        assert apart(joints(page, 0, frame), [place]) <= 1e-3
    page.evaluate(f"{FIRST}.seek(45)")
    # A seek moves the song along.
    assert page.evaluate(f"{FIRST}.audio.currentTime") == pytest.approx(3.0, abs=0.02)
    page.get_by_role("button", name="Play", exact=True).click()
    until(page, f"{FIRST}.frame > 50")
    for _ in range(5):
        page.wait_for_timeout(80)
        frame, song, moving = page.evaluate(
            f"new Promise((done) => requestAnimationFrame(() => done("
            f"[{FIRST}.frame, {FIRST}.audio.currentTime, !{FIRST}.audio.paused])))")
        assert moving
        behind = song - 1.5 - frame / 30
        # At the end of the loop the song restarts with the motion.
        assert abs(behind) < 0.12 or abs(abs(behind) - frames / 30) < 0.12
    page.get_by_role("button", name="Pause").click()
    assert page.evaluate(f"{FIRST}.audio.paused")


def test_beats_and_curves_are_shown_and_a_click_on_a_curve_seeks(phrase, show):
    page = show(phrase[1])
    beats = page.evaluate(f"{FIRST}.scene.song.beats")
    assert len(beats) >= 4
    titles = page.locator("figcaption").all_text_contents()
    assert "position (m)" in titles and "phase" in titles
    area = page.locator(".kg-area").nth(1)
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 30)
    frames = page.evaluate(f"{FIRST}.frames")
    assert page.evaluate(f"{FIRST}.frame") == pytest.approx(frames / 2, abs=1)
    cursor = page.locator(".kg-cursor").nth(1).bounding_box()
    assert cursor["x"] == pytest.approx(box["x"] + 0.5 * box["width"], abs=6)


def test_keys_step_seek_and_play(phrase, show):
    page = show(phrase[1])
    frame = lambda: page.evaluate(f"{FIRST}.frame")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert frame() == 2
    page.keyboard.press("Shift+ArrowRight")
    assert frame() == 12
    page.keyboard.press("ArrowLeft")
    assert frame() == 11
    page.keyboard.press("End")
    assert frame() == page.evaluate(f"{FIRST}.frames") - 1
    page.keyboard.press("Home")
    assert frame() == 0
    page.keyboard.press("ArrowUp")
    assert page.locator("select").input_value() == "1.5"
    page.keyboard.press("Space")
    until(page, f"{FIRST}.frame > 3")
    page.keyboard.press("Space")
    assert not page.evaluate(f"{FIRST}.playing")
    page.keyboard.press("l")
    assert page.get_by_role("button", name="Loop").get_attribute("aria-pressed") == "false"
    page.keyboard.press("m")
    assert page.evaluate(f"{FIRST}.audio.muted")
    # The slider has the focus: each key acts once.
    page.get_by_role("slider", name="Frame").focus()
    before = frame()
    page.keyboard.press("ArrowRight")
    assert frame() == before + 1


def test_without_a_loop_the_end_stops_and_speed_counts(phrase, show):
    page = show(phrase[1])
    page.keyboard.press("m")
    page.keyboard.press("l")
    page.locator("select").select_option("2")
    page.keyboard.press("Space")
    until(page, f"!{FIRST}.playing")
    assert page.evaluate(f"{FIRST}.frame") == page.evaluate(f"{FIRST}.frames") - 1


def test_narrow_screens_scroll_down_alone_and_every_control_has_a_name(phrase, show):
    page = show(phrase[1], width=360, height=700)
    wide = page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 360
    unnamed = page.evaluate("""[...document.querySelectorAll("button, select, input, canvas")].filter(
        (e) => !(e.getAttribute("aria-label") || e.textContent.trim() || e.ariaHidden)).length""")
    assert unnamed == 0


def test_dark_and_light_are_as_the_reader_likes(phrase, show):
    shade = "getComputedStyle(document.body).backgroundColor"
    light = show(phrase[1], color_scheme="light").evaluate(shade)
    dark = show(phrase[1], color_scheme="dark").evaluate(shade)
    assert light == "rgb(255, 255, 255)" and dark != light


def test_a_clip_with_a_goal_walks_over_key_frames_and_round_obstacles(kinegrad, show, tmp_path):
    # It rests for half a second before it moves.
    values = walk(60)
    for frame in range(1, 10):
        values[66 * frame:66 * (frame + 1)] = values[:66]
    write_npy(tmp_path / "walk.npy", (60, 22, 3), values)
    (tmp_path / "goal.toml").write_text(
        "frames = 60\n[[keyframe]]\nframe = 30\nx = 2.4\nz = 0.4\n[[keyframe]]\nframe = 59\nx = 2.3\nz = 0.8\n"
        '[[obstacle]]\nkind = "disc"\nx = 1.5\nz = 0.5\nradius = 0.3\n'
        '[[obstacle]]\nkind = "polygon"\nvertices = [[3.0, 0.0], [3.5, 0.0], [3.2, 0.6]]\n')
    kinegrad("view", "walk.npy", "--goal", "goal.toml", cwd=tmp_path)
    page = show(tmp_path / "walk.html")
    _, values = read_npy(tmp_path / "walk.npy")
    for frame in (0, 31, 59):
        rows = [list(values[3 * (frame * 22 + j):3 * (frame * 22 + j) + 3]) for j in range(22)]
        assert apart(joints(page, 0, frame), rows) <= 1e-3
    floor = page.evaluate(f"{FIRST}.scene.floor")
    assert [frame for frame, _ in floor["keyframes"]] == [30, 59]
    assert len(floor["obstacles"]) == 1 and len(floor["polygons"][0]) == 3
    red = lambda: sum(r > 150 and g < 130 and b < 130 for row in decoded(
        page.locator(".kg-stage").screenshot())[2] for r, g, b in row)
    assert red() > 100
    contacts = page.evaluate(f"{FIRST}.scene.figures[0].contacts.map((c) => c.ranges[0])")
    assert len(contacts) == 4
    assert all(start == 0 and 8 <= end <= 10 for start, end in contacts), contacts


def test_a_capture_of_66_joints_is_posed_as_its_angles_say(kinegrad, show, tmp_path):
    capture = Capture()
    assert len(capture.joints) >= 60
    capture.write(tmp_path / "capture.bvh")
    kinegrad("view", "capture.bvh", "--units", "cm", "--up", "y", cwd=tmp_path)
    page = show(tmp_path / "capture.html")
    for frame in (0, 13, 39):
        assert apart(joints(page, 0, frame), capture.positions(frame)) <= 1e-3
    page.evaluate(f"{FIRST}.seek(0)")
    page.wait_for_timeout(100)
    [before] = coloured(page)
    page.evaluate(f"{FIRST}.seek(20)")
    page.wait_for_timeout(100)
    [after] = coloured(page)
    # A body is visible and moves.
    assert len(before) > 800 and len(after) > 800
    assert len(before ^ after) > 0.3 * len(before)


def test_orbit_zoom_and_pan(kinegrad, show, tmp_path):
    write_npy(tmp_path / "walk.npy", (20, 22, 3), walk(20))
    kinegrad("view", "walk.npy", cwd=tmp_path)
    page = show(tmp_path / "walk.html")
    camera = lambda: page.evaluate(f"(({{ yaw, pitch, zoom, pan }}) => [yaw, pitch, zoom, ...pan])({FIRST}.camera)")
    start = camera()
    box = page.locator(".kg-stage canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag():
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y + 30)
        page.mouse.up()

    drag()
    turned = camera()
    assert turned[0] != start[0] and turned[1] > start[1] and turned[3:] == start[3:]
    page.mouse.wheel(0, -200)
    until(page, f"{FIRST}.camera.zoom < 0.95")
    page.keyboard.down("Shift")
    drag()
    page.keyboard.up("Shift")
    assert camera()[3:] != start[3:] and camera()[:2] == turned[:2]
    page.keyboard.press("r")
    assert camera() == start


def test_four_figures_fill_four_panes_or_one(kinegrad, show, tmp_path):
    for seed in range(4):
        write_npy(tmp_path / f"walk{seed}.npy", (40, 22, 3), walk(40, seed=seed))
    names = [f"walk{seed}.npy" for seed in range(4)]
    kinegrad("view", *names, "--out", "four.html", "--title", "Four", cwd=tmp_path)
    page = show(tmp_path / "four.html")
    page.wait_for_timeout(200)
    panes = page.evaluate(f"{FIRST}.panes().length")
    assert panes == 4
    assert all(len(part) > 300 for part in coloured(page, 4))
    page.get_by_role("button", name="Side by side").click()
    assert page.evaluate(f"{FIRST}.panes().length") == 1


def test_raw_output_stands_beside_what_was_made_of_it(kinegrad, show, tmp_path):
    for name in ("walk.npy", "walk.raw.npy"):
        write_npy(tmp_path / name, (10, 22, 3), walk(10))
    kinegrad("view", "walk.npy", "--raw", cwd=tmp_path)
    page = show(tmp_path / "walk.html")
    assert page.evaluate(f"{FIRST}.scene.figures.map((f) => f.name)") == ["walk", "walk.raw"]


def test_names_do_no_harm(kinegrad, show, tmp_path):
    name = "<img src=x onerror=alert(1)>&'\".npy"
    title = "</script></title><script>alert(2)</script>"
    write_npy(tmp_path / name, (5, 22, 3), walk(5))
    kinegrad("view", name, "--title", title, "--out", "page.html", cwd=tmp_path)
    page = show(tmp_path / "page.html")
    assert page.title() == title
    assert page.locator("h1").inner_text() == title
    assert page.locator("img").count() == 0
    assert page.evaluate(f"{FIRST}.scene.figures[0].name") == name[:-4]


def test_points_of_no_skeleton_and_paths_on_the_ground_are_shown(kinegrad, show, tmp_path):
    write_npy(tmp_path / "points.npy", (6, 5, 3), array.array("f", [0.1 * i for i in range(90)]))
    write_npy(tmp_path / "way.npy", (6, 2), array.array("f", [0.1 * i for i in range(12)]))
    kinegrad("view", "points.npy", "way.npy", "--fps", 10, "--out", "page.html", cwd=tmp_path)
    page = show(tmp_path / "page.html")
    assert joints(page, 0, 5)[4] == pytest.approx([8.7, 8.8, 8.9], abs=1e-3)
    assert joints(page, 1, 3)[0] == pytest.approx([0.6, 0.0, 0.7], abs=1e-3)


def test_thumbnails_move_while_they_are_seen(kinegrad, show, tmp_path):
    write_npy(tmp_path / "walk.npy", (60, 22, 3), walk(60))
    kinegrad("view", "walk.npy", cwd=tmp_path)
    page = (tmp_path / "walk.html").read_text()
    start, end = page.index('<section class="kg"'), page.index("</section>") + len("</section>")
    small = page[start:end].replace('class="kg"', 'class="kg kg-small"')
    below = '<div style="height: 3000px"></div>'
    (tmp_path / "small.html").write_text(page[:start] + 20 * small + below + small + page[end:])
    page = show(tmp_path / "small.html")
    until(page, f"{FIRST}.frame > 5")
    assert page.locator(".kg-chart, input, select").count() == 0
    last = "kinegrad.viewers[20]"
    assert page.evaluate(f"{last}.scene === undefined")
    page.locator("section").last.scroll_into_view_if_needed()
    until(page, f"{last}.frame > 3")
    page.wait_for_timeout(100)
    shown = page.evaluate(f"{FIRST}.frame")
    page.wait_for_timeout(300)
    assert page.evaluate(f"{FIRST}.frame") == shown


def test_long_motions_are_played_in_time(kinegrad, show, tmp_path):
    """20,000 frames of 22 joints, four times: the figure is printed, and judged by people."""
    for seed in range(4):
        write_npy(tmp_path / f"walk{seed}.npy", (20_000, 22, 3), walk(20_000, seed=seed))
    names = [f"walk{seed}.npy" for seed in range(4)]
    kinegrad("view", *names, "--out", "long.html", cwd=tmp_path)
    page = show(tmp_path / "long.html")
    page.evaluate(f"{FIRST}.play()")
    until(page, f"{FIRST}.frameTimes.length >= 120", 60)
    times = sorted(page.evaluate(f"{FIRST}.frameTimes"))
    size = (tmp_path / "long.html").stat().st_size
    print(f"\n20,000 frames x 22 joints x 4: median frame time {times[len(times) // 2]:.1f} ms, "
          f"95th percentile {times[len(times) * 95 // 100]:.1f} ms, page {size / 1e6:.1f} MB")
    # Every frame that is due is shown, however late.
    assert page.evaluate(f"{FIRST}.frame") > 20


def lift(values, by, scale=1.0):
    """Joints scaled, and higher by `by` metres."""
    lifted = array.array("f", (scale * value for value in values))
    for at in range(1, len(lifted), 3):
        lifted[at] += by
    return lifted


def spots(page):
    """For each pane its name, and the distance of its figure's joints from the pane's border at
    this frame."""
    return page.evaluate(f"""(() => {{
      const viewer = {FIRST};
      viewer.show();
      const panes = viewer.panes();
      const framings = viewer.framings(panes);
      return panes.map((pane, index) => {{
        const [target, distance] = framings[index];
        const view = viewer.camera.view(target, distance, pane);
        const places = pane.figures.flatMap((index) => viewer.joints(index, viewer.frameOf(index)));
        const along = (axis, place) => axis.reduce((sum, part, i) => sum + part * (place[i] - view.eye[i]), 0);
        const seenAt = places.map((place) => {{
          const far = along(view.ahead, place);
          return [view.x + (along(view.right, place) * view.scale) / far,
                  view.y - (along(view.up, place) * view.scale) / far];
        }});
        const [xs, ys] = [0, 1].map((axis) => seenAt.map((spot) => spot[axis]));
        return {{
          left: Math.min(...xs) - pane.x, right: pane.x + pane.width - Math.max(...xs),
          top: Math.min(...ys) - pane.y, bottom: pane.y + pane.height - Math.max(...ys),
          tall: (Math.max(...ys) - Math.min(...ys)) / pane.height, ground: pane.ground,
          scale: view.scale / view.far, floor: view.at[1] - pane.ground,
        }};
      }});
    }})()""")


def test_figures_of_any_size_and_height_are_seen_whole(kinegrad, show, tmp_path):
    body = walk(50)
    figures = {"plain": body, "high": lift(body, 5), "small_and_high": lift(body, 3, 0.3),
               "giant": lift(body, 0, 4), "floating": lift(body, 0.6)}
    for name, values in figures.items():
        write_npy(tmp_path / f"{name}.npy", (50, 22, 3), values)
    names = [f"{name}.npy" for name in figures]
    kinegrad("view", *names, "--out", "all.html", cwd=tmp_path)
    page = show(tmp_path / "all.html", width=1300, height=900)
    for following, fitted in ((False, False), (False, True), (True, False), (True, True)):
        page.evaluate(f"{FIRST}.following = {str(following).lower()}; {FIRST}.fitEach = {str(fitted).lower()}")
        for frame in (0, 20, 49):
            page.evaluate(f"{FIRST}.seek({frame})")
            seen_all = spots(page)
            for name, seen in zip(figures, seen_all, strict=True):
                assert min(seen[side] for side in ("left", "right", "top", "bottom")) > 0, (name, frame, seen)
                assert not (following and fitted) or seen["tall"] > 0.3, (name, frame, seen)
            # A metre is equally long in every pane, and every ground is equally low.
            for key in ("scale", "floor"):
                one = max(seen[key] for seen in seen_all) - min(seen[key] for seen in seen_all) < 1e-6
                assert one == (not fitted), (key, seen_all)
    # Only motions with another origin have their own ground; nothing is moved.
    grounds = [seen["ground"] for seen in spots(page)]
    lowest = min(figures["high"][1::3])
    assert grounds[0] == grounds[3] == grounds[4] == 0 and grounds[1] == pytest.approx(lowest, abs=1e-3)
    for index, (name, values) in enumerate(figures.items()):
        for frame in (0, 33):
            expected = [values[3 * (22 * frame + j):3 * (22 * frame + j) + 3] for j in range(22)]
            assert apart(joints(page, index, frame), expected) < 2e-3, name
    page.evaluate(f"{FIRST}.sideBySide = false")
    [seen] = spots(page)
    assert min(seen[side] for side in ("left", "right", "top", "bottom")) > 0, seen


def test_a_giant_is_as_much_larger_as_it_is(kinegrad, show, tmp_path):
    write_npy(tmp_path / "one.npy", (20, 22, 3), walk(20))
    write_npy(tmp_path / "two.npy", (20, 22, 3), lift(walk(20), 0, 2))
    kinegrad("view", "one.npy", "two.npy", "--out", "page.html", cwd=tmp_path)
    for width in (1280, 400):
        page = show(tmp_path / "page.html", width=width)
        one, two = spots(page)
        assert one["tall"] / two["tall"] == pytest.approx(0.5, abs=0.1)
        page.get_by_role("button", name="Fit each").click()
        one, two = spots(page)
        assert one["tall"] / two["tall"] == pytest.approx(1, abs=0.1)
        page.keyboard.press("e")
        one, two = spots(page)
        assert one["tall"] / two["tall"] == pytest.approx(0.5, abs=0.1)


def test_contacts_name_their_figure_and_joint(kinegrad, show, tmp_path):
    for name in ("one", "two"):
        write_npy(tmp_path / f"{name}.npy", (20, 22, 3), walk(20))
    kinegrad("view", "one.npy", "two.npy", "--out", "page.html", cwd=tmp_path)
    kinegrad("view", "one.npy", cwd=tmp_path)
    labels = f"{FIRST}.charts[0].rows.map(({{ label }}) => label)"
    assert show(tmp_path / "page.html").evaluate(labels)[::4] == ["one: left_ankle", "two: left_ankle"]
    assert show(tmp_path / "one.html").evaluate(labels)[0] == "left_ankle"
    # Names stand beside the bars of their rows.
    for width in (1280, 400):
        page = show(tmp_path / "page.html", width=width)
        area = page.locator(".kg-rows .kg-area").bounding_box()
        assert area["width"] > 150
        names = [name.bounding_box() for name in page.locator(".kg-names li").all()]
        assert len(names) == 8
        for row, name in enumerate(names):
            assert name["x"] + name["width"] <= area["x"]
            middle = area["y"] + area["height"] * (row + 0.5) / 8
            assert name["y"] + name["height"] / 2 == pytest.approx(middle, abs=3)


def test_curves_of_a_long_motion_show_a_window_around_the_cursor(kinegrad, show, tmp_path):
    frames = 1600
    write_npy(tmp_path / "long.npy", (frames, 22, 3), walk(frames))
    kinegrad("view", "long.npy", cwd=tmp_path)
    page = show(tmp_path / "long.html")
    within = f"{FIRST}.scene.range"
    assert page.evaluate(within) == [0, 10]
    page.evaluate(f"{FIRST}.seek(600)")
    start, end = page.evaluate(within)
    assert (start, end) == (pytest.approx(25), pytest.approx(35))
    area = page.locator(".kg-area").nth(1)
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    cursor = lambda: page.locator(".kg-cursor").nth(1).bounding_box()["x"]
    assert cursor() == pytest.approx(box["x"] + box["width"] / 2, abs=3)
    # The window stands still while it is dragged in.
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 30)
    page.mouse.down()
    assert page.evaluate(f"{FIRST}.time") == pytest.approx(27.5, abs=0.1)
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 30, steps=5)
    assert page.evaluate(f"{FIRST}.time") == pytest.approx(32.5, abs=0.1)
    assert page.evaluate(within) == [start, end]
    page.mouse.up()
    until(page, f"{within}[0] > 27")
    page.get_by_role("button", name="Curves over the whole length").click()
    until(page, f"{within}[1] === {frames / 20}")
    assert cursor() == pytest.approx(box["x"] + box["width"] * 32.5 / 80, abs=4)


def test_sixteen_figures_have_curves_that_are_told_apart(kinegrad, show, tmp_path):
    for seed in range(16):
        write_npy(tmp_path / f"walk{seed:02}.npy", (20, 22, 3), walk(20, seed=seed))
    kinegrad("view", ".", "--out", "page.html", cwd=tmp_path)
    page = show(tmp_path / "page.html")
    charts = page.evaluate(f"""{FIRST}.charts.filter(({{ lines }}) => lines.length).map((chart) => ({{
      looks: chart.lines.map((line) => chart.look(line)), names: chart.names.length,
      legend: [...chart.element.querySelectorAll(".kg-legend line")].map((line) => [
        line.getAttribute("stroke"), line.getAttribute("stroke-dasharray")]),
    }}))""")
    assert charts
    for chart in charts:
        looks = [(look["colour"], tuple(look["dash"])) for look in chart["looks"]]
        assert len(set(looks)) == len(looks) >= 16
        strokes = [(colour, tuple(map(int, dash.split()))) for colour, dash in chart["legend"]]
        if chart["names"] == 1:
            assert strokes == looks
        else:
            assert {colour for colour, _ in looks} <= {colour for colour, _ in strokes}
    colours = sorted({look["colour"] for look in charts[0]["looks"]})
    assert len(colours) == 16
    parts = [[int(colour[at:at + 2], 16) for at in (1, 3, 5)] for colour in colours]
    for i, a in enumerate(parts):
        assert all(math.dist(a, b) > 40 for b in parts[:i]), colours[i]

"""The page of `kinegrad report` in a browser."""

import shutil
from pathlib import Path

import pytest

CONFIG = Path(__file__).parents[2] / "configs" / "quickstart.toml"
STEPS = 80


@pytest.fixture(scope="module")
def report(kinegrad, tmp_path_factory):
    """A run with previews, its page, and the page of one preview."""
    folder = tmp_path_factory.mktemp("report")
    settings = {
        "train.max_steps": STEPS,
        "validation.every_steps": 20,
        "sampling.preview_every_steps": 40,
        "sampling.count_at_end": 2,
        "sampling.sampler.num_inference_steps": 4,
    }
    overrides = [f"--set={key}={value}" for key, value in settings.items()]
    run = folder / "runs" / "quickstart"
    kinegrad("train", CONFIG, *overrides, cwd=folder)
    kinegrad("report", run, cwd=folder)
    return run / "report.html", run / "previews" / "step-00000040.html"


@pytest.fixture
def opened(browser):
    """Opens a page and fails if it logs an error or requests another resource."""
    problems, contexts = [], []

    def open_page(path, width=1280, colors="light"):
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=colors, offline=True
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: problems.append(message.text))
        page.on("pageerror", lambda error: problems.append(str(error)))
        requests = []
        page.on("request", lambda request: requests.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_load_state("load")
        outside = [url for url in requests if not url.startswith(("file:", "data:", "blob:"))]
        assert outside == []
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert problems == []


def test_sections_and_charts_are_there(report, opened):
    page = opened(report[0])
    assert page.locator("h1").inner_text() == "quickstart"
    assert page.locator(".pill").inner_text() == "finished"
    titles = page.locator("main > section > h2").all_inner_texts()
    assert titles[:2] == ["Training", "Samples"]
    assert titles[-1] == "Config"
    charts = page.locator("figure.chart")
    assert charts.count() >= 4
    # Every curve is within its picture.
    for box in page.evaluate(
        """() => [...document.querySelectorAll("figure.chart polyline")].map(line => {
            const own = line.getBBox(), view = line.ownerSVGElement.viewBox.baseVal;
            return [own.x, own.y, view.width - own.x - own.width, view.height - own.y - own.height];
        })"""
    ):
        assert min(box) >= 0, box
    assert "684,188" in page.locator(".highlights").inner_text()
    rows = page.locator("section:has(h2:text-is('Samples')) tbody tr")
    assert rows.count() == 2


def test_links_lead_to_sections_and_the_config_unfolds(report, opened):
    page = opened(report[0])
    for link in page.locator("nav a").all():
        target = page.locator(link.get_attribute("href"))
        assert target.locator("h2").first.inner_text() == link.inner_text()
    source = page.locator("details pre").last
    assert not source.is_visible()
    page.locator("details summary").last.click()
    assert f"max_steps = {STEPS}" in source.inner_text()


@pytest.mark.parametrize("width", [360, 768, 1600])
@pytest.mark.parametrize("colors", ["light", "dark"])
def test_no_screen_is_too_narrow(report, opened, width, colors):
    page = opened(report[0], width, colors)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    back, ink = page.evaluate(
        "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]"
    )
    bright = [sum(map(int, color[4:-1].split(","))) > 382 for color in (back, ink)]
    assert bright == [colors == "light", colors == "dark"]


def test_a_preview_is_a_page(report, opened):
    page = opened(report[1])
    assert "step 40" in page.title() or "synthetic_" in page.content()


@pytest.fixture(scope="module")
def watched(kinegrad, report, tmp_path_factory):
    """The page of the same run without its samples."""
    run = tmp_path_factory.mktemp("watched") / "quickstart"
    shutil.copytree(report[0].parent, run)
    shutil.rmtree(run / "samples")
    kinegrad("report", run, cwd=run.parent)
    return run / "report.html"


def test_previews_move_where_there_are_no_samples(watched, opened):
    page = opened(watched)
    titles = page.locator("main > section > h2").all_inner_texts()
    assert titles[:2] == ["Training", "Previews"]
    assert page.locator(".kg-small").count() == 2
    page.locator(".kg-small").first.scroll_into_view_if_needed()
    # The policy of the page forbids the polling of wait_for_function.
    seen = set()
    for _ in range(50):
        page.wait_for_timeout(100)
        seen.add(page.evaluate("kinegrad.viewers[0].frame"))
    assert len(seen) > 5, seen
    assert page.evaluate("kinegrad.viewers.map(viewer => viewer.frames > 1)") == [True] * 2


def test_what_samples_fail_is_read_on_a_narrow_screen(kinegrad, tmp_path, opened):
    # An untrained network does not move.
    settings = ["--set=train.max_steps=1", "--set=sampling.count_at_end=2"]
    kinegrad("train", CONFIG, *settings, cwd=tmp_path)
    kinegrad("report", tmp_path / "runs" / "quickstart", cwd=tmp_path)
    page = opened(tmp_path / "runs" / "quickstart" / "report.html", 400)
    words = page.locator("section:has(h2:text-is('Samples')) td.words")
    assert words.count() == 2
    table = page.locator("section:has(h2:text-is('Samples')) .tables").bounding_box()
    for cell in words.all():
        box = cell.bounding_box()
        assert box["width"] > 300
        assert box["x"] + box["width"] <= table["x"] + table["width"] + 1


def test_two_runs_fit_on_a_narrow_screen(kinegrad, report, opened, tmp_path):
    run = report[0].parent
    shutil.copytree(run, tmp_path / "another", ignore=shutil.ignore_patterns("report.html"))
    kinegrad("report", run, "another", "--out", "both.html", cwd=tmp_path)
    page = opened(tmp_path / "both.html", width=400)
    assert page.locator("h1").inner_text() == "quickstart, another"
    cut = "[...document.querySelectorAll('.tables')].filter((box) => box.scrollWidth > box.clientWidth).length"
    assert page.evaluate(cut) == 0
    # Labels of charts are at least 10 pixels high.
    sizes = """[...document.querySelectorAll('.chart text')].map((text) =>
        parseFloat(getComputedStyle(text).fontSize) * text.ownerSVGElement.getScreenCTM().a)"""
    assert min(page.evaluate(sizes)) >= 10

"""The browser, the binary, and pages that must load no resources and log no errors."""

import os
import shutil
import subprocess

import pytest
from playwright.sync_api import sync_playwright


@pytest.fixture(scope="session")
def browser():
    path = shutil.which("chromium")
    assert path, "the tests of pages need Debian's chromium: apt-get install chromium"
    arguments = ["--autoplay-policy=no-user-gesture-required", "--no-sandbox"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=arguments)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def kinegrad():
    binary = os.environ["KINEGRAD_BINARY"]

    def run(*arguments, cwd):
        done = subprocess.run([binary, *map(str, arguments)], cwd=cwd, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture
def show(browser):
    """Opens a page and waits for its viewers; afterwards nothing may have gone wrong."""
    contexts, complaints, requests = [], [], []

    def open_page(path, width=1100, height=900, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.on("dialog", lambda dialog: (complaints.append(dialog.message), dialog.dismiss()))
        page.goto(path.as_uri())
        page.evaluate("Promise.all(kinegrad.viewers.filter((v) => !v.small).map((v) => v.ready))")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in requests), requests

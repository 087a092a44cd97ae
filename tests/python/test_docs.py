"""The Python of the documentation runs, on tiny data."""

import re

import nbclient
import nbformat
import pytest

from conftest import PHRASES, ROOT

PAGES = [
    page
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    if "```python\nimport kinegrad" in page.read_text()
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with a config that trains in a second, in place of the quickstart."""
    text = PHRASES.replace('name = "phrases"', 'name = "quickstart"')
    (tmp_path / "kinegrad.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", ["README.md", "docs/python.md"])
def test_pages_with_python_are_found(page):
    assert ROOT / page in PAGES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_run(page, folder):
    blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    names = {}
    for block in blocks:
        exec(compile(block, str(page), "exec"), names)
    assert list((folder / "runs").iterdir())


def test_the_notebook_runs(folder):
    notebook = nbformat.read(ROOT / "docs" / "python.ipynb", as_version=4)
    nbformat.validate(notebook)
    client = nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3")
    client.execute(cwd=str(folder))
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) > 5 and all(cell.execution_count for cell in code)
    shown = [output for cell in code for output in cell.outputs]
    assert not [output for output in shown if output.output_type == "error"]
    assert shown

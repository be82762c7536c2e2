"""The notebooks run from top to bottom."""

import re

import nbformat
import pytest
from snippets import DOCS

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.filterwarnings("ignore")  # of IPython's own machinery
@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(path, monkeypatch):
    """In this process: `make_notebooks.py` starts a kernel for each, which takes seconds."""
    shell = pytest.importorskip("IPython.core.interactiveshell", reason="needs the extra 'docs'").InteractiveShell()
    monkeypatch.chdir(path.parent)
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code":
            shell.run_cell(cell.source).raise_error()


def test_every_tutorial_that_works_in_python_has_a_notebook_and_links_to_it():
    """Those of ten minutes are done with commands, which no notebook shows better."""
    pages = [path for path in sorted((DOCS / "tutorials").glob("*.md")) if "# Ten minutes" not in path.read_text()]
    assert [path.stem for path in NOTEBOOKS] == [path.stem for path in pages]
    for page, notebook in zip(pages, NOTEBOOKS, strict=True):
        assert f"../notebooks/{notebook.name}" in page.read_text()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_uses_only_what_the_packages_offer_in_front(path):
    text = path.read_text()
    assert "import calib" in text
    assert not re.findall(r"from (?:calib|viz)\.|import (?:calib|viz)\.", text)

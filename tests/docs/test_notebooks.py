"""The notebooks run from top to bottom."""

import re

import pytest
from snippets import DOCS

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.filterwarnings("ignore")  # of the kernel's own machinery
@pytest.mark.amount(0, len(NOTEBOOKS))
def test_notebooks_run(amount):
    """Only in `make test-thorough`: tests/docs/test_snippets.py runs the pages of which they are made."""
    pytest.importorskip("ipykernel", reason="needs the extra 'docs'")
    pytest.importorskip("nbclient", reason="needs the extra 'docs'")
    from make_notebooks import run

    for path in (*NOTEBOOKS[1:], NOTEBOOKS[0])[:amount]:
        run(path)


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

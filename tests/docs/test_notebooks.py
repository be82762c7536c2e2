"""The notebooks run from top to bottom."""

import pytest
from snippets import DOCS

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.filterwarnings("ignore")  # of the kernel's own machinery
@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(path):
    pytest.importorskip("ipykernel", reason="needs the extra 'docs'")
    pytest.importorskip("nbclient", reason="needs the extra 'docs'")
    from make_notebooks import run

    run(path)


def test_every_tutorial_with_a_notebook_links_to_it():
    assert len(NOTEBOOKS) >= 3
    for path in NOTEBOOKS:
        page = (DOCS / "tutorials" / f"{path.stem}.md").read_text()
        assert f"../notebooks/{path.name}" in page

"""Parts of the site. `make docs` builds the whole with warnings as errors, in continuous integration."""

import re

import pytest
import yaml
from snippets import DOCS, ROOT

from calib.core.robots.description import BaseSection, Description, OriginSection, TargetSection


@pytest.fixture
def formulas():
    pytest.importorskip("latex2mathml", reason="needs the extra 'docs'")
    import formulas

    return formulas


def test_formulas_become_mathml(formulas):
    html = formulas.to_mathml(r'<p><span class="arithmatex">\(a &lt; b\)</span></p>', "page")
    assert html.startswith("<p><math")
    assert "&#x0003C;" in html or "&lt;" in html


def test_a_formula_that_cannot_be_read_names_its_page(formulas):
    with pytest.raises(ValueError, match=r"page\.md: formula .* cannot be converted"):
        formulas.to_mathml(r'<span class="arithmatex">\(\left( a\)</span>', "page.md")


def test_columns_of_a_formula_are_refused_where_they_would_be_printed_as_they_are_written(formulas):
    for environment, refused in (("aligned", True), ("bmatrix", False)):
        latex = rf"\begin{{{environment}}} a &amp; b \end{{{environment}}}"
        html = rf'<span class="arithmatex">\({latex}\)</span>'
        if refused:
            with pytest.raises(ValueError, match="has columns"):
                formulas.to_mathml(html, "page.md")
        else:
            assert "<mtable" in formulas.to_mathml(html, "page.md")


def test_every_table_of_a_page_has_a_header_and_stands_apart():
    """Text right above a table would swallow it."""
    for page in (*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"):
        lines = page.read_text().splitlines()
        for before, line, after in zip(["", *lines], lines, [*lines[1:], ""], strict=False):
            if line.startswith("|") and not before.startswith("|"):
                assert re.fullmatch(r"[|:\- ]+", after), f"{page.name}: {line[:60]}"
                assert not before or before.startswith("<!--"), f"{page.name}: {line[:60]}"


def test_grouped_arguments_become_one_entry_each():
    griffe = pytest.importorskip("griffe", reason="needs the extra 'docs'")
    from grouped_names import split_groups

    text = "Do it.\n\nArgs:\n    low, high: Limits,\n        both [m].\n    other: More.\n"
    assert split_groups(text) == (
        "Do it.\n\nArgs:\n    low: Limits,\n        both [m].\n    high: Limits,\n        both [m].\n    other: More.\n"
    )
    assert griffe


def test_every_key_is_on_the_page_of_the_robot_description():
    page = (DOCS / "robot_description.md").read_text()
    for section in (Description, BaseSection, TargetSection, OriginSection):
        for key in section.model_fields:
            assert re.search(rf"`[^`]*\b{key}\b[^`]*`", page), f"{section.__name__}.{key}"


def test_every_page_is_in_the_navigation():
    text = (DOCS / "site" / "mkdocs.yml").read_text()
    for page in DOCS.rglob("*.md"):
        name = str(page.relative_to(DOCS))
        assert name.startswith(("examples/", "site/")) or f": {name}\n" in text, name


def test_the_search_works_from_disk_by_a_script_of_the_site():
    text = (DOCS / "site" / "mkdocs.yml").read_text()
    named = re.search(r"polyfills: \[(site/[\w.-]+)\]", text)[1]
    assert (DOCS / named).is_file()
    assert f"!/{named}\n" in text
    assert "iframe-worker" in named  # by this name the plugin sees that it need not ask another computer for one
    assert re.search(r"^  - offline\b", text, re.MULTILINE)


def test_the_citation_has_the_paper_in_full():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    paper = cited["references"][0]
    assert paper["doi"] == "10.1108/IR-09-2014-0396"
    assert [author["family-names"] for author in paper["authors"]] == ["Joubair", "Zhao", "Bigras", "Bonev"]
    assert (paper["volume"], paper["issue"], paper["start"], paper["end"], paper["year"]) == (42, 1, 44, 53, 2015)
    version = next(line for line in (ROOT / "pyproject.toml").read_text().splitlines() if line.startswith("version"))
    assert cited["version"] == version.split('"')[1]


def test_notebooks_become_pages_with_their_outputs_and_a_gallery_leads_to_them():
    nbformat = pytest.importorskip("nbformat", reason="needs the extra 'docs'")
    import notebook_pages

    made = notebook_pages.pages()
    for name in notebook_pages.names():
        notebook = nbformat.read(DOCS / "notebooks" / f"{name}.ipynb", as_version=4)
        page = made[f"notebooks/{name}.md"]
        outputs = [item for cell in notebook.cells for item in cell.get("outputs", ())]
        pictures = [output for output in outputs if "image/png" in output.get("data", {})]
        assert page.count("![Output](") == len(pictures) > 0
        assert all(f"notebooks/{name}-{k + 1}.png" in made for k in range(len(pictures)))
        assert next(output.text.splitlines()[0] for output in outputs if output.output_type == "stream") in page
        assert f"]({name}.md)" in made["notebooks/index.md"]


def test_a_notebook_shows_tables_and_leaves_out_empty_cells():
    pytest.importorskip("nbformat", reason="needs the extra 'docs'")
    import nbformat.v4 as made
    from notebook_pages import rendered

    table = made.new_output("display_data", data={"text/html": "<table></table>", "text/plain": "table"})
    cells = [made.new_markdown_cell("# Title\n\nText."), made.new_code_cell("1 + 1", outputs=[table])]
    text, pictures = rendered(made.new_notebook(cells=[*cells, made.new_code_cell("")]), "name")
    assert text.startswith("# Title\n\n[Download the notebook](name.ipynb)")
    assert "<table></table>" in text
    assert text.count("```python") == 1
    assert pictures == {}

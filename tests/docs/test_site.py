"""Parts of the site. `make docs` builds the whole with warnings as errors, in continuous integration."""

import pytest
import yaml
from snippets import DOCS, ROOT


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


def test_grouped_arguments_become_one_entry_each():
    griffe = pytest.importorskip("griffe", reason="needs the extra 'docs'")
    from grouped_names import split_groups

    text = "Do it.\n\nArgs:\n    low, high: Limits,\n        both [m].\n    other: More.\n"
    assert split_groups(text) == (
        "Do it.\n\nArgs:\n    low: Limits,\n        both [m].\n    high: Limits,\n        both [m].\n    other: More.\n"
    )
    assert griffe


def test_every_page_is_in_the_navigation():
    text = (DOCS / "site" / "mkdocs.yml").read_text()
    for page in DOCS.rglob("*.md"):
        name = str(page.relative_to(DOCS))
        assert name.startswith(("examples/", "site/")) or f": {name}\n" in text, name


def test_the_citation_has_the_paper_in_full():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    paper = cited["references"][0]
    assert paper["doi"] == "10.1108/IR-09-2014-0396"
    assert [author["family-names"] for author in paper["authors"]] == ["Joubair", "Zhao", "Bigras", "Bonev"]
    assert (paper["volume"], paper["issue"], paper["start"], paper["end"], paper["year"]) == (42, 1, 44, 53, 2015)
    version = next(line for line in (ROOT / "pyproject.toml").read_text().splitlines() if line.startswith("version"))
    assert cited["version"] == version.split('"')[1]

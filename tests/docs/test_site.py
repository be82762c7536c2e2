"""The site builds without a warning; its parts work alone."""

import subprocess
import sys

import formulas
import pytest
import yaml
from snippets import DOCS, ROOT


def test_the_site_builds_without_warnings(tmp_path):
    pytest.importorskip("mkdocs", reason="needs the extra 'docs'")
    pytest.importorskip("mkdocstrings", reason="needs the extra 'docs'")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-f", str(DOCS / "site" / "mkdocs.yml")]
    done = subprocess.run([*command, "-d", str(tmp_path)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "reference" / "api" / "calib.loops.html").is_file()
    assert "<math" in (tmp_path / "theory" / "jacobian.html").read_text()
    for page in tmp_path.rglob("*.html"):
        text = page.read_text()
        assert 'class="arithmatex"' not in text, f"{page.name}: a formula was not converted"
        assert '<script src="http' not in text, f"{page.name}: asks another computer for something"


def test_formulas_become_mathml():
    html = formulas.to_mathml(r'<p><span class="arithmatex">\(a &lt; b\)</span></p>', "page")
    assert html.startswith("<p><math")
    assert "&#x0003C;" in html or "&lt;" in html


def test_a_formula_that_cannot_be_read_names_its_page():
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


def test_the_citation_has_the_paper_in_full():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    paper = cited["references"][0]
    assert paper["doi"] == "10.1108/IR-09-2014-0396"
    assert [author["family-names"] for author in paper["authors"]] == ["Joubair", "Zhao", "Bigras", "Bonev"]
    assert (paper["volume"], paper["issue"], paper["start"], paper["end"], paper["year"]) == (42, 1, 44, 53, 2015)
    version = next(line for line in (ROOT / "pyproject.toml").read_text().splitlines() if line.startswith("version"))
    assert cited["version"] == version.split('"')[1]

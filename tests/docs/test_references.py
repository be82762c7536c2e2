"""Sources that docstrings and pages cite are in docs/references.md, under their keys."""

import ast
import re

from snippets import DOCS, ROOT

KEYS = set(re.findall(r'^\| <a id="(\w+)"></a>(?=\1 )', (DOCS / "references.md").read_text(), re.MULTILINE))
MODULES = [path for package in ("calib", "viz", "medrue") for path in sorted((ROOT / package).rglob("*.py"))]
KEY = re.compile(r"\b[a-z]+_?\d{3,4}\b|\bnist_strd\b")
AUTHOR_AND_YEAR = re.compile(r"\b([A-Z][a-z]+)\b[^;()\d]*?\s(\d{4})\b")


def cited(text):
    """Keys that the `Reference:` sentences of a docstring cite, also where it says `Mitchell 1974`."""
    for sentence in re.findall(r"References?: (.+?)(?:\n\s*\n|\Z)", text, re.DOTALL):
        plain = re.sub(r"\([^)]*\)", "", " ".join(sentence.split()))
        yield from KEY.findall(plain)
        for part in plain.split(";"):
            for author, year in AUTHOR_AND_YEAR.findall(part):
                yield f"{author.lower()}{year}"


def test_keys_are_unique_and_sorted():
    rows = re.findall(r'^\| <a id="(\w+)">', (DOCS / "references.md").read_text(), re.MULTILINE)
    assert len(rows) > 20
    assert rows == sorted(set(rows))


def test_sources_in_docstrings_are_in_the_references():
    unknown, n_cited = [], 0
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                keys = list(cited(ast.get_docstring(node) or ""))
                n_cited += len(keys)
                unknown += [f"{path.relative_to(ROOT)}: {key}" for key in keys if key not in KEYS]
    assert n_cited > 20
    assert unknown == []  # each must be a key of docs/references.md


def test_links_to_references_have_their_key():
    for page in DOCS.rglob("*.md"):
        for shown, key in re.findall(r"\[(\w+)\]\((?:\.\./)*references\.md#(\w+)\)", page.read_text()):
            assert key in KEYS, f"{page.relative_to(DOCS)}: {key}"
            assert shown == key

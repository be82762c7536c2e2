"""The Python reference has every public name once, and derivations that pages cite; examples in docstrings run."""

import doctest
import importlib

import api_reference
import pytest
from api_reference import PACKAGES, by_task, cited, navigation, pages
from snippets import ROOT

WITH_EXAMPLES = [
    name for package in PACKAGES for name in api_reference.modules(package) if ">>>" in api_reference.source(name)
]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_on_the_first_page_with_what_it_is_and_on_one_other(package):
    made = pages()
    index = made.pop("reference/api/index.md")
    for name in importlib.import_module(package).__all__:
        row = next(line for line in index.splitlines() if line.startswith(f"| [`{package}.{name}`]"))
        assert len(row.split("|")[2].strip()) > 10, row
        entry = f"::: {api_reference._place(package, name)}\n"
        assert sum(entry in page for page in made.values()) == 1, name


def test_names_stand_in_the_order_of_use_each_once():
    result = by_task()
    names = [name for step in result.values() for name in step]
    assert sorted(names) == sorted(importlib.import_module("calib").__all__)
    assert names.index("load") < names.index("check") < names.index("fit") < names.index("solve")
    assert all(name.endswith("Error") for name in result["Errors"])


def test_what_pages_cite_has_its_derivation():
    made = pages()
    assert "calib.core.numerics.statistics" in cited()
    for name in cited():
        assert made[f"reference/api/{name}.md"].endswith("members: false\n")
        assert api_reference.summary(name)


def test_the_navigation_has_every_page_once_and_they_are_few():
    result = _paths(navigation())
    assert sorted(result) == sorted(pages())
    assert len(result) < 60 < len(list((ROOT / "calib").rglob("*.py")))


def _paths(entry):
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [path for part in parts for path in _paths(part)]


def test_there_are_examples():
    assert len(WITH_EXAMPLES) >= 4


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_in_docstrings_print_what_they_say(name):
    outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0

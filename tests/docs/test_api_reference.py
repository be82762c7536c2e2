"""The Python reference has every module (that everything public has its docstring is checked by `make lint`)."""

import importlib

import api_reference
import pytest
from api_reference import PACKAGES, modules, navigation, pages, rooms, summary
from snippets import ROOT

MODULES = [name for package in PACKAGES for name in modules(package)]


def test_every_module_has_a_page_and_a_line_on_the_first_one():
    made = pages()
    index = made["reference/api/index.md"]
    for name in MODULES:
        assert f"::: {name}\n" in made[f"reference/api/{name}.md"]
        if name == "calib":
            continue  # the first table of the page is what it has
        assert f"[`{name}`]({name}.md) | {api_reference._cell(summary(name))}" in index
    on_disk = {path for package in PACKAGES for path in (ROOT / package).rglob("*.py") if path.stem != "__main__"}
    assert len(MODULES) == len(on_disk)


@pytest.mark.parametrize("package", ["calib", "viz"])
def test_every_public_name_of_a_package_is_on_the_first_page_with_what_it_is(package):
    index = pages()["reference/api/index.md"]
    module = importlib.import_module(package)
    for name in module.__all__:
        row = next(line for line in index.splitlines() if line.startswith(f"| [`{package}.{name}`]"))
        assert len(row.split("|")[2].strip()) > 10, row


def test_names_stand_in_the_order_of_use_each_once():
    found = api_reference.by_use("calib")
    names = [name for step in found.values() for name in step]
    assert sorted(names) == sorted(importlib.import_module("calib").__all__)
    assert names.index("load") < names.index("check") < names.index("fit") < names.index("solve") < names.index("Fit")
    assert all(name.endswith("Error") for name in found["Errors"])


def test_the_navigation_has_every_module_once_under_its_room():
    found = [path.removeprefix("reference/api/").removesuffix(".md") for path in _paths(navigation())]
    assert sorted(found) == sorted(["index", *MODULES])
    assert "calib.robots.loops" in rooms()["Robots"]
    assert "calib.base.errors" in rooms()["Base"]


def _paths(entry):
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [path for part in parts for path in _paths(part)]

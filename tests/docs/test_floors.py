"""The floors of the house: `calib` knows nothing of `viz` and `medrue`, and `viz` nothing of `medrue`."""

import ast
import re

import pytest

from tests.project import ROOT


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


@pytest.mark.parametrize(("package", "above"), [("calib", {"viz", "medrue"}), ("viz", {"medrue"})])
def test_a_floor_imports_nothing_from_above(package, above):
    files = [path for path in (ROOT / package).rglob("*.py") if re.search("|".join(above), path.read_text())]
    wrong = {str(path.relative_to(ROOT)): above & set(imported(path)) for path in files if above & set(imported(path))}
    assert wrong == {}


def test_the_closed_form_shares_no_code_with_the_engine():
    for name in ("closed_form", "closed_form_inverse", "rotations", "paper_tables", "workspace"):
        assert not {"calib", "pinocchio", "pin"} & set(imported(ROOT / "medrue" / f"{name}.py"))


def test_the_engine_names_no_robot():
    for path in (ROOT / "calib").rglob("*.py"):
        if path.name != "version.py":  # names the distribution
            assert "medrue" not in path.read_text().lower(), path

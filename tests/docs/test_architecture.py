"""The picture of the architecture is that of the code, and packages know nothing of those above."""

import ast
import importlib
import re
import subprocess
import sys

import architecture
import pytest
from architecture import CAPABILITIES, CORE, FRONT, ROOMS, ROOT, SHARED, imported, modules, room_of

import calib
from calib.capabilities import ENTRY_POINTS


@pytest.mark.parametrize(
    ("files", "above"),
    [("calib/**/*.py", "viz"), ("viz/**/*.py", "medrue")]
    + [
        (f"medrue/{name}.py", "calib|pinocchio")  # the closed form shares no code with the engine
        for name in ("closed_form", "closed_form_inverse", "paper_tables", "workspace")
    ],
)
def test_files_import_nothing_from_packages_above(files, above):
    paths = list(ROOT.glob(files))
    assert paths
    for path in paths:
        assert not re.search(rf"^\s*(from|import) ({above})\b", path.read_text(), re.MULTILINE), path


def test_the_engine_names_no_robot():
    for path in (ROOT / "calib").rglob("*.py"):
        if path.name != "version.py":  # names the distribution
            assert "medrue" not in path.read_text().lower(), path


def test_every_module_is_in_one_room_of_the_picture():
    drawn = sorted(name for room in ROOMS for name in room.modules)
    assert drawn == sorted(
        path.stem
        for name, path in modules().items()
        if path.stem != "__init__" and name not in (*FRONT, *architecture.BESIDE)
    )
    assert {room_of(name).name for name in modules()} == {room.name for room in ROOMS}
    assert (room_of("cli").name, room_of("core.robots.urdf.text").name) == ("Commands", "URDF")
    with pytest.raises(KeyError, match="has no room"):
        room_of("cellar.boiler")


def _imports(room):
    for name, path in modules().items():
        if room_of(name) is room and name not in FRONT:
            yield from ((name, other) for other in imported(path))


@pytest.mark.parametrize("room", CORE, ids=[room.name for room in CORE])
def test_a_room_of_the_core_imports_only_from_itself_and_from_lower_floors(room):
    for name, other in _imports(room):
        of_other = room_of(other)
        assert of_other not in CAPABILITIES, f"{name} of the core imports {other}"
        if (name, other) != ("core.base.registry", "capabilities"):  # by name, to look into the table
            assert of_other is room or of_other.floor < room.floor, f"{name} ({room.name}) imports {other}"


@pytest.mark.parametrize("room", CAPABILITIES, ids=[room.name for room in CAPABILITIES])
def test_a_capability_imports_only_from_itself_and_from_the_core(room):
    for name, other in _imports(room):
        assert room_of(other) in (room, SHARED, *CORE), f"{name} imports {other}"
        assert other not in FRONT, f"{name} imports {other}"


def test_what_capabilities_bring_is_there():
    names = [(entry.group, entry.name) for entry in ENTRY_POINTS]
    assert len(set(names)) == len(names)
    assert all(entry.load() for entry in ENTRY_POINTS)


def test_imports_at_first_use_are_seen():
    assert "core.commands.fit" in imported(modules()["cli"])


def test_names_at_the_front_door_are_those_that_type_checkers_see():
    assert sorted(calib.__all__) == calib.__all__
    for name in calib.__all__:
        assert getattr(calib, name).__name__ == name
    seen = ast.parse((ROOT / "calib" / "__init__.py").read_text(encoding="utf-8"))
    for node in ast.walk(seen):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("calib."):
            for alias in node.names:
                assert getattr(importlib.import_module(str(node.module)), alias.name) is getattr(calib, alias.name)


def assert_loads_none(code, modules):
    """Run code in a process of its own, which loads none of some modules; return the lines that it prints."""
    check = f"{code}\nimport sys\nprint([name for name in {modules} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, cwd=ROOT, check=True)
    *page, loaded = done.stdout.splitlines()
    assert loaded == "[]"
    return page, done.stderr


def program(*arguments):
    return f"from calib.cli import group\ngroup.main({arguments}, prog_name='calib', standalone_mode=False)"


def test_the_list_of_commands_loads_no_science():
    page, errors = assert_loads_none(program("--help"), ("numpy", "scipy", "pinocchio", "pydantic"))
    assert errors == ""
    assert {line.split()[0] for line in page if line.startswith("  ")} >= {"fit", "check", "view", "watch"}


def test_parts_of_scipy_are_loaded_at_first_use():
    parts = ("scipy.spatial", "scipy.sparse", "scipy.optimize", "scipy.stats")
    assert assert_loads_none("import calib.core.commands.fit", parts) == ([], "")


def test_no_modules_import_each_other_in_a_circle():
    assert architecture.circle({name: imported(path) - {name} for name, path in modules().items()}) == []


def test_a_circle_is_found_where_there_is_one():
    assert architecture.circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c", "a"]


def test_the_contributors_guide_has_a_paragraph_for_each_room():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for room in ROOMS:
        assert f"**{room.name}.**" in text


@pytest.mark.quick(0)
def test_a_fit_with_its_pages_loads_nothing_that_other_commands_need(tmp_path):
    """Of a robot of boxes and cylinders; SciPy's statistics, IPython and web clients take longer than such a fit.

    Nor does it load what only an export, or a robot with a fleet, needs.
    """
    heavy = ("scipy.stats", "trimesh", "meshcat", "IPython", "urllib.request", "ssl")
    own = ("exporting.formats", "printers.formats", "exporting.functions.facts", "exporting.functions.c_text")
    own += ("fleets.contradicted_prior", "fleets.hierarchy")
    assert set(own) <= modules().keys()
    arguments = ("docs/examples/five_bar.yaml", "docs/examples/five_bar_simulated.csv", "--out", str(tmp_path / "out"))
    assert_loads_none(program("fit", *arguments), (*heavy, *(f"calib.{name}" for name in own)))

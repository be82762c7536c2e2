"""The picture of the architecture is that of the code."""

import ast
import importlib
import importlib.util
import subprocess
import sys

import architecture
import pytest
from architecture import CAPABILITIES, CORE, FRONT, ROOMS, SHARED, imported, modules, room_of

import calib
from calib.capabilities import ENTRY_POINTS

CONTRIBUTING = (architecture.ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


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
    seen = ast.parse((architecture.ROOT / "calib" / "__init__.py").read_text(encoding="utf-8"))
    for node in ast.walk(seen):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("calib."):
            for alias in node.names:
                assert getattr(importlib.import_module(str(node.module)), alias.name) is getattr(calib, alias.name)


def test_the_list_of_commands_loads_no_science():
    check = (
        "import sys\nfrom calib.cli import group\n"
        "group.main(['--help'], prog_name='calib', standalone_mode=False)\n"
        "print([m for m in ('numpy', 'scipy', 'pinocchio', 'pydantic') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, cwd=architecture.ROOT)
    *page, loaded = done.stdout.splitlines()
    assert (loaded, done.stderr) == ("[]", "")
    assert {line.split()[0] for line in page if line.startswith("  ")} >= {"fit", "check", "view", "watch"}


def test_parts_of_scipy_are_loaded_at_first_use():
    parts = ("scipy.spatial", "scipy.sparse", "scipy.optimize", "scipy.stats")
    check = f"import sys, calib.core.commands.fit\nprint([part for part in {parts} if part in sys.modules])"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, cwd=architecture.ROOT)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_no_modules_import_each_other_in_a_circle():
    assert architecture.circle({name: imported(path) - {name} for name, path in modules().items()}) == []


def test_a_circle_is_found_where_there_is_one():
    assert architecture.circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c", "a"]


def test_the_contributors_guide_has_a_paragraph_for_each_room():
    for room in ROOMS:
        assert f"**{room.name}.**" in CONTRIBUTING


@pytest.mark.quick(0)
def test_a_fit_with_its_pages_loads_nothing_that_other_commands_need(tmp_path):
    """Of a robot of boxes and cylinders; SciPy's statistics, IPython and web clients take longer than such a fit.

    Nor does it load what only an export, or a robot with a fleet, needs.
    """
    told = [
        "fit",
        "docs/examples/five_bar.yaml",
        "docs/examples/five_bar_simulated.csv",
        "--out",
        str(tmp_path / "out"),
    ]
    heavy = ("scipy.stats", "trimesh", "meshcat", "IPython", "urllib.request", "ssl")
    heavy += (
        "calib.exporting.formats",
        "calib.printers.formats",
        "calib.exporting.functions.facts",
        "calib.exporting.functions.c_text",
    )
    heavy += ("calib.fleets.contradicted_prior", "calib.fleets.hierarchy")
    assert all(importlib.util.find_spec(name) for name in heavy if name.startswith("calib"))
    check = (
        "import sys\nfrom calib.cli import group\n"
        f"group.main({told}, standalone_mode=False)\n"
        f"print([name for name in {heavy} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", check], cwd=architecture.ROOT, capture_output=True, text=True, check=True
    )
    assert done.stderr.splitlines()[-1] == "[]"

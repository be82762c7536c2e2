"""The wheel: installed elsewhere, it works without the folder it was built from."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.project import ROOT

pytestmark = pytest.mark.quick(0)

PACKAGES = ("calib", "viz", "medrue")
SCRIPT = """
import calib, medrue, viz
robot = calib.load(medrue.robot_file())
print(calib.__file__, medrue.__file__, viz.__file__, medrue.robot_file(), robot.urdf.path, sep="\\n")
print(robot.with_parameters(robot.values).calibrated_urdf() == robot.urdf.source, len(robot.parameters))
"""


def run(*command: object, cwd: Path, **environment: str) -> str:
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | environment
    done = subprocess.run(
        [sys.executable, *map(str, command)], capture_output=True, text=True, cwd=cwd, env=variables, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling", reason="hatchling (dev extra) builds the wheel")
    out = tmp_path_factory.mktemp("wheel")
    run("-m", "build", "--wheel", "--no-isolation", "--outdir", out, ROOT, cwd=out)
    (path,) = out.glob("*.whl")
    return path


def test_the_container_is_built_from_all_that_the_wheel_is_made_of():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    copied = {name for line in lines if line.startswith("COPY ") for name in line.split()[1:-1]}
    assert [name for name in copied if not (ROOT / name).exists()] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    made_of = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*made_of["packages"], *made_of["force-include"], project["project"]["readme"]}
    assert needed | set(project["project"]["license-files"]) <= copied


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder that holds nothing but the installed wheel."""
    folder = tmp_path_factory.mktemp("installed")
    run("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", folder, wheel, cwd=folder)
    return folder


def test_the_wheel_holds_every_file_of_the_packages_and_the_robot(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    expected = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert expected <= names
    assert {f"medrue/urdf/{name}" for name in ("medrue.urdf", "medrue.yaml", "medrue_extended.yaml")} <= names
    assert not {name for name in names if name.startswith(("tests", "docs", "urdf"))}


def test_the_packages_and_the_robot_are_found_when_installed_elsewhere(installed, tmp_path):
    lines = run("-c", SCRIPT, cwd=tmp_path, PYTHONPATH=str(installed)).splitlines()
    assert all(Path(line).is_relative_to(installed) for line in lines[:5]), lines
    assert all(Path(line).is_file() for line in lines[:5])
    assert lines[5] == "True 36"


@pytest.mark.amount(0, 1)
def test_type_checkers_read_the_types_of_an_installed_package(installed, tmp_path):
    """Of a package in site-packages they do so only where it holds the marker `py.typed`."""
    pytest.importorskip("mypy", reason="mypy (dev extra) reads the types")
    run("-m", "venv", "--without-pip", "env", cwd=tmp_path)
    (site,) = (tmp_path / "env").glob("lib/python*/site-packages")
    for package in PACKAGES:
        (site / package).symlink_to(installed / package)
    (tmp_path / "use.py").write_text("import calib, medrue, viz\n\nwrong: int = medrue.robot_file()\n")
    (tmp_path / "mypy.ini").write_text("[mypy]\nstrict = True\n[mypy-calib.*,viz.*]\nfollow_imports = skip\n")
    command = [sys.executable, "-m", "mypy", "--python-executable", tmp_path / "env" / "bin" / "python", "use.py"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=120)
    (said,) = [line for line in done.stdout.splitlines() if line.startswith("use.py")]
    assert 'has type "Path", variable has type "int"' in said


def test_the_demonstration_runs_anywhere_and_names_the_files_to_open(installed, tmp_path):
    out = run("-c", "from medrue.cli import main; main()", "demo", cwd=tmp_path, PYTHONPATH=str(installed))
    assert "Verdict: PASS" in out
    told = next(line for line in out.splitlines() if line.startswith("Open "))
    named = [Path(word) for word in told.replace(",", " ").split() if word.endswith(".html")]
    assert [(tmp_path / path).is_file() for path in named] == [True, True]


def test_lines_of_tutorials_run_without_a_checkout(installed, tmp_path):
    paths = {"cwd": tmp_path, "PYTHONPATH": str(installed)}
    out = run("-c", "from medrue.cli import main; main()", "examples", **paths)
    assert out.endswith("written to docs/examples, urdf\n")
    for folder in ("urdf", "docs/examples"):
        written = {path.name for path in (tmp_path / folder).iterdir() if not path.name.startswith(".")}
        assert written == {path.name for path in (ROOT / folder).iterdir()}
    run("-m", "calib", "check", "docs/examples/arm.yaml", "docs/examples/arm_simulated.csv", **paths)

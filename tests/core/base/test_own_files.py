"""What may be replaced: files that this program wrote, as it wrote them, and nothing that the command reads."""

import json
import os
import shutil
from pathlib import Path

import pytest

import calib
from calib.core.base.errors import InputError
from calib.core.base.files import read_text, write_file, write_files, write_folder
from calib.core.base.own_files import inputs_noted, note_input
from tests.project import EXAMPLES

FOREIGN = "# my only measurements\nx,y\n1,2\n"


@pytest.fixture
def here(tmp_path):
    """A folder with the example arm and a few of its measurements."""
    for name in ("arm.yaml", "arm.urdf"):
        shutil.copy(EXAMPLES / name, tmp_path)
    lines = (EXAMPLES / "arm_simulated.csv").read_text().splitlines(keepends=True)
    (tmp_path / "d.csv").write_text("".join(lines[:33]))
    return tmp_path


@pytest.fixture(scope="module")
def fitted():
    robot = calib.load(EXAMPLES / "arm.yaml")
    return calib.fit(robot, calib.read_measurements(EXAMPLES / "arm_simulated.csv", robot))


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def refused(run, folder, before, word):
    """A single line (after notes on the data), exit code 2, the way out is named, and nothing has changed."""
    assert run.code == 2, run.err
    (line,) = [line for line in run.err.splitlines() if not line.startswith("note: ")]
    assert word in line
    assert "--force" in line
    assert contents(folder) == before


@pytest.mark.parametrize(
    "target", ["d.csv", "./sub/../d.csv", "symbolic.csv", "hard.csv", "arm.yaml", "arm.urdf", "v.csv"]
)
def test_a_command_never_writes_onto_its_inputs_under_whatever_name(here, run_calib, target):
    (here / "sub").mkdir()
    (here / "symbolic.csv").symlink_to("d.csv")
    os.link(here / "d.csv", here / "hard.csv")
    shutil.copy(EXAMPLES / "arm_truth.csv", here / "v.csv")
    before, old = contents(here), (here / target).read_bytes()
    command = ("predict", "arm.yaml", "d.csv", "--parameters", "v.csv", "--out", target)
    refused(run_calib(*command, cwd=here), here, before, "is read by this command")
    assert run_calib(*command, "--force", cwd=here).code == 0
    assert (here / target).read_bytes() != old


def test_what_this_program_wrote_is_an_input_as_well(here, run_calib):
    assert run_calib("sample", "arm.yaml", "--count", 20, "--seed", 1, "--out", "p.csv", cwd=here).code == 0
    before = contents(here)
    refused(run_calib("simulate", "arm.yaml", "p.csv", "--seed", 1, "--out", "p.csv", cwd=here), here, before, "p.csv")
    refused(run_calib("select", "arm.yaml", "p.csv", "--count", 15, "--out", "p.csv", cwd=here), here, before, "p.csv")


def test_a_file_that_a_command_writes_again_is_no_input_of_it(tmp_path, monkeypatch):
    """As in `watch`, whose measurements are replaced: a new file gets the number of one that was read and is gone."""
    replace = Path.replace

    def replace_with_number_of_an_input(path, target):
        note_input(path.stat())
        return replace(path, target)

    (tmp_path / "read.csv").write_text("1\n")
    monkeypatch.setattr(Path, "replace", replace_with_number_of_an_input)
    with inputs_noted():
        read_text(tmp_path / "read.csv", "a file", InputError)
        for text in ("1\n", "2\n", "3\n"):
            write_file(tmp_path / "state.json", text)
        with pytest.raises(InputError, match="is read by this command"):
            write_file(tmp_path / "read.csv", "2\n")
    assert (tmp_path / "state.json").read_text().startswith("3\n")


COMMANDS = (
    "init arm.urdf --out out.yaml",
    "sample arm.yaml --count 5 --seed 1 --out out.csv",
    "simulate arm.yaml d.csv --seed 1 --out out.csv",
    "select arm.yaml d.csv --count 20 --out out.csv",
    "predict arm.yaml d.csv --out out.csv",
    "export arm.yaml --format dh --out out.csv",
    "export arm.yaml --format xacro --out out.xacro",
    "export arm.yaml --format mjcf --out out.xml",
    "check arm.yaml d.csv --json out.json",
    "view arm.yaml --html out.html",
)
"""Every command that writes a file, which is the last word."""


@pytest.mark.quick(1)
@pytest.mark.parametrize("words", COMMANDS)
def test_a_file_of_somebody_else_stays_and_its_own_is_written_again(here, run_calib, words):
    command = words.split()
    out = here / command[-1]
    out.write_text(FOREIGN)
    refused(run_calib(*command, cwd=here), here, contents(here), "was not written by this program")
    out.unlink()
    assert run_calib(*command, cwd=here).code == 0
    assert run_calib(*command, cwd=here).code == 0
    out.write_bytes(out.read_bytes().replace(b"1", b"2", 1))
    refused(run_calib(*command, cwd=here), here, contents(here), "was changed since")
    assert run_calib(*command, "--force", cwd=here).code == 0


@pytest.mark.quick(0)
def test_a_program_is_not_compensated_in_place(tmp_path, run_calib):
    for name in ("delta.yaml", "delta.urdf", "delta_simulated.csv"):
        shutil.copy(EXAMPLES / name, tmp_path)
    robot = calib.load(tmp_path / "delta.yaml")
    calib.fit(robot, tmp_path / "delta_simulated.csv").save(tmp_path / "fit", pages=False)
    (tmp_path / "part.gcode").write_text("; a part\nG21\nG90\nG28\nG1 X10 Y10 Z50 F3000\nG1 X30 Y-10\n")
    before = contents(tmp_path)
    for program in ("part.gcode", "delta_simulated.csv"):
        command = ("compensate", "delta.yaml", program, "--result", "fit", "--out")
        refused(run_calib(*command, program, cwd=tmp_path), tmp_path, before, "is read by this command")
    for _ in range(2):
        assert run_calib(*command, "told.csv", cwd=tmp_path).code == 0


@pytest.mark.quick(0)
def test_a_fit_leaves_parameters_of_somebody_else(here, run_calib):
    out = here / "out"
    out.mkdir()
    (out / "parameters.csv").write_text("parameter,value,unit\nmine,1,mm\n")
    (out / "notes.txt").write_text("mine")
    before = contents(out)
    command = ["fit", "arm.yaml", "d.csv", "--no-pages", "--out", "out"]
    refused(run_calib(*command, cwd=here), out, before, "parameters.csv: was not written by this program")
    (out / "parameters.csv").unlink()
    first = run_calib(*command, cwd=here)
    assert first.code in (0, 3)  # so few poses need not give a robot
    assert run_calib(*command, cwd=here).code == first.code
    assert (out / "notes.txt").read_text() == "mine"
    (out / "residuals.csv").write_text("edited")
    refused(run_calib(*command, cwd=here), out, contents(out), "residuals.csv")
    assert run_calib(*command, "--force", cwd=here).code == 0


def test_a_fit_never_replaces_the_result_that_it_starts_from_nor_data_in_its_folder(here, run_calib, fitted):
    fitted.save(here / "fit", pages=False)
    before = contents(here / "fit")
    run = run_calib("fit", "fit", "d.csv", "--no-pages", "--out", "fit", cwd=here)
    refused(run, here / "fit", before, "is read by this command")
    (here / "data").mkdir()
    shutil.move(here / "d.csv", here / "data" / "residuals.csv")
    before = contents(here / "data")
    run = run_calib("fit", "arm.yaml", "data/residuals.csv", "--no-pages", "--out", "data", cwd=here)
    refused(run, here / "data", before, "residuals.csv: is read by this command")


def test_two_outputs_do_not_share_a_place(here, run_calib):
    before = contents(here)
    run = run_calib("fit", "arm.yaml", "d.csv", "--no-pages", "--out", "out", "--json", "out/result.json", cwd=here)
    assert run.code == 2
    assert contents(here) == before
    run = run_calib("select", "arm.yaml", "d.csv", "--count", 20, "--out", "a.csv", "--json", "./a.csv", cwd=here)
    assert "is to be written twice" in run.refusal()
    assert contents(here) == before


def test_the_same_holds_from_python(here, fitted):
    out = here / "out"
    out.mkdir()
    (out / "result.json").write_text("{}")
    with pytest.raises(InputError, match="was not written by this program"):
        fitted.save(out, pages=False)
    assert contents(out) == {"result.json": b"{}"}
    fitted.save(out, pages=False, force=True)
    fitted.save(out, pages=False)
    robot = calib.load(here / "arm.yaml")
    for file in ("arm.yaml", "arm.urdf"):
        os.link(here / file, here / f"hard_{file}")
        with pytest.raises(InputError, match="is read by this command"):
            calib.export(robot, here / f"hard_{file}", "urdf")
    with pytest.raises(InputError, match="is read by this command"):
        robot.save(here / "arm.yaml")
    robot.save(here / "other.yaml")
    robot.save(here / "other.yaml")
    (here / "other.yaml").write_text("# edited\n" + (here / "other.yaml").read_text())
    with pytest.raises(InputError, match="was changed since"):
        robot.save(here / "other.yaml")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "x,y\n1,2\n"),
        ("a.yaml", "urdf: a\n"),
        ("a.urdf", '<?xml version="1.0"?>\n<robot name="a"/>\n'),
        ("a.json", json.dumps({"a": 1}, indent=1) + "\n"),
    ],
)
def test_a_file_tells_by_itself_who_wrote_it_and_stays_what_it_is(tmp_path, name, text):
    path = tmp_path / name
    write_file(path, text)
    (tmp_path / "moved").mkdir()
    moved = path.rename(tmp_path / "moved" / name)
    write_file(moved, text.replace("a", "b").replace("1", "3"))  # it is known elsewhere, too
    assert moved.read_bytes().count(b"written by") == 1
    if name.endswith(".json"):
        json.loads(moved.read_text())
    for edited in (moved.read_text() + " ", " " + moved.read_text()):  # the line alone does not count
        moved.write_text(edited)
        with pytest.raises(InputError, match="changed since"):
            write_file(moved, text)
        assert moved.read_text() == edited


def test_empty_files_and_such_as_would_not_change_may_be_replaced(tmp_path):
    (tmp_path / "empty").touch()
    write_file(tmp_path / "empty", "x\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a").write_bytes(b"same")
    write_folder(tmp_path / "out", {"a": b"same"})
    with pytest.raises(InputError):
        write_folder(tmp_path / "out", {"a": b"other"}, inputs=[tmp_path / "out" / "a"])
    (tmp_path / "out" / "b").write_bytes(b"mine")
    with pytest.raises(InputError, match="b: was not written by this program"):
        write_folder(tmp_path / "out", {"a": b"same"}, obsolete=["b"])


def test_of_files_that_belong_together_none_is_written_if_one_may_not_be(tmp_path):
    (tmp_path / "b").write_text(FOREIGN)
    with pytest.raises(InputError):
        write_files({tmp_path / "a": b"1", tmp_path / "b": b"2"})
    assert contents(tmp_path) == {"b": FOREIGN.encode()}


@pytest.mark.parametrize("damaged", ["", "{", "[]", '{"sha256": 3}', "[" * 100_000])
def test_a_damaged_manifest_makes_no_file_its_own(tmp_path, damaged):
    (tmp_path / "a").write_text(FOREIGN)
    (tmp_path / ".written-by-calib.json").write_text(damaged)
    with pytest.raises(InputError, match="was not written by this program"):
        write_folder(tmp_path, {"a": b"2"})

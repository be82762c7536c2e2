"""Bad input on the command line: one clear line, exit code 2, nothing written, an existing result untouched."""

import json
import os
import re

import pytest

import calib
from tests.project import EXAMPLES
from tests.small_robots import ARM_URDF, ARM_YAML, write_arm

ROWS = ["turn,slide [mm],wrist [deg],tip_x [mm],tip_y [mm],tip_z [mm]"] + [
    f"{0.1 * k},{10 * k},{-5 * k},{375 + k},{20 - k},{600 + 2 * k}" for k in range(8)
]
DATA = "\n".join(ROWS) + "\n"
FIT = "fit arm.yaml data.csv --out new"
PREDICT = "predict arm.yaml data.csv --out new.csv"
SIMULATE = "simulate arm.yaml data.csv --sigma-mm 0.1 --seed 1 --out new.csv"
EACH = FIT, PREDICT, SIMULATE


def tree(folder):
    """Every path below a folder, with its bytes and the time of its last change."""
    return {
        str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns) if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture
def folder(tmp_path):
    """A working folder with a robot, data, and results of an earlier run."""
    write_arm(tmp_path)
    (tmp_path / "data.csv").write_text(DATA)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_text('{"an": "earlier result"}')
    (tmp_path / "out" / "calibrated.urdf").write_text("an earlier result")
    (tmp_path / "old.csv").write_text("an earlier result")
    return tmp_path


@pytest.fixture
def refused(folder, run_calib):
    """Run a command that must be refused, and return its one line."""

    def run(command, *more):
        before = tree(folder)
        done = run_calib(*command.split(), *more, cwd=folder)
        assert done.code == 2, done
        assert done.out == ""
        assert done.err.endswith("\n")
        assert done.err.count("\n") == 1, done.err
        assert done.err.startswith("calib")
        assert "Traceback" not in done.err
        assert "defect" not in done.err
        assert tree(folder) == before
        return done.err.strip()

    return run


def data(**changes):
    """The measurement file with lines replaced: `data(line3="...")`."""
    lines = list(ROWS)
    for key, text in changes.items():
        lines[int(key.removeprefix("line")) - 1] = text
    return "\n".join(lines) + "\n"


LINK = '<link name="upper"/>'
MIMIC = ARM_URDF.replace("<limit", '<mimic joint="turn" {}="{}"/><limit', 1)
NESTED = "[" * 100_000
TARGETS = "tip_x [mm],tip_y [mm],tip_z [mm]\n375,20,600\n"
OF_URDF = FIT, "init arm.urdf --out new.yaml", "predict arm.urdf data.csv --out new.csv"
OF_PARAMETERS = f"{PREDICT} --parameters p.csv", f"{SIMULATE} --parameters p.csv"
BAD_FILES = {  # what single readers refuse: tests/core/data, tests/core/robots, tests/core/results
    "text": ("data.csv", data(line4="a,0,0,1,2,3"), EACH, "data.csv, line 4, column 'turn': 'a' is not a number"),
    "misspelt direction": (
        "data.csv",
        "turn,slide,wrist,tip_x,tip_y,tip_z,approach_sldie\n0,0,0,1,1,1,1\n",
        (FIT,),
        "data.csv, column 'approach_sldie': no joint 'sldie'; did you mean 'slide'?",
    ),
    "blank cells": ("data.csv", ROWS[0] + "\n" + ",,,,,\n" * 8, (f"{FIT} --validate 0.3",), "data.csv"),
    "huge joint": ("data.csv", data(line3=ROWS[3].replace("20", "1e300", 1)), (PREDICT,), "data.csv, line 3"),
    "no data": ("data.csv", None, EACH, "calib: data.csv: no such file; give a CSV file"),
    "no description": ("arm.yaml", None, EACH, "arm.yaml: no such file or folder; give a robot description"),
    "no URDF": ("arm.urdf", None, EACH, "arm.urdf: no such file; give the path of a URDF"),
    "zero byte in a name": (
        "arm.yaml", ARM_YAML.replace("arm.urdf", '"arm\\0.urdf"'), EACH, "holds \\x00, which nobody sees",
    ),
    "SDF": ("arm.urdf", "<?xml version='1.0'?><sdf version='1.7'/>", OF_URDF, "arm.urdf: it has no model with links"),
    "mimic multiplier": ("arm.urdf", MIMIC.format("multiplier", "1e308"), OF_URDF, "multiplier: '1e308' is beyond 1e9"),
    "mimic offset": ("arm.urdf", MIMIC.format("offset", "-1e308"), OF_URDF, "mimic offset: '-1e308' is beyond 1e9"),
    "unknown link": (
        "arm.urdf", ARM_URDF.replace('parent link="upper"', 'parent link="uper"'), OF_URDF, "did you mean 'upper'?",
    ),
    "entity of a file": (
        "arm.urdf",
        ARM_URDF.replace("<robot", '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/passwd">]><robot'),
        OF_URDF,
        "arm.urdf, line 2: entity 'secret' stands for another file, which is not read",
    ),
    "entities without end": (
        "arm.urdf",
        '<!DOCTYPE robot [<!ENTITY a0 "' + "<link/>" * 9 + '">'
        + "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
        + "]><robot>&a11;</robot>",
        (FIT,),  # a second to read
        "arm.urdf",
    ),
    "overflow": ("arm.urdf", ARM_URDF.replace("0.25 0 0", "1e200 0 0"), OF_URDF, "'slide', xyz: '1e200' is beyond 1e9"),
    "a shape of nan": (
        "arm.urdf",
        ARM_URDF.replace(LINK, f'{LINK[:-2]}><visual><geometry><box size="nan 1 1"/></geometry></visual></link>'),
        OF_URDF,
        "<box> of link 'upper' has size=\"nan 1 1\"",
    ),
    "links without end": (
        "arm.urdf",
        ARM_URDF.replace(LINK, LINK + "".join(f'<link name="l{k}"/>' for k in range(300))),
        OF_URDF,
        "links, more than 300; cut the file down to the arm",
    ),
    "no parameters": ("p.csv", None, OF_PARAMETERS, "p.csv: no such file"),
    "huge parameter": (
        "p.csv", "parameter,value,unit\nturn.x,1e300,mm\n", OF_PARAMETERS,
        "p.csv, line 2, parameter 'turn.x': '1e300' is too large",
    ),
    "nested parameters": ("p.csv", NESTED, OF_PARAMETERS, "p.csv"),
    "nested result": ("out/result.json", NESTED, (f"{PREDICT} --result out",), "out/result.json"),
    "huge target": (
        "t.csv", TARGETS.replace("375", "1e300"), ("solve arm.yaml t.csv --out new.csv",), "t.csv, line 2",
    ),
}  # fmt: skip


@pytest.mark.quick(12)
@pytest.mark.parametrize(("name", "content", "commands", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_bad_file_is_refused(folder, refused, name, content, commands, message):
    (folder / name).unlink(missing_ok=True)
    if content is not None:
        assert content != ARM_URDF
        (folder / name).write_text(content)
    for command in commands:
        assert message in refused(command)


def test_a_folder_in_the_place_of_data_is_refused(folder, refused):
    (folder / "data.csv").unlink()
    (folder / "data.csv").mkdir()
    for command in EACH:
        assert refused(command) == "calib: data.csv: cannot be read (is a directory)"


def test_a_link_to_itself_in_the_place_of_data_or_a_result_is_refused(folder, refused):
    (folder / "data.csv").unlink()
    (folder / "data.csv").symlink_to("data.csv")
    for command in EACH:
        assert refused(command) == "calib: data.csv: cannot be read (too many levels of symbolic links)"
    assert "data.csv: holds no result" in refused("compare data.csv out")


def test_a_name_that_no_file_can_have_is_an_error_of_reading(tmp_path):
    with pytest.raises(calib.DataError, match=r"cannot be read \(file name too long\)"):
        calib.read_measurements("x" * 300, calib.load(write_arm(tmp_path)))


@pytest.mark.quick(0)
def test_a_pose_that_cannot_be_assembled_is_refused_with_pose_and_loop(folder, refused):
    good = (EXAMPLES / "five_bar_simulated.csv").read_text().splitlines()[:12]  # two of them are comments
    (folder / "data.csv").write_text("\n".join([*good, "far,0,0,734,1350,-276"]) + "\n")
    for command in EACH:
        line = refused(command.replace("arm.yaml", str(EXAMPLES / "five_bar.yaml")))
        assert "data.csv, line 13 (pose far): " in line
        assert "its loops close only with passive joint left_elbow" in line


BAD_OPTIONS = {
    "validate fraction": (f"{FIT} --validate 1.5", "1.5 of 8 poses held out, no pose is left to"),
    "validate file": (f"{FIT} --validate other.csv", "other.csv: is neither a file nor a fraction"),
    "sigma text": (f"{FIT} --sigma-mm abc", "'--sigma-mm': 'abc' is not a valid float"),
    "sigma nan": (f"{FIT} --sigma-mm nan", "--sigma-mm nan: must be a positive number"),
    "sigma too small": (f"{FIT} --sigma-mm 1e-300", "--sigma-mm: '1e-300 mm' is too small to mean anything"),
    "seed": (SIMULATE.replace("--seed 1", "--seed -1"), "'--seed': -1 is not in the range x>=0"),
    "no out": ("sample arm.yaml --count 3", "Missing option '-o' / '--out'"),
    "no data": ("fit arm.yaml --out out", "Missing argument 'DATA...'"),
    "unknown command": ("fitt arm.yaml data.csv --out out", "No such command 'fitt'. Did you mean 'fit'?"),
    "unknown option": (f"{FIT} --sigma 1", "no option '--sigma'; here: --sigma-mm 0.04"),
    "one argument too many": (f"{PREDICT} more.csv", "Got unexpected extra argument"),
    "one file too many": (f"{FIT} more.csv", "more.csv: no such file"),
    "parameters and result": (f"{PREDICT} --parameters p.csv --result out", "give --parameters or --result, not both"),
    "json place": (f"{FIT} --json no/where.json", "no/where.json: cannot be written (no such file or directory)"),
    "no result": (f"{PREDICT} --result elsewhere", "elsewhere: holds no result (no result.json)"),
    "a file that is the folder": (f"{FIT} --json new", "new: is to be a file and a folder; give each output a place"),
    "prior twice": (f"{FIT} --prior turn.x=1mm,turn.x=2mm", "--prior turn.x=2mm: 'turn.x' is given twice"),
    "speed nan": ("route arm.yaml data.csv --speed nan --out new", "'--speed': nan is not a finite number"),
    "dwell inf": ("route arm.yaml data.csv --dwell inf --out new", "'--dwell': inf is not a finite number"),
    "board of metres": ("board --board chessboard:9x6:30 --out b.pdf", "the board would be 270 m wide; write the unit"),
    "empty option": (f"{PREDICT} --result=", "'--result': it is empty; give it a value, or leave it out"),
    "file without end": ("predict arm.yaml /dev/zero --out new.csv", "/dev/zero: is larger than 256 MB"),
}  # fmt: skip


@pytest.mark.parametrize(("command", "message"), BAD_OPTIONS.values(), ids=BAD_OPTIONS)
def test_bad_options_are_refused(refused, command, message):
    assert message in refused(command)


@pytest.mark.parametrize(  # other places that cannot be written: tests/core/base/test_files.py
    ("command", "place"),
    [("fit arm.yaml data.csv", "data.csv"), ("fit arm.yaml data.csv", "."), ("predict arm.yaml data.csv", "out"),
     ("predict arm.yaml data.csv", "no/p.csv"), ("simulate arm.yaml data.csv --sigma-mm 0 --seed 1", "/proc/p.csv")],
)  # fmt: skip
def test_a_place_that_cannot_be_written_is_refused_before_the_work(refused, command, place):
    assert refused(f"{command} --out", place).startswith(f"calib: {place}: cannot be written (")


def test_no_command_shows_the_help(run_calib):
    done = run_calib()
    assert done.code == 2
    assert "Usage: calib [OPTIONS] COMMAND" in done.err


@pytest.mark.quick(0)
def test_the_program_as_a_process_says_the_same(folder, spawn_calib):
    (folder / "bad.csv").write_text(data(line2="a,0,0,0,0,0"))
    before = tree(folder)
    done = spawn_calib("fit", "arm.yaml", "bad.csv", "--out", "out", cwd=folder)
    assert (done.code, done.out, done.err) == (2, "", "calib: bad.csv, line 2, column 'turn': 'a' is not a number\n")
    assert tree(folder) == before


def test_nothing_is_left_in_the_folder_for_temporary_files(folder, refused, monkeypatch, tmp_path_factory):
    temporary = tmp_path_factory.mktemp("temporary")
    monkeypatch.setenv("TMPDIR", str(temporary))
    refused(FIT.replace("data.csv", "no.csv"))
    assert os.listdir(temporary) == []  # noqa: PTH208


def test_a_validation_with_one_pose_has_no_number_that_is_none(tmp_path, run_calib):
    rows = (EXAMPLES / "five_bar_simulated.csv").read_text().splitlines()
    (tmp_path / "most.csv").write_text("\n".join(rows[:-1]) + "\n")
    (tmp_path / "one.csv").write_text("\n".join([*rows[:3], rows[-1]]) + "\n")
    command = f"fit {EXAMPLES / 'five_bar.yaml'} most.csv --validate one.csv --no-pages --out out --json found.json"
    done = run_calib(*command.split(), cwd=tmp_path)
    assert done.code == 0, done
    assert not re.search(r"\b(nan|inf)\b", done.out + done.err)
    content = json.loads((tmp_path / "found.json").read_text(), parse_constant=pytest.fail)
    assert content["errors"]["validation"]["after"]["std"] is None  # of one number
    assert "repeatability" not in done.out

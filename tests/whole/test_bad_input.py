"""Bad input on the command line: one clear line, exit code 2, nothing written, an existing result untouched."""

import json
import os
import re

import pytest

from tests.project import EXAMPLES
from tests.small_robots import ARM_URDF, ARM_YAML, write_arm

ROWS = ["turn,slide [mm],wrist [deg],tip_x [mm],tip_y [mm],tip_z [mm]"] + [
    f"{0.1 * k},{10 * k},{-5 * k},{375 + k},{20 - k},{600 + 2 * k}" for k in range(8)
]
DATA = "\n".join(ROWS) + "\n"
FIT = "fit arm.yaml data.csv --out new"
PREDICT = "predict arm.yaml data.csv --out new.csv"
SIMULATE = "simulate arm.yaml data.csv --sigma-mm 0.1 --seed 1 --out new.csv"


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


BAD_DATA = {  # what other readers of tables refuse: tests/core/data/test_tables.py, test_measurements.py
    "text": (data(line4="a,0,0,1,2,3"), "data.csv, line 4, column 'turn': 'a' is not a number"),
    "misspelt direction": (
        "turn,slide,wrist,tip_x,tip_y,tip_z,approach_sldie\n0,0,0,1,1,1,1\n",
        "data.csv, column 'approach_sldie': no joint 'sldie'; did you mean 'slide'?",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "message"), BAD_DATA.values(), ids=BAD_DATA)
def test_bad_measurements_are_refused(folder, refused, content, message):
    (folder / "data.csv").write_text(content)
    for command in (FIT, PREDICT, SIMULATE) if content == BAD_DATA["text"][0] else (FIT,):
        assert message in refused(command)


def test_data_that_is_not_there_is_refused(folder, refused):
    (folder / "data.csv").unlink()
    for command in (FIT, PREDICT, SIMULATE):
        assert refused(command) == "calib: data.csv: no such file; give a CSV file"
    (folder / "data.csv").mkdir()
    for command in (FIT, PREDICT, SIMULATE):
        assert refused(command) == "calib: data.csv: cannot be read (is a directory)"


BAD_ROBOTS = {  # more in tests/core/robots/test_description.py
    "no file": (None, "arm.yaml: no such file or folder; give a robot description"),
    "missing URDF": (ARM_YAML.replace("arm.urdf", "leg.urdf"), "leg.urdf: no such file; give the path of a URDF"),
    "zero byte in a name": (ARM_YAML.replace("arm.urdf", '"arm\\0.urdf"'), "holds \\x00, which nobody sees"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "message"), BAD_ROBOTS.values(), ids=BAD_ROBOTS)
def test_a_bad_description_is_refused(folder, refused, content, message):
    path = folder / "arm.yaml"
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    for command in (FIT, PREDICT, SIMULATE):
        assert message in refused(command)


LINK = '<link name="upper"/>'
MIMIC = ARM_URDF.replace("<limit", '<mimic joint="turn" {}="{}"/><limit', 1)
BAD_URDFS = {  # more in tests/core/robots/urdf/test_urdf_text.py
    "SDF": ("<?xml version='1.0'?><sdf version='1.7'/>", "arm.urdf: it has no model with links"),
    "mimic multiplier": (MIMIC.format("multiplier", "1e308"), "mimic multiplier: '1e308' is beyond 1e9"),
    "mimic offset": (MIMIC.format("offset", "-1e308"), "mimic offset: '-1e308' is beyond 1e9"),
    "unknown link": (ARM_URDF.replace('parent link="upper"', 'parent link="uper"'), "did you mean 'upper'?"),
    "entity of a file": (
        ARM_URDF.replace("<robot", '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/passwd">]><robot'),
        "arm.urdf, line 2: entity 'secret' stands for another file, which is not read",
    ),
    "entities without end": (
        '<!DOCTYPE robot [<!ENTITY a0 "' + "<link/>" * 9 + '">'
        + "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
        + "]><robot>&a11;</robot>",
        "arm.urdf",
    ),
    "overflow": (ARM_URDF.replace("0.25 0 0", "1e200 0 0"), "joint 'slide', xyz: '1e200' is beyond 1e9"),
    "a shape of nan": (
        ARM_URDF.replace(LINK, f'{LINK[:-2]}><visual><geometry><box size="nan 1 1"/></geometry></visual></link>'),
        "<box> of link 'upper' has size=\"nan 1 1\"",
    ),
    "links without end": (
        ARM_URDF.replace(LINK, LINK + "".join(f'<link name="l{k}"/>' for k in range(300))),
        "links, more than 300; cut the file down to the arm",
    ),
}  # fmt: skip


@pytest.mark.quick(3)
@pytest.mark.parametrize(("content", "message"), BAD_URDFS.values(), ids=BAD_URDFS)
def test_a_bad_urdf_is_refused(folder, refused, content, message):
    assert content != ARM_URDF
    (folder / "arm.urdf").write_bytes(content if isinstance(content, bytes) else content.encode())
    commands = FIT, "init arm.urdf --out new.yaml", "predict arm.urdf data.csv --out new.csv"
    for command in commands[:1] if "&a11;" in content else commands:  # a second to read
        assert message in refused(command)


@pytest.mark.quick(0)
def test_a_pose_that_cannot_be_assembled_is_refused_with_pose_and_loop(folder, refused):
    good = (EXAMPLES / "five_bar_simulated.csv").read_text().splitlines()[:12]  # two of them are comments
    (folder / "data.csv").write_text("\n".join([*good, "far,0,0,734,1350,-276"]) + "\n")
    for command in (FIT, PREDICT, SIMULATE):
        line = refused(command.replace("arm.yaml", str(EXAMPLES / "five_bar.yaml")))
        assert "data.csv, line 13 (pose far): " in line
        assert "its loops close only with passive joint left_elbow" in line


BAD_OPTIONS = {
    "validate fraction": (f"{FIT} --validate 1.5", "1.5 of 8 poses held out, no pose is left to"),
    "validate zero": (f"{FIT} --validate 0", "0 of 8 poses held out, no pose is left to"),
    "validate file": (f"{FIT} --validate other.csv", "other.csv: is neither a file nor a fraction"),
    "sigma text": (f"{FIT} --sigma-mm abc", "'--sigma-mm': 'abc' is not a valid float"),
    "sigma nan": (f"{FIT} --sigma-mm nan", "--sigma-mm nan: must be a positive number"),
    "sigma too small": (f"{FIT} --sigma-mm 1e-300", "--sigma-mm: '1e-300 mm' is too small to mean anything"),
    "sigma of simulate": (SIMULATE.replace("0.1", "inf"), "--sigma-mm inf: must be zero or a positive number"),
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
    "file without end": ("predict arm.yaml /dev/zero --out new.csv", "/dev/zero: is larger than 256 MB"),
    "broken result": (f"{PREDICT} --result out", "is not a result of format version"),
}  # fmt: skip


@pytest.mark.parametrize(("command", "message"), BAD_OPTIONS.values(), ids=BAD_OPTIONS)
def test_bad_options_are_refused(refused, command, message):
    assert message in refused(command)


BAD_PARAMETERS = {  # more in tests/core/data/test_parameter_files.py
    "missing file": (None, "p.csv: no such file"),
    "overflow": ("parameter,value,unit\nturn.x,1e300,mm\n", "p.csv, line 2, parameter 'turn.x': '1e300' is too large"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "message"), BAD_PARAMETERS.values(), ids=BAD_PARAMETERS)
def test_a_bad_parameter_file_is_refused(folder, refused, content, message):
    if content is not None:
        (folder / "p.csv").write_text(content)
    for command in (PREDICT, SIMULATE):
        assert message in refused(command, "--parameters", "p.csv")


BAD_PLACES = {
    "a file": ("data.csv", "data.csv: cannot be written (is a file, not a folder)"),
    "below a file": ("data.csv/out", "data.csv/out: cannot be written (a part of the path is a file, not a folder)"),
    "in /proc": ("/proc/out", "/proc/out: cannot be written ("),
    "in /sys": ("/sys/out", "/sys/out: cannot be written ("),
    "here": (".", ".: cannot be written (it holds the current folder; a result needs a folder of its own)"),
    "long name": ("x" * 300, "cannot be written (file name too long)"),
}  # fmt: skip


@pytest.mark.parametrize(("place", "message"), BAD_PLACES.values(), ids=BAD_PLACES)
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(refused, place, message):
    assert message in refused("fit arm.yaml data.csv --out", place)


@pytest.mark.parametrize("place", ["out", "data.csv/p.csv", "no/p.csv", "/proc/p.csv", "/sys/p.csv", "x" * 300])
def test_a_file_that_cannot_be_written_is_refused_before_the_work(refused, place):
    for command in ("predict arm.yaml data.csv", "simulate arm.yaml data.csv --sigma-mm 0 --seed 1"):
        line = refused(f"{command} --out", place)
        assert line.startswith(f"calib: {place}: cannot be written (")
        assert line.endswith("; choose another place for the output")


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


NESTED = "[" * 100_000
TARGETS = "tip_x [mm],tip_y [mm],tip_z [mm]\n375,20,600\n"
FOUND_BY_MUTATION = {
    "nested result": ("out/result.json", NESTED, f"{PREDICT} --result out", "out/result.json"),
    "nested parameters": ("out/parameters.csv", NESTED, f"{PREDICT} --parameters out/parameters.csv", "parameters.csv"),
    "blank cells": ("data.csv", ROWS[0] + "\n" + ",,,,,\n" * 8, f"{FIT} --validate 0.3", "data.csv"),
    "huge joint": ("data.csv", data(line3=ROWS[3].replace("20", "1e300", 1)), PREDICT, "data.csv, line 3"),
    "huge target": ("t.csv", TARGETS.replace("375", "1e300"), "solve arm.yaml t.csv --out new.csv", "t.csv, line 2"),
}


@pytest.mark.parametrize(("name", "content", "command", "message"), FOUND_BY_MUTATION.values(), ids=FOUND_BY_MUTATION)
def test_what_mutation_found_is_refused(folder, refused, name, content, command, message):
    (folder / name).write_text(content)
    assert message in refused(command)


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

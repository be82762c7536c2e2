"""The same mistakes with every kind of measurement: one line that says where, exit code 2, no result, no traceback."""

import csv

import numpy as np
import pytest

import calib
from calib.core.data.measurement_files import format_measurements
from tests.core.instruments.test_kind_pixel import INTRINSICS
from tests.six_axis_arm import joints, write_six_axis

KINDS = {
    "position": "{kind: position, target: ball, sigma: 0.02 mm}",
    "pose": "{kind: pose, target: ball, sigma: 0.02 mm}",
    "orientation": "{kind: orientation, target: ball, rotation: rpy, sigma: 0.02 mrad}",
    "distance": "{kind: distance, target: ball, end: {frame: l0, xyz: [1, 0, 0]}, sigma: 0.02 mm}",
    "touch": "{kind: touch, target: ball, sigma: 0.02 mm, places: {hole: {frame: l0, xyz: [0.5, 0.2, 0.6]},"
    " hollow: {frame: l0, xyz: [0.5, -0.2, 0.6]}}}",
    "pixel": "{kind: pixel, target: ball, sigma: 0.3, camera: {frame: l0, xyz: [0, 0, 3], rpy: [180 deg, 0, 0], pose:"
    f" known}}, intrinsics: {INTRINSICS}, points: {{p: [0, 0, 0], q: [0.1, 0, 0]}}}}",
    "joint_reading": "{kind: joint_reading, joint: j3, sigma: 0.02 mrad}",
}
YAML = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0}
targets: {ball: {frame: l6, xyz: [0.05, 0.02, 0.1]}}
instruments:
  seen: INSTRUMENT
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
"""


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Descriptions and tables that are right, by kind: YAML, header, rows."""
    result = {}
    for kind, words in KINDS.items():
        robot = calib.load(write_six_axis(tmp_path_factory.mktemp(kind), YAML.replace("INSTRUMENT", words)))
        if kind == "touch":
            result[kind] = [*robot.joint_names, "seen"], [[*map(str, q), "hole"] for q in joints(12, 1)]
            continue
        data = calib.simulate(robot, joints(12, 1) * 0.4, None, np.random.default_rng(0))
        text = [line for line in format_measurements(robot, data).splitlines() if not line.startswith("#")]
        names, *rows = (cells[1:] for cells in csv.reader(text))  # the first is the pose
        result[kind] = names, rows
    return result


def replaced(old, new):
    """An edit of the instrument's entry."""
    return lambda words: words.replace(old, new, 1)


def sigma(value):
    """The instrument's noise stated as this."""

    def edit(words):
        start = words.index("sigma: ") + len("sigma: ")
        stop = min(k for k in (words.find(",", start), words.find("}", start)) if k > 0)
        return words[:start] + value + words[stop:]

    return edit


IN_ENTRIES = {
    "a kind that there is not": (lambda words: words.replace("{kind: ", "{kind: x", 1), "unknown kind 'x"),
    "no kind": (lambda words: "{" + words.partition(", ")[2], "instruments.seen"),
    "an unknown key": (replaced("sigma:", "sigme:"), "unknown key 'instruments.seen.sigme'; did you mean 'sigma'"),
    "a negative noise": (sigma("-1"), "instruments.seen...sigma"),
    "no noise at all": (sigma("0"), "instruments.seen...sigma"),
    "noise of another dimension": (sigma("3 degC"), "instruments.seen...sigma"),
    "noise in an unknown unit": (sigma("3 furlong"), "instruments.seen...sigma"),
    "noise that is a word": (sigma("little"), "instruments.seen...sigma"),
    "noise that is not a number": (sigma(".nan"), "instruments.seen...sigma"),
    "infinite noise": (sigma(".inf"), "instruments.seen...sigma"),
    "a list in the place of the entry": (lambda words: f"[{words}]", "instruments.seen"),
    "nothing in the place of the entry": (lambda words: "", "instruments.seen"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mistake", IN_ENTRIES)
def test_a_mistake_in_an_entry_is_named(tmp_path, run_calib, kind, mistake):
    edit, said = IN_ENTRIES[mistake]
    assert edit(KINDS[kind]) != KINDS[kind]
    run = run_calib("check", write_six_axis(tmp_path, YAML.replace("INSTRUMENT", edit(KINDS[kind]))))
    line = run.refusal()
    assert all(words in line for words in said.split("...")), line


def header(column, change):
    def edit(names, rows):
        names = list(names)
        names[column] = change(names[column])
        return names, rows

    return edit


IN_FILES = {  # what is wrong with columns of joints is tested with one kind: test_bad_input.py
    "no header": (lambda names, rows: (rows[0], rows[1:]), ""),
    "no rows": (lambda names, rows: (names, []), "no rows"),
    "no column of the instrument": (header(-1, lambda _: "remark"), "seen"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mistake", IN_FILES)
def test_a_mistake_in_a_file_is_named(tmp_path, run_calib, good, kind, mistake):
    edit, said = IN_FILES[mistake]
    names, rows = edit(*good[kind])
    robot = write_six_axis(tmp_path, YAML.replace("INSTRUMENT", KINDS[kind]))
    (tmp_path / "data.csv").write_text("\n".join(",".join(cells) for cells in [names, *rows]) + "\n")
    run = run_calib("fit", robot, tmp_path / "data.csv", "--no-pages", "--out", tmp_path / "out")
    line = run.refusal()
    assert all(words in line for words in said.split("...")), line
    assert not (tmp_path / "out").exists()

"""Tables that other programs wrote: units in round brackets, joints by number, X, Y and Z."""

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.data.table_writing import format_table
from tests.project import EXAMPLES


def renamed(data, names):
    """The table of measurements under other names."""
    return {names.get(name, name): cells for name, cells in data.to_dict().items()}


def foreign(joint, axis):
    return {f"joint_{k} [deg]": joint.format(k) for k in range(1, 7)} | {
        f"reflector_{a} [mm]": axis.format(a, X=a.upper()) for a in "xyz"
    }


@pytest.mark.parametrize(
    ("joint", "axis"),
    [
        ("joint_{} (deg)", "reflector_{} (mm)"),
        ("J{} (°)", "{X} (mm)"),
        ("A{} [deg]", "{} [mm]"),
        ("Axis {} (deg)", "{}(mm)"),
        ("Joint-{} [ deg ]", "{} [mm]"),
    ],
)
def test_columns_of_other_programs_are_read_as_what_they_are(robot, data, caplog, joint, axis):
    result = calib.read_measurements(renamed(data, foreign(joint, axis)), robot)
    np.testing.assert_allclose(result.joints, data.joints, atol=1e-15)
    np.testing.assert_allclose(result.points(), data.points(), atol=1e-15)
    assert bool(caplog.records) == ("joint_" not in joint)
    for record in caplog.records:
        assert "for joint_1" in record.getMessage()


def test_numbers_go_to_the_joint_that_has_them_whatever_its_place(data):
    robot = calib.robot(EXAMPLES / "arm.urdf", motors=[f"joint_{k}" for k in (2, 1, 3, 4, 5, 6)], target="flange")
    poses = calib.read_poses(renamed(data, foreign("J{} [deg]", "{}")), robot)
    np.testing.assert_allclose(poses.joints, data.joints[:, [1, 0, 2, 3, 4, 5]], atol=1e-15)


def test_too_few_or_doubtful_columns_are_not_guessed(robot, data):
    names = foreign("J{} [deg]", "{} [mm]")
    with pytest.raises(calib.DataError, match="no column 'joint_1'"):
        calib.read_measurements(renamed(data, names | {"joint_6 [deg]": "J7 [deg]"}), robot)
    with pytest.raises(calib.DataError, match="no column 'joint_2'"):
        calib.read_measurements(renamed(data, names | {"joint_1 [deg]": "joint_1 [deg]"}), robot)


@pytest.mark.quick(0)
def test_the_command_line_tells_a_guess_in_one_line(data, tmp_path, run_calib):
    rows = renamed(data, foreign("J{} (deg)", "{} (mm)"))
    (tmp_path / "foreign.csv").write_text(format_table(list(rows.items())))
    run = run_calib("check", EXAMPLES / "arm.yaml", "foreign.csv", cwd=tmp_path)
    assert run.code == 0
    assert run.err.startswith("note: foreign.csv: took columns J1 for joint_1, J2 for joint_2")
    assert run.err.count("took columns") == 1
    assert run_calib("check", EXAMPLES / "arm.yaml", "foreign.csv", "--quiet", cwd=tmp_path).err == ""


@pytest.mark.parametrize(
    ("joint", "axis", "message"),
    [
        ("joint_{}_deg", "reflector_{} [mm]", "column 'joint_1_deg': write its unit in brackets: 'joint_1 [deg]'"),
        ("J{}", "{} [mm]", "column 'J1': looks like 'joint_1', but has no unit"),
        ("J{} deg", "{} [mm]", "column 'J1 deg': write its unit in brackets: 'J1 [deg]'"),
        ("J{} (grad)", "{} [mm]", "column 'J1 (grad)': unknown unit 'grad'; did you mean 'rad'?"),
        ("J{} [deg]", "reflector_{}_mm", "column 'reflector_x_mm': write its unit in brackets: 'reflector_x [mm]'"),
        ("J{} [deg]", "{} (in)", "column 'x (in)': unknown unit 'in'; valid: arcsec, deg, m, mm, mrad, rad, um, urad"),
    ],
)
def test_a_unit_that_is_missing_or_written_otherwise_is_named(robot, data, joint, axis, message):
    with pytest.raises(calib.DataError, match=re.escape(message)):
        calib.read_measurements(renamed(data, foreign(joint, axis)), robot)


def test_columns_that_are_not_needed_may_be_called_anything(robot, data):
    table = renamed(data, foreign("joint_{} [deg]", "reflector_{}_mm")) | {"joint_1 (raw)": ["-"] * len(data)}
    np.testing.assert_allclose(calib.read_poses(table, robot).joints, data.joints, atol=1e-15)


def test_messages_call_columns_as_the_file_does(robot, data):
    """A guessed name, and one of the description; the file has neither of the robot's."""
    named = renamed(data, foreign("J{} [deg]", "reflector_{} [mm]") | {"reflector_x [mm]": "reflektor_x"})
    nearest = r"no column 'reflector_x'; did you mean 'reflektor_x'\? The file.* J1, J2"
    with pytest.raises(calib.DataError, match=nearest):
        calib.read_measurements(named, robot)
    described = robot.description.model_copy(update={"columns": {"height": "reflector_z [mm]"}})
    other = replace(robot, description=described)
    named = renamed(data, {"reflector_z [mm]": "height"})
    named["height"] = ["high", *named["height"][1:]]
    with pytest.raises(calib.DataError, match="line 1, column 'height': 'high' is not a number"):
        calib.read_measurements(named, other)


def test_blanks_between_columns_are_named(robot, tmp_path):
    (tmp_path / "blanks.txt").write_text("J1 J2 J3 J4 J5 J6 X Y Z\n1.0 2.0 3.0 4.0 5.0 6.0 7.0 8.0 9.0\n")
    with pytest.raises(calib.DataError, match="blanks separate the columns; write commas, semicolons or tabs"):
        calib.read_measurements(tmp_path / "blanks.txt", robot)


@pytest.mark.parametrize("names", ["XYZ", "xyz", ["axis_x", "axis_y", "axis_z"]])
def test_columns_of_joints_that_are_called_like_axes_are_no_positions(tmp_path, names):
    links = "".join(f'<link name="l{k}"/>' for k in range(4))
    joints = "".join(
        f'<joint name="{name}" type="prismatic"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<axis xyz="{" ".join(str(int(k == a)) for a in range(3))}"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
        for k, name in enumerate(names)
    )
    (tmp_path / "machine.urdf").write_text(f'<robot name="machine">{links}{joints}</robot>')
    robot = calib.robot(tmp_path / "machine.urdf", target="l3")
    for headers in (names, [name.upper() for name in names]):
        poses = calib.read_poses({f"{header} [mm]": [100.0 * k] for k, header in enumerate(headers)}, robot)
        np.testing.assert_allclose(poses.joints, [[0.0, 0.1, 0.2]])

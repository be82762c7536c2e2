"""Poses and measurements from arrays: the same as from a file, and the same care."""

import numpy as np
import pytest

import calib
from tests.project import write_table
from tests.small_robots import ARM_YAML, write_arm

Q = np.array([[0.1, 0.2, 0.3], [0.2, 0.3, 0.4], [0.3, 0.4, 0.5]])
MISSED = np.where(np.arange(9).reshape(3, 1, 3) == 4, np.nan, 0.0)


def test_arrays_are_named_by_row_and_poses_stay_what_they_are(arm):
    poses = calib.as_poses(arm, Q)
    assert poses.names == ("0", "1", "2")
    assert poses.labels[2] == "pose 2"
    assert calib.as_poses(arm, poses) is poses


def test_measurements_from_arrays_are_those_of_a_file(arm, tmp_path):
    q = Q[[0, 0, 1]]
    positions = arm.positions(q)[:, 0] + np.array([[1e-3, 0, 0], [0, 2e-3, 0], [0, 0, 3e-3]])
    names, header = ("a", "a", "c"), "pose,turn,slide,wrist,tip_x,tip_y,tip_z"
    read = calib.read_measurements(write_table(tmp_path / "data.csv", header, names, q, positions), arm)
    made = calib.as_measurements(arm, q, positions, names)
    assert made.names == read.names == names
    assert made.pose_numbers.tolist() == [0, 0, 1]  # rows with the same name repeat a pose
    np.testing.assert_array_equal(made.joints, read.joints)
    for field in ("visits", "pairs", "values"):
        np.testing.assert_array_equal(getattr(made.readings["tip"], field), getattr(read.readings["tip"], field))


def test_a_row_of_nan_is_a_reading_that_was_not_taken(tmp_path):
    yaml = ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider}\n")
    arm = calib.load(write_arm(tmp_path, yaml))
    positions = arm.positions(Q)
    positions[1, 0] = np.nan
    data = calib.as_measurements(arm, Q, positions)
    assert data.readings["elbow"].visits.tolist() == [0, 2]
    assert data.readings["tip"].visits.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(data.points(arm), positions)
    by_name = calib.as_measurements(arm, Q, {"tip": positions[:, 1]})
    assert list(by_name.readings) == ["tip"]
    with pytest.raises(calib.DataError, match="no instrument 'tipp'; did you mean 'tip'"):
        calib.as_measurements(arm, Q, {"tipp": positions[:, 1]})
    with pytest.raises(calib.DataError, match=r"tip: readings of shape \(2, 3\); expected \(3, 3\)"):
        calib.as_measurements(arm, Q, {"tip": positions[:2, 1]})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda q, p: (q[:, :2], p, None), r"joint values of shape \(3, 2\); expected \(n, 3\)"),
        (lambda q, p: (q, p[:2], None), r"positions of shape \(2, 1, 3\); expected \(3, 1, 3\)"),
        (lambda q, p: (q, p[..., :2], None), r"positions of shape \(3, 1, 2\); expected \(3, 1, 3\)"),
        (lambda q, p: (q, p + MISSED, None), "pose 1: readings of 'tip' are not finite"),
        (lambda q, p: (q, p, ["a"]), "names: 1 for 3 poses; give one for each"),
        (lambda q, p: (q, p, ["a", "a", "b"]), "pose a: joint 'slide' differs by 100 mm among the rows of pose 'a'"),
    ],
)
def test_what_cannot_be_is_refused(arm, change, message):
    q, positions, names = change(Q, arm.positions(Q))
    with pytest.raises(calib.DataError, match=message):
        calib.as_measurements(arm, q, positions, names)

"""Poses and measurements from arrays: the same as from a file, and the same care."""

import numpy as np
import pytest
from small_robots import small_arm

import calib

Q = np.array([[0.1, 0.2, 0.3], [0.2, 0.3, 0.4], [0.3, 0.4, 0.5]])


@pytest.fixture
def arm(tmp_path):
    return small_arm(tmp_path)


def test_arrays_are_named_by_row_and_poses_stay_what_they_are(arm):
    poses = calib.as_poses(arm, Q)
    assert poses.names == ("0", "1", "2")
    assert poses.labels[2] == "pose 2"
    assert calib.as_poses(arm, poses) is poses


def test_measurements_from_arrays_are_those_of_a_file(arm, tmp_path):
    positions = arm.positions(Q)[:, 0] + np.array([[1e-3, 0, 0], [0, 2e-3, 0], [0, 0, 3e-3]])
    lines = ["pose,turn,slide,wrist," + ",".join(f"{arm.target_names[0]}_{axis}" for axis in "xyz")]
    names = ("a", "b", "c")
    lines += [
        ",".join([name, *map(repr, map(float, (*q, *p)))]) for name, q, p in zip(names, Q, positions, strict=True)
    ]
    (tmp_path / "data.csv").write_text("\n".join(lines))
    read = calib.read_measurements(tmp_path / "data.csv", arm)
    made = calib.as_measurements(arm, Q, positions, names)
    assert made.names == read.names
    for field in ("joints", "positions", "counts", "scatter"):
        np.testing.assert_array_equal(getattr(made, field), getattr(read, field))


def test_readings_with_the_same_name_are_averaged(arm):
    positions = arm.positions(Q[[0, 0, 1]])
    positions[1, 0, 0] += 2e-4
    data = calib.as_measurements(arm, Q[[0, 0, 1]], positions, ["first", "first", "second"])
    assert data.names == ("first", "second")
    assert data.counts.tolist() == [2, 1]
    assert data.positions[0, 0, 0] == pytest.approx(positions[0, 0, 0] + 1e-4)
    assert data.scatter[0, 0, 0] == pytest.approx(1e-4 * np.sqrt(2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda q, p: (q[:, :2], p, None), r"joint values of shape \(3, 2\); expected \(n, 3\)"),
        (lambda q, p: (q, p[:2], None), r"positions of shape \(2, 1, 3\); expected \(3, 1, 3\)"),
        (lambda q, p: (q, p[..., :2], None), r"positions of shape \(3, 1, 2\); expected \(3, 1, 3\)"),
        (
            lambda q, p: (q, np.where(np.arange(3)[:, None, None] == 1, np.nan, p), None),
            "pose 1: positions are not finite",
        ),
        (lambda q, p: (q, p, ["a"]), "names: 1 for 3 poses; give one for each"),
        (lambda q, p: (q, p, ["a", "a", "b"]), "pose a: joint 'slide' differs by 100 mm among the rows of pose 'a'"),
    ],
)
def test_what_cannot_be_is_refused(arm, change, message):
    q, positions, names = change(Q, arm.positions(Q))
    with pytest.raises(calib.DataError, match=message):
        calib.as_measurements(arm, q, positions, names)

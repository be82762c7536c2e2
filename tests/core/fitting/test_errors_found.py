"""Errors before and after: tables by hand, means of repeats, gaps, and one table for each instrument and part."""

import numpy as np
import pytest

import calib
from calib.core.fitting.error_sets import ErrorSet, error_table
from calib.core.instruments.kind import Part
from tests.small_robots import ARM_YAML, small_arm, write_arm

TWO = (
    ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider}\n")
    + "instruments:\n  tracker: {kind: position, target: tip}\n  arm: {kind: position, target: elbow}\n"
)


def errors_of(robot, names, **after):
    """Errors after calibration [m] of instruments, before it ten times as large; rows of NaN were not read."""
    q = np.zeros((len(names), 3))
    data = calib.as_measurements(robot, q, {name: np.array(rows, dtype=float) for name, rows in after.items()}, names)
    kept = {name: np.array(rows, dtype=float)[data.readings[name].visits] for name, rows in after.items()}
    before = {name: 10 * rows for name, rows in kept.items()}
    return ErrorSet(data, robot.instruments, before, kept, np.full(len(names), np.inf))


def test_an_error_table_by_hand():
    table = error_table(np.array([[3e-3, 0, 4e-3], [0, -1e-3, 0]]))
    by_hand = {"mean": 3.0, "max": 5.0, "rms": np.sqrt(13), "std": np.sqrt(8), "median": 3.0, "p90": 4.6, "p95": 4.8}
    assert {name: table[name] for name in by_hand} == pytest.approx(by_hand)
    assert [table[axis]["mean"] for axis in "xyz"] == pytest.approx([1.5, 0.5, 2.0])
    assert [table["y"][name] for name in ("bias", "max", "p95")] == pytest.approx([-0.5, 1.0, 0.95])
    assert table["z"]["rms"] == pytest.approx(np.sqrt(8))
    assert np.isnan(error_table(np.zeros((1, 3)))["std"])  # the scatter of a single error is unknown


def test_components_that_were_not_read_are_left_out_of_a_table():
    part = Part("orientation", ("rx", "ry"), "angle")
    table = error_table(np.array([[3e-3, 4e-3], [5e-3, np.nan]]), part)
    assert table["max"] == pytest.approx(5.0)  # mrad
    assert table["mean"] == pytest.approx(5.0)
    assert table["rx"]["mean"] == pytest.approx(4.0)
    assert table["ry"]["mean"] == pytest.approx(4.0)
    assert "x" not in table


def test_readings_that_repeat_a_pose_count_once_by_their_mean(tmp_path):
    errors = errors_of(small_arm(tmp_path), ["a", "b", "a"], tip=[[1e-3, 0, 0], [0, 2e-3, 0], [3e-3, 0, 4e-3]])
    np.testing.assert_allclose(errors.errors("after"), [[2e-3, 0, 2e-3], [0, 2e-3, 0]])
    assert errors.errors("after", single=True).shape == (3, 3)
    table = errors.table()
    assert table["after"]["max"] == pytest.approx(2 * np.sqrt(2))
    assert table["before"]["max"] == pytest.approx(20 * np.sqrt(2))


def test_every_instrument_has_a_table_of_its_own(tmp_path):
    robot = calib.load(write_arm(tmp_path, TWO))
    errors = errors_of(robot, ["a", "b"], tracker=[[1e-3, 0, 0], [np.nan] * 3], arm=[[0, 2e-3, 0], [0, 0, 4e-3]])
    tables = errors.tables()
    assert list(tables) == ["tracker", "arm"]
    assert tables["tracker"]["position"]["after"]["max"] == pytest.approx(1.0)
    assert tables["arm"]["position"]["after"]["mean"] == pytest.approx(3.0)
    assert errors.table()["after"]["mean"] == pytest.approx((1 + 2 + 4) / 3)  # all three readings
    assert errors.errors("after", "orientation").shape == (0, 3)
    read_by_one = errors_of(robot, ["a", "b"], arm=[[0, 2e-3, 0], [0, 0, 4e-3]])
    assert list(read_by_one.tables()) == ["arm"]
    with pytest.raises(ValueError, match="read-only"):
        errors.after["arm"][0] = 1

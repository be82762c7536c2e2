"""What calibration is for: MedRUE from simulated measurements, and a real arm from a laser tracker's."""

import numpy as np
import pytest

import calib
from calib.core.rows.registration import register
from medrue.closed_form import forward
from medrue.paper_tables import PARAMETERS, table1
from medrue.workspace import target_workspace
from tests.public_data import motoman

NAMES = list(PARAMETERS)


def test_without_noise_every_kept_parameter_of_table_1_comes_back_to_a_nanometre(robot):
    q = np.array(target_workspace().q)
    fit = calib.fit(robot, calib.as_measurements(robot, q, forward(q, table1().actual).p_world_tool))
    kept = np.array([name not in table1().redundant for name in NAMES])
    # the redundant ones are nominal in Table I's actual column too, so that the others have unique true values
    assert np.array_equal(table1().actual[~kept], table1().nominal[~kept])
    error = np.abs(fit.robot.values - table1().actual)
    angles = np.array([unit == "rad" for unit in table1().units])
    assert np.max(1e3 * error[~angles]) < 1e-6  # mm
    assert np.max(np.degrees(error[angles])) < 1e-6
    assert kept.sum() == 28 == fit.rank.rank
    assert (fit.rank_all.rank, fit.rank_all.n_columns) == (28, 36)


def test_a_real_arm_placed_without_expecting_the_reflector_anywhere_is_as_others_found(shared_data):
    robot, train, test = motoman(shared_data / "motoman_right", (", sigma: 10 mm}", "}"))
    placed = register(robot, train)
    errors = placed.positions(test.joints) - test.points(robot)
    assert 1e3 * np.sqrt(np.mean(np.sum(errors**2, axis=(1, 2)))) == pytest.approx(0.253, abs=0.001)


def test_a_real_arm_also_works_from_its_plain_urdf(shared_data, tmp_path):
    robot = calib.load(shared_data / "motoman_right" / "robot.urdf")
    columns = {"x1": "flange_x", "y1": "flange_y", "z1": "flange_z"}
    text = (shared_data / "motoman_right" / "train.csv").read_text()
    header, rest = text.split("\n", 1)
    (tmp_path / "plain.csv").write_text(",".join(columns.get(name, name) for name in header.split(",")) + "\n" + rest)
    fit = calib.fit(robot, calib.read_measurements(tmp_path / "plain.csv", robot))
    after = fit.identification.table()["after"]["rms"]
    assert after <= 0.075

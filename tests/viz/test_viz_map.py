"""The map of the workspace: its numbers are those of the engine, and it says what lies beyond the measured region."""

import numpy as np
import pytest

import calib
from tests.viz.viz_examples import five_bar_fit, medrue_fit
from viz.inputs import gather
from viz.poses import PredictingRobot
from viz.scene import scene_of_fit
from viz.scene_data import scene_data
from viz.workspace_map import SEED, workspace_map


@pytest.fixture(scope="module")
def arm():
    robot = calib.load("docs/examples/arm.yaml")
    fit = calib.fit(robot, calib.read_measurements("docs/examples/arm_simulated.csv", robot))
    table = scene_of_fit(fit).poses
    return fit, table, workspace_map(PredictingRobot(fit.robot, fit.predict), fit.placed, table, 60)


def test_error_and_uncertainty_are_those_of_the_engine(arm):
    fit, table, result = arm
    q = np.concatenate([calib.sample(fit.robot, 30, seed=SEED, within=of).joints for of in (None, table.joints)])
    after, before = fit.robot.positions(q)[:, 0], fit.placed.positions(q)[:, 0]
    np.testing.assert_allclose(result.places, after, atol=1e-12)
    np.testing.assert_allclose(result.error, np.linalg.norm(before - after, axis=1), atol=1e-12)
    np.testing.assert_allclose(result.std, fit.predict(q).distance[:, 0], rtol=1e-9)


def test_what_lies_beyond_the_measured_poses_is_known(arm):
    _, table, result = arm
    assert 0 < np.sum(result.is_inside) < len(result.is_inside)
    box = table.measured.min(axis=0), table.measured.max(axis=0)  # the hull is inside its box
    assert np.all((result.places[result.is_inside] >= box[0]) & (result.places[result.is_inside] <= box[1]))
    assert np.median(result.std[result.is_inside]) < np.median(result.std[~result.is_inside])
    corners = result.hull.reshape(-1, 3)
    assert np.all(np.min(np.linalg.norm(corners[:, None] - table.measured[None], axis=2), axis=1) < 1e-12)


def test_ellipsoids_hold_ninety_five_of_a_hundred_draws_of_the_prediction(arm):
    fit, table, result = arm
    rng = np.random.default_rng(0)
    row = int(np.argmin(np.linalg.norm(table.after - result.centres[5], axis=1)))
    known = fit.predict(table.joints[row][None])
    np.testing.assert_allclose(known.positions[0, 0], result.centres[5], atol=1e-9)
    draws = rng.multivariate_normal(np.zeros(3), known.covariance[0, 0], 20000)
    inside = np.linalg.norm(np.linalg.solve(result.half_axes[5], draws.T), axis=0) <= 1
    # the covariance's own size is estimated: half axes are longer by the coverage factor over the normal one
    assert 0.95 - 0.005 < np.mean(inside) < 0.975


def test_a_robot_that_moves_in_a_plane_was_measured_within_an_outline():
    fit = five_bar_fit()
    result = gather(fit.nominal, fit, mapped=100).scene.map
    assert 10 < np.sum(result.is_inside) < 100
    corners = np.unique(result.hull.reshape(-1, 3), axis=0)
    assert len(corners) == len(result.hull)  # a closed polygon has as many edges as corners


def test_without_a_result_there_is_no_map_and_it_is_asked_for_in_vain(run_calib):
    run = run_calib("view", "docs/examples/arm.yaml", "--map", "--html", "never.html")
    assert run.code == 2
    assert run.err.startswith("calib: --map shows what a calibration knows")
    assert run_calib("view", "docs/examples/arm.yaml", "--map", "-3", "--html", "never.html").code == 2


def test_the_page_has_a_map_where_it_was_asked_for_and_none_elsewhere():
    fit = medrue_fit(validation=None)
    assert scene_data(gather(fit.nominal, fit).scene)["map"] is None
    data = scene_data(gather(fit.nominal, fit, mapped=8).scene)["map"]
    assert data["n"] == 8
    assert 0 < data["ranges"]["std"][0] < data["ranges"]["std"][1] < 1e-2
    assert len(data["centres"]) == len(data["half_axes"]) == 40

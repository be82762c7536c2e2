"""Second derivatives of read positions against differences of fourth order, and what they say of intervals."""

import numpy as np
import pytest
from small_robots import ARM_URDF, ARM_YAML, write_arm

import calib
from calib.core.fitting import curvature
from calib.core.fitting.fit import minimum_of
from calib.core.fitting.problem import Problem
from calib.core.fitting.settings import Settings
from calib.core.rows.second_derivative import bend_simply, bends

PLACED = ARM_YAML.replace("frame: ground}", "frame: ground, pose: unknown}")
TOWARDS_THE_ROOT = ARM_YAML.replace("frame: ground}", "frame: hand, pose: unknown}").replace(
    "frame: tool, xyz: [10 mm, 20 mm, 30 mm]", "frame: ground, position: unknown"
)
TRACKER = PLACED.replace("targets:\n", "targets:\n  corner: {frame: slider, position: unknown}\n") + (
    "sigma: {range: 0.01 mm, angle: 0.02 mrad}\n"
)
TERMS = (
    PLACED
    + """\
  - {joint: turn, term: gain, sigma: 1 mrad}
  - {joint: wrist, term: harmonics, orders: [1], sigma: 1 mrad}
  - {joint: wrist, term: coupling, driven_by: slide, sigma: 1 mrad}
"""
)
FOLLOWING = ARM_URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/> <mimic joint="turn" multiplier="0.5"/>')
LED = TERMS.replace("slide, wrist]", "slide]").replace("joint: wrist", "joint: turn")
ROBOTS = {
    "placed": (PLACED, ARM_URDF),
    "seen from the hand": (TOWARDS_THE_ROOT, ARM_URDF),
    "two targets, correlated noise": (TRACKER, ARM_URDF),
    "joint terms": (TERMS, ARM_URDF),
    "a joint that follows": (LED, FOLLOWING),
}


def measured(folder, yaml=PLACED, urdf=ARM_URDF, n=12):
    """A small arm away from nominal, and its simulated measurements."""
    robot = calib.load(write_arm(folder, yaml, urdf))
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    off = robot.with_parameters(robot.values + 20 * sigma * np.random.default_rng(1).standard_normal(len(sigma)))
    data = calib.simulate(off, off.sample(n, seed=2), seed=3, **({} if "range" in yaml else {"sigma": 3e-5}))
    return off, data


@pytest.mark.parametrize("robot", ROBOTS)
def test_second_derivatives_are_those_of_differences(robot, tmp_path):
    off, data = measured(tmp_path, *ROBOTS[robot])
    problem = Problem.of(off, data)
    unknowns, groups = problem.unknowns, np.full(len(problem.whitening.groups), 1.7)
    at = problem.evaluate(off)
    rows = problem.rows(at, groups)
    assert bend_simply(off, problem.whitening)
    known = bends(off, at.configurations, at.readings, rows, problem.whitening, groups, unknowns.index)
    unit = rows.jacobian / np.linalg.norm(rows.jacobian, axis=0)
    result = known.times(np.diag(1.0 / np.linalg.norm(rows.jacobian, axis=0)))
    assert np.array_equal(result, result.transpose(0, 2, 1))

    def jacobian(k, step):
        away = rows.deviations + np.where(np.arange(len(unknowns)) == k, step / unknowns.scales, 0.0)
        return problem.rows(problem.evaluate(unknowns.moved(off, away)), groups).jacobian

    expected = np.empty_like(result)
    for k in range(len(unknowns)):
        near, far = (jacobian(k, step) - jacobian(k, -step) for step in (1e-3, 2e-3))
        expected[:, k] = unit.T @ (8 * near - far) / (12 * 1e-3) / unknowns.scales
    # twists are differences by 1e-6; the fifth derivative by steps of 1 mrad is far below
    assert np.max(np.abs(result - expected)) <= 3e-6 * np.max(np.abs(expected))


def fitted(folder, yaml=PLACED):
    """What `mean_square_beyond_linear` is asked of at the minimum of a small arm."""
    off, data = measured(folder, yaml, n=40)
    solved = minimum_of(off, Settings(), data).solved
    return solved.problem, solved.at, solved.problem.rows(solved.at, solved.groups), solved.groups


@pytest.mark.parametrize("yaml", [PLACED, TRACKER, TERMS], ids=["placed", "two targets", "joint terms"])
def test_squares_beyond_the_linear_model_are_those_of_differences(yaml, tmp_path, monkeypatch):
    at = fitted(tmp_path, yaml)
    exact = curvature.mean_square_beyond_linear(*at)
    monkeypatch.setattr(curvature, "bend_simply", lambda *_: False)
    by_step = []
    for step in (0.02, 0.01):
        monkeypatch.setattr(curvature, "_STEP", step)
        by_step.append(curvature.mean_square_beyond_linear(*at))
    assert np.max(exact) > 1e-13
    variances = np.sum(at[2].known.root ** 2, axis=1) * at[0].unknowns.scales ** 2
    # differences are of one side, extrapolated; an interval does not feel a millionth of its square
    assert np.all(np.abs(exact - (2 * by_step[1] - by_step[0])) <= 1e-3 * exact + 1e-6 * variances)

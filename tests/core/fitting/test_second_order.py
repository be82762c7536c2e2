"""What parameters are off beyond the linear model, against second differences of what is read."""

import numpy as np
import pytest

import calib
from calib.core.fitting import curvature
from calib.core.fitting.fit import minimum_of
from calib.core.fitting.settings import Settings
from calib.core.numerics import linalg
from calib.core.numerics.statistics import prior_shares
from tests.small_robots import ARM_YAML, write_arm

SMALL = ARM_YAML.replace("all, components: [x", "wrist, components: [x").replace("all,", "slide,")
PLACED = SMALL.replace("frame: ground}", "frame: ground, pose: unknown}")
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
STEP = 0.1  # standard deviations


def fitted(folder, yaml, n):
    """What `mean_square_beyond_linear` is asked of at the minimum of a small arm."""
    robot = calib.load(write_arm(folder, yaml))
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    off = robot.with_parameters(robot.values + 20 * sigma * np.random.default_rng(1).standard_normal(len(sigma)))
    data = calib.simulate(off, off.sample(n, seed=2), seed=3, **({} if "range" in yaml else {"sigma": 3e-5}))
    solved = minimum_of(off, Settings(), data).solved
    return solved.problem, solved.evaluation, solved.problem.rows(solved.evaluation, solved.groups), solved.groups


def expected(problem, at, rows, groups):
    """E e^2 of all pairs of directions, each by second differences of the residuals alone."""
    root, unknowns = rows.posterior_information.root, problem.unknowns
    shares, turned = linalg.eigh(prior_shares(rows.posterior_information, rows.prior))
    directions = root @ turned

    def residuals(step):
        return problem.residuals(problem.evaluate(unknowns.robot_at(at.robot, rows.deviations + step), at), groups)

    def back(i, j):
        one, other = STEP * directions[:, i], STEP * directions[:, j]
        corners = [s * t * residuals(s * one + t * other) for s in (1, -1) for t in (1, -1)]
        return -root @ (root.T @ (rows.jacobian.T @ (sum(corners) / (4 * STEP**2))))

    squares, mean = np.zeros(len(root)), np.zeros(len(root))
    for i in range(len(shares)):
        for j in range(i, len(shares)):
            if max(shares[i], shares[j]) > 0.1:
                bent = back(i, j)
                squares += (0.5 if i == j else 1.0) * bent**2
                mean += 0.5 * bent if i == j else 0.0
    return unknowns.scales**2 * (squares + mean**2)


@pytest.mark.quick(1)
@pytest.mark.parametrize("yaml", [PLACED, TRACKER, TERMS], ids=["placed", "two targets", "joint terms"])
def test_squares_beyond_the_linear_model_are_those_of_second_differences(yaml, tmp_path):
    at = fitted(tmp_path, yaml, 16)
    squares = curvature.mean_square_beyond_linear(*at)
    variances = np.sum(at[2].posterior_information.root ** 2, axis=1) * at[0].unknowns.scales ** 2
    assert np.max(squares) > 1e-13
    # differences are of one side; an interval does not feel a thousandth of its square
    assert np.all(np.abs(squares - expected(*at)) <= 1e-2 * squares + 1e-3 * variances)


@pytest.mark.parametrize("yaml", [PLACED, TRACKER], ids=["placed", "two targets"])
def test_some_poses_tell_as_much_of_it_as_all(yaml, tmp_path, monkeypatch):
    at = fitted(tmp_path, yaml, 120)
    of_all = curvature.mean_square_beyond_linear(*at)
    monkeypatch.setattr(curvature, "_POSES", 40)
    variances = np.sum(at[2].posterior_information.root ** 2, axis=1) * at[0].unknowns.scales ** 2
    assert np.all(np.abs(curvature.mean_square_beyond_linear(*at) - of_all) <= 1e-3 * (of_all + variances))

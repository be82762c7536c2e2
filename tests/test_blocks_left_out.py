"""Blocks of poses left out in turn, against fits that really leave them out."""

import re
from dataclasses import replace

import numpy as np
import pytest
from six_axis_arm import FREE, YAML, joints, measurements, noisy, six_axis_arm, write_six_axis

import calib
from calib.identification.blocks_left_out import left_out
from calib.identification.validation import boxes

SIGMA = 4e-5


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML + FREE))


@pytest.fixture(scope="module")
def fit(arm):
    return calib.fit(arm, noisy(arm, joints(60), SIGMA, 1), sigma=SIGMA)


def without(fit, use):
    """Scaled parameters by some rows (n,), priors included, and the information of these rows, by plain algebra."""
    rows = fit.linear.rows.at_minimum()
    observed = rows.residuals - rows.jacobian @ rows.deviations
    information = rows.jacobian[use].T @ rows.jacobian[use] + np.diag(1.0 * rows.has_prior)
    return -np.linalg.solve(information, rows.jacobian[use].T @ observed[use]), information


def test_the_ratio_is_by_how_much_parameters_move_when_blocks_are_left_out(fit):
    blocks = boxes(fit.identification.data, 6)
    layout = fit.rows.layout
    visit = layout.visit[layout.reading]
    every, information = without(fit, np.full(len(visit), True))
    moved, effective = 0.0, 0.0
    for block in blocks:
        one, known = without(fit, ~np.isin(visit, block))
        moved += (every - one) @ known @ (every - one) / fit.linear.factor**2
        effective += np.trace(np.linalg.solve(information, information - known))
    assert effective == pytest.approx(fit.statistics.effective_parameters, rel=1e-3)
    assert left_out(fit.linear, blocks).ratio == pytest.approx(np.sqrt(moved / effective), rel=1e-4)


def test_by_noise_alone_the_chance_is_what_it_says(fit):
    linear, blocks, rng = fit.linear, boxes(fit.identification.data, 8), np.random.default_rng(2)
    chances, ratios = [], []
    for _ in range(400):
        drawn = rng.standard_normal(len(linear.rows.residuals))
        drawn += linear.rows.jacobian[:, linear.rows.has_prior] @ rng.standard_normal(int(linear.rows.has_prior.sum()))
        left = drawn - linear.pulled @ (linear.pulled.T @ drawn)
        found = replace(linear, rows=replace(linear.rows, residuals=left), factor=1.0)
        one = left_out(found, blocks)
        chances.append(one.chance)
        ratios.append(one.ratio**2)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)  # its standard error is 0.01
    assert 0.01 < np.mean(np.array(chances) < 0.05) < 0.1


def test_a_block_that_decides_all_by_itself_says_nothing(tmp_path):
    robot = six_axis_arm(tmp_path)  # without priors
    fit = calib.fit(robot, noisy(robot, joints(60), SIGMA, 1), sigma=SIGMA)
    found = left_out(fit.linear, [np.arange(60)])
    assert np.isnan(found.ratio)
    assert found.chance == 1.0


def bent(robot, q):
    """Where targets are if the error of the first joint depends on two others."""
    off = q.copy()
    off[:, 0] += 2e-4 * np.sin(q[:, 1]) * np.cos(2.0 * q[:, 2])
    return robot.positions(off)


def found(fit):
    return next((one for one in fit.verdict.reasons if one.code == "blocks_disagree"), None)


def too_sure(fit, q, truth):
    """How many times further off than promised predictions are."""
    predicted = fit.predict(q)
    return float(np.sqrt(np.mean(np.sum((predicted.positions - truth) ** 2, axis=-1)) / np.mean(predicted.distance**2)))


def test_what_the_model_leaves_out_is_a_check_that_says_how_much_too_sure_the_fit_is_at_least(arm):
    q, other = joints(120), joints(400, 5)
    noise = SIGMA * np.random.default_rng(1).standard_normal((120, 1, 3))
    fit = calib.fit(arm, measurements(arm, q, bent(arm, q) + noise))
    told = float(re.search(r"parameters move ([\d.]+) times", found(fit).text)[1])
    assert found(fit).grade == "CHECK"
    assert 1.3 < told < too_sure(fit, other, bent(arm, other))
    healthy = calib.fit(arm, measurements(arm, q, arm.positions(q) + noise))
    assert found(healthy) is None
    assert too_sure(healthy, other, arm.positions(other)) < 1.3


def test_setups_that_do_not_agree_are_said_to_be_setups(arm, tmp_path):
    """The third joint stands otherwise on the left than on the right, and the tracker was moved in between."""
    yaml = YAML.replace("base: {frame: l0}", "base: {frame: l0, pose: unknown}")
    moving = calib.load(write_six_axis(tmp_path, f"{yaml}{FREE}setups: {{left: [], right: [base]}}\n"))

    def measured(points, name):
        side = np.where(np.arange(120) < 60, 1.0, -1.0)
        seen = points(q)[:, 0] + SIGMA * np.random.default_rng(1).standard_normal((120, 3))
        seen[60:] = seen[60:] @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [0.3, 2.0, 0.1]
        rows = [
            ",".join([*map(repr, map(float, [*joint, *point])), "left" if one > 0 else "right"])
            for joint, point, one in zip(q, seen, side, strict=True)
        ]
        header = ",".join([*(f"j{k} [rad]" for k in range(1, 7)), *(f"ball_{a} [m]" for a in "xyz"), "setup"])
        (tmp_path / name).write_text("\n".join([header, *rows]) + "\n")
        return calib.read_measurements(tmp_path / name, moving)

    q = joints(120) * [0.5, 0.5, 1.0, 1.0, 1.0, 1.0]
    q[:, :2] += np.where(np.arange(120) < 60, 0.8, -0.8)[:, None]
    twisted = measured(lambda q: arm.positions(q + [[0, 0, 2e-4, 0, 0, 0]] * np.sin(q[:, :1])), "twisted.csv")
    text = found(calib.fit(moving, twisted)).text
    assert text.startswith("with whole setups left out in turn")
    assert found(calib.fit(moving, measured(arm.positions, "good.csv"))) is None

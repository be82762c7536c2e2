"""Blocks of poses left out in turn: what the verdict says of them (numerics/test_clusters.py holds the numbers)."""

import re

import numpy as np
import pytest

import calib
from tests.project import write_table
from tests.six_axis_arm import FREE, YAML, joints, measurements, write_six_axis

SIGMA = 4e-5


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML + FREE))


def bent(robot, q):
    """Where targets are if the error of the first joint depends on two others."""
    off = q.copy()
    off[:, 0] += 2e-4 * np.sin(q[:, 1]) * np.cos(2.0 * q[:, 2])
    return robot.positions(off)


def codes_of(fit):
    return next((reason for reason in fit.verdict.reasons if reason.code == "blocks_disagree"), None)


def too_sure(fit, q, truth):
    """How many times further off than promised predictions are."""
    predicted = fit.predict(q)
    return float(np.sqrt(np.mean(np.sum((predicted.positions - truth) ** 2, axis=-1)) / np.mean(predicted.distance**2)))


def test_parameters_that_blocks_disagree_on_are_a_check_and_predictions_count_what_is_left_out(arm):
    q, other = joints(120), joints(400, 5)
    noise = SIGMA * np.random.default_rng(1).standard_normal((120, 1, 3))
    fit = calib.fit(arm, measurements(arm, q, bent(arm, q) + noise))
    told = float(re.search(r", ([\d.]+) times more than noise", codes_of(fit).text)[1])
    assert codes_of(fit).grade == "CHECK"
    assert told > 1.3
    assert too_sure(fit, other, bent(arm, other)) < 1.3
    assert float(f"{fit.interval_factor:.2g}") == told
    healthy = calib.fit(arm, measurements(arm, q, arm.positions(q) + noise))
    assert healthy.interval_factor == 1.0
    assert codes_of(healthy) is None
    assert too_sure(healthy, other, arm.positions(other)) < 1.3


def test_setups_that_do_not_agree_are_said_to_be_setups(arm, tmp_path):
    """The third joint stands otherwise on the left than on the right, and the tracker was moved in between."""
    yaml = YAML.replace("base: {frame: l0}", "base: {frame: l0, pose: unknown}")
    moving = calib.load(write_six_axis(tmp_path, f"{yaml}{FREE}setups: {{left: [], right: [base]}}\n"))

    def measured(points, name):
        seen = points(q)[:, 0] + SIGMA * np.random.default_rng(1).standard_normal((120, 3))
        seen[60:] = seen[60:] @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [0.3, 2.0, 0.1]
        header = [*(f"j{k} [rad]" for k in range(1, 7)), *(f"ball_{a} [m]" for a in "xyz"), "setup"]
        path = write_table(tmp_path / name, header, q, seen, ["left"] * 60 + ["right"] * 60)
        return calib.read_measurements(path, moving)

    q = joints(120) * [0.5, 0.5, 1.0, 1.0, 1.0, 1.0]
    q[:, :2] += np.where(np.arange(120) < 60, 0.8, -0.8)[:, None]
    twisted = measured(lambda q: arm.positions(q + [[0, 0, 2e-4, 0, 0, 0]] * np.sin(q[:, :1])), "twisted.csv")
    text = codes_of(calib.fit(moving, twisted)).text
    assert text.startswith("the parameters depend on the setup")
    assert codes_of(calib.fit(moving, measured(arm.positions, "good.csv"))) is None


@pytest.mark.quick(0)
def test_intervals_of_parameters_are_as_wide_as_regions_disagree(arm, tmp_path):
    """What draws of the noise alone scatter by is less: the interval of a parameter holds what another region says."""
    q = joints(120)
    points = bent(arm, q)
    draws = [
        calib.fit(arm, measurements(arm, q, points + SIGMA * np.random.default_rng(k).standard_normal((120, 1, 3))))
        for k in range(12)
    ]
    values = np.array(
        [[parameter.value_si for parameter in fit.parameters.values() if parameter.std_si > 0] for fit in draws]
    )
    told = np.array(
        [[parameter.std_si for parameter in fit.parameters.values() if parameter.std_si > 0] for fit in draws]
    )
    assert np.median(np.std(values, axis=0, ddof=1) / np.mean(told, axis=0)) < 0.8
    fit = draws[0]
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(
        [parameter.std_si for parameter in fit.parameters.values() if parameter.std_si > 0]
    )
    fit.save(tmp_path / "out")
    saved = calib.load_result(tmp_path / "out")
    assert saved.content["widened"] == pytest.approx(fit.interval_factor)
    assert saved.covariance.values == pytest.approx(fit.covariance.values, rel=1e-6)
    assert saved.predict(q[:5]).std == pytest.approx(fit.predict(q[:5]).std, rel=1e-6)

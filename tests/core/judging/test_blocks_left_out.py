"""Blocks of poses left out in turn: what the verdict says of them (numerics/test_clusters.py holds the numbers)."""

import numpy as np
import pytest

import calib
from calib.core.judging.reasons import Code
from tests.core.judging.situations import SIGMA, bent
from tests.project import write_table
from tests.six_axis_arm import FREE, YAML, joints, measurements, write_six_axis


def too_sure(fit, q, truth):
    """How many times further off than promised predictions are."""
    predicted = fit.predict(q)
    return float(np.sqrt(np.mean(np.sum((predicted.positions - truth) ** 2, axis=-1)) / np.mean(predicted.distance**2)))


def test_where_blocks_disagree_predictions_count_what_is_left_out(shop):
    fits, other = shop.situation(Code.BLOCKS_DISAGREE), joints(400, 5)
    assert fits.there.interval_factor > 1.3
    assert too_sure(fits.there, other, shop.prior.positions(bent(other))) < 1.3
    assert fits.gone.interval_factor == 1.0
    assert too_sure(fits.gone, other, shop.prior.positions(other)) < 1.3


def test_setups_that_do_not_agree_are_said_to_be_setups(shop, tmp_path):
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
    positions = shop.prior.positions
    twisted = measured(lambda q: positions(q + [[0, 0, 2e-4, 0, 0, 0]] * np.sin(q[:, :1])), "twisted.csv")
    reasons = calib.fit(moving, twisted).verdict.reasons
    (text,) = (reason.text for reason in reasons if reason.code == "blocks_disagree")
    assert text.startswith("the parameters depend on the setup")
    good = calib.fit(moving, measured(positions, "good.csv"))
    assert "blocks_disagree" not in good.verdict.to_dict()["codes"]


@pytest.mark.quick(0)
def test_intervals_of_parameters_are_as_wide_as_regions_disagree(shop, tmp_path):
    """What draws of the noise alone scatter by is less: the interval of a parameter holds what another region says."""
    arm, q = shop.prior, joints(120)
    points = arm.positions(bent(q))
    noise = [SIGMA * np.random.default_rng(k).standard_normal((120, 1, 3)) for k in range(12)]
    draws = [calib.fit(arm, measurements(arm, q, points + off)) for off in noise]
    known = [[each for each in fit.parameters.values() if each.std_si > 0] for fit in draws]
    values, told = (np.array([[getattr(each, of) for each in row] for row in known]) for of in ("value_si", "std_si"))
    assert np.median(np.std(values, axis=0, ddof=1) / np.mean(told, axis=0)) < 0.8
    fit = draws[0]
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(told[0])
    fit.save(tmp_path / "out")
    saved = calib.load_result(tmp_path / "out")
    assert saved.content["widened"] == pytest.approx(fit.interval_factor)
    assert saved.covariance.values == pytest.approx(fit.covariance.values, rel=1e-6)
    assert saved.predict(q[:5]).std == pytest.approx(fit.predict(q[:5]).std, rel=1e-6)

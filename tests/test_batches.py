"""Rows in batches: every row once, whole visits, and the results of a fit that looks at all rows at once."""

from dataclasses import replace

import numpy as np
import pytest
from small_robots import ARM_YAML, write_arm

import calib
from calib.core.rows import batches
from calib.core.rows.batches import batches_of, observed_in
from calib.core.rows.observed import observe
from calib.core.rows.whitening import Whitening

TWO = ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider, xyz: [0, 0.1, 0]}\n") + (
    "instruments:\n  one: {kind: position, target: tip, sigma: 0.1 mm}\n  two: {kind: position, target: elbow}\n"
)


@pytest.fixture
def robot(tmp_path):
    return calib.load(write_arm(tmp_path, TWO))


@pytest.fixture
def data(robot):
    """Of two instruments: gaps, a pose that is read again, and readings that are not in the order of the visits."""
    rng = np.random.default_rng(1)
    q = rng.uniform([-2, 0, -2], [2, 1, 2], (60, 3))
    q[40:44] = q[3]
    points = robot.positions(q) + 1e-4 * rng.standard_normal((60, 2, 3))
    points[7, 0], points[20:30, 1] = np.nan, np.nan
    names = {"one": robot.target_names.index("tip"), "two": robot.target_names.index("elbow")}
    read = calib.as_measurements(robot, q, {name: points[:, t] for name, t in names.items()})
    order = rng.permutation(len(read.readings["one"]))
    turned = batches.some_readings(read.readings["one"], order)
    return replace(read, readings={**read.readings, "one": turned})


@pytest.fixture
def few_at_once(monkeypatch):
    monkeypatch.setattr(batches, "ROWS_AT_ONCE", 64)


def test_every_row_is_in_one_batch_with_all_rows_of_its_visit(robot, data, few_at_once):
    layout = Whitening(robot, data).layout
    cut = batches_of(layout)
    rows = [np.arange(layout.n_rows)[batch.rows] for batch in cut]
    assert len(cut) > 3
    assert sorted(np.concatenate(rows)) == list(range(layout.n_rows))
    visits = [set(layout.visit[layout.reading[own]]) for own in rows]
    assert sum(map(len, visits)) == len(set.union(*visits))
    for batch, own in zip(cut, visits, strict=True):
        assert own <= set(range(batch.visits.start, batch.visits.stop))


def test_few_rows_are_one_batch(robot, data):
    assert [batch.rows for batch in batches_of(Whitening(robot, data).layout)] == [slice(None)]


def test_what_is_observed_in_batches_is_what_is_observed_at_once(robot, data, few_at_once):
    configurations = robot.assemble(data.joints)
    whole = observe(robot, configurations, data.readings)
    cut = batches_of(Whitening(robot, data).layout)
    for batch, part in observed_in(robot, configurations, data.readings, cut):
        for name, places in batch.readings.items():
            np.testing.assert_allclose(part[name].residuals, whole[name].residuals[places], atol=1e-15)
            np.testing.assert_allclose(part[name].jacobian, whole[name].jacobian[places], atol=1e-14)
    index = np.array([2, 5])
    for batch, part in observed_in(robot, configurations, data.readings, cut, index=index):
        for name, places in batch.readings.items():
            np.testing.assert_allclose(part[name].by(index), whole[name].jacobian[places][..., index], atol=1e-14)


@pytest.mark.parametrize("loss", ["none", "huber"])
def test_a_fit_in_batches_is_the_fit_of_all_rows(robot, data, loss, monkeypatch):
    """To rounding: its parameters are sums in another order, over 300 rows with a condition of some hundreds."""
    whole = calib.fit(robot, data, loss=loss)
    monkeypatch.setattr(batches, "ROWS_AT_ONCE", 64)
    cut = calib.fit(robot, data, loss=loss)
    assert cut.whitening.batches != whole.whitening.batches
    np.testing.assert_allclose(cut.robot.values, whole.robot.values, atol=1e-11)
    np.testing.assert_allclose(cut.statistics.std, whole.statistics.std, rtol=1e-6)
    # second derivatives in it are differences of products, which lose four digits more
    np.testing.assert_allclose(cut.statistics.half_width, whole.statistics.half_width, rtol=1e-3)
    np.testing.assert_allclose(cut.rows.jacobian, whole.rows.jacobian, atol=1e-6 * np.max(np.abs(whole.rows.jacobian)))
    assert cut.observability == pytest.approx(whole.observability, rel=1e-6)
    assert cut.joint_error == pytest.approx(whole.joint_error, rel=1e-5, abs=1e-9)
    assert (cut.rank_all.rank, cut.rank.rank) == (whole.rank_all.rank, whole.rank.rank)
    assert [reason.code for reason in cut.verdict.reasons] == [reason.code for reason in whole.verdict.reasons]
    budgets = [[share.mean_square for share in fit.budget.shares] for fit in (cut, whole)]
    np.testing.assert_allclose(*budgets, rtol=1e-5, atol=1e-15)
    for one, other in zip(cut.patterns, whole.patterns, strict=True):
        assert (one.kind, one.name, one.detail) == (other.kind, other.name, other.detail)
        assert one.p_value == pytest.approx(other.p_value, rel=1e-4)

"""Calibrations with instruments that state their noise, look at hidden targets, and are moved."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.instruments.kind import Readings
from calib.core.robots.jacobian import linearise
from calib.core.rows.observed import predict_readings
from tests.small_robots import ARM_YAML, write_arm

FREE = """\
parametrisation:
  - {origin: turn, components: [x, y, z], sigma: 2 mm}
  - {origin: slide, components: [x, y], sigma: 2 mm}
  - {origin: slide, components: [ry, rz], sigma: 5 mrad}
  - {origin: wrist, components: [rx, rz], sigma: 5 mrad}
priors: false
"""
YAML = ARM_YAML[: ARM_YAML.index("parametrisation:")] + FREE
FAR = YAML.replace("frame: ground", "frame: ground, xyz: [3, 1, 0]")  # the base is 3.2 m from the tracker
OFF = {"turn.x": 1e-3, "turn.z": 0.499, "slide.y": 5e-4, "slide.rz": 3e-3, "wrist.rx": -2e-3}


def joints(n, seed=0):
    return np.random.default_rng(seed).uniform([-2, 0, -2], [2, 1, 2], (n, 3))


def with_noise_of(yaml, sigma):
    return yaml + f"instruments:\n  tip: {{kind: position, target: tip{sigma}}}\n"


def beam(points, along, angle):
    """Covariance of a tracker at the origin, (n, 3, 3) [m^2]."""
    distance = np.linalg.norm(points, axis=1)[:, None, None]
    unit = points[:, :, None] / distance
    outer = unit @ unit.transpose(0, 2, 1)
    return along**2 * outer + (angle * distance) ** 2 * (np.eye(3) - outer)


CASES = {
    "per axis": (YAML, ", sigma: [0.02 mm, 0.02 mm, 0.4 mm]", lambda p: [np.diag([2e-5, 2e-5, 4e-4]) ** 2] * len(p)),
    "tracker": (FAR, ", sigma: {range: 0.01 mm, angle: 0.1 mrad}", lambda p: beam(p, 1e-5, 1e-4)),
    "per row": (YAML, "", lambda p: np.where(np.arange(len(p)) % 2, 1e-5, 4e-4)[:, None, None] ** 2 * np.eye(3)),
}


@pytest.mark.quick(0)
@pytest.mark.parametrize("case", CASES)
def test_fits_that_know_their_noise_scatter_as_little_as_can_be(tmp_path, case):
    """Gauss and Markov: by (J^T C^-1 J)^-1; by equal weights, a parameter would scatter at least twice as much."""
    yaml, stated, covariance_of = CASES[case]
    robot = calib.load(write_arm(tmp_path, with_noise_of(yaml, stated)))
    truth, q = robot.with_parameters(OFF), joints(40)
    exact = truth.positions(q)[:, 0]
    covariance = np.array(covariance_of(exact))
    j = linearise(truth, truth.assemble(q)).jacobian[:, 0]
    best = np.linalg.inv(np.einsum("nai,nab,nbj->ij", j, np.linalg.inv(covariance), j))
    flat = np.linalg.inv(np.einsum("nai,naj->ij", j, j))
    alike = flat @ np.einsum("nai,nab,nbj->ij", j, covariance, j) @ flat
    assert np.max(np.diag(alike) / np.diag(best)) > 2**2

    root, rng, errors, chi = np.linalg.cholesky(covariance), np.random.default_rng(4), [], []
    for _ in range(40):
        data = calib.as_measurements(robot, q, exact + (root @ rng.standard_normal((40, 3, 1)))[:, :, 0])
        if case == "per row":
            data = replace(data, readings={"tip": replace(data.readings["tip"], covariance=covariance)})
        fit = calib.fit(robot, data)
        errors.append(fit.robot.values - truth.values)
        chi.append(fit.chi_square.value / fit.chi_square.freedom)
    # 40 draws: each root mean square to 11 %
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), np.sqrt(np.diag(best)), rtol=0.35)
    assert np.mean(chi) == pytest.approx(1.0, abs=0.07)  # 111 degrees of freedom, 40 times: 2.1 %
    np.testing.assert_allclose(fit.statistics.std, np.sqrt(np.diag(best)), rtol=0.25)  # times a found factor


TWO = YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider, xyz: [0, 0.1, 0.05]}\n")
BOTH = TWO + "instruments:\n  tracker: {kind: position, target: tip}\n  arm: {kind: position, target: elbow}\n"


def two_instruments(robot, q, tip, elbow):
    """What two instruments read with this noise [m]."""
    exact = robot.with_parameters(OFF).positions(q)
    by_target = dict(zip(robot.target_names, exact.transpose(1, 0, 2), strict=True))
    noise = np.random.default_rng(1).standard_normal((2, len(q), 3))
    return {"tracker": by_target["tip"] + tip * noise[0], "arm": by_target["elbow"] + elbow * noise[1]}


def test_every_instrument_has_its_own_noise_found(tmp_path):
    robot, q = calib.load(write_arm(tmp_path, BOTH)), joints(80)
    read = two_instruments(robot, q, 2e-5, 4e-4)
    fit = calib.fit(robot, calib.as_measurements(robot, q, read))
    by_name = {noise.group.name: noise for noise in fit.noise}
    # 240 rows each: 4.6 %
    assert by_name["tracker"].sigma == pytest.approx(2e-5, rel=0.15)
    assert by_name["arm"].sigma == pytest.approx(4e-4, rel=0.15)
    assert by_name["tracker"].stated is None
    assert sum(noise.freedom for noise in fit.noise) == pytest.approx(480 - 9)
    assert fit.chi_square is None
    # the arm tells hardly anything beside a tracker twenty times as good: alone, that gives the same
    alone = calib.fit(robot, calib.as_measurements(robot, q, {"tracker": read["tracker"]}))
    assert np.all(np.abs(fit.robot.values - alone.robot.values) < 0.5 * alone.statistics.std)
    assert fit.verdict.grade == "PASS"


def test_a_wrongly_stated_instrument_does_not_spoil_the_factor_of_the_other(tmp_path):
    yaml = TWO + (
        "instruments:\n  tracker: {kind: position, target: tip, sigma: 0.02 mm}\n"
        "  arm: {kind: position, target: elbow, sigma: 0.1 mm}\n"
    )
    robot, q = calib.load(write_arm(tmp_path, yaml)), joints(80)
    fit = calib.fit(robot, calib.as_measurements(robot, q, two_instruments(robot, q, 2e-5, 2e-4)))
    by_name = {noise.group.name: noise.sigma / noise.stated for noise in fit.noise}
    assert by_name["tracker"] == pytest.approx(1.0, rel=0.15)
    assert by_name["arm"] == pytest.approx(2.0, rel=0.15)


def test_a_hidden_target_costs_its_rows_and_nothing_else(tmp_path):
    """Rows with gaps are the same as rows written out one by one, whatever order they stand in."""
    robot, q = calib.load(write_arm(tmp_path, TWO + "sigma: 0.05 mm\n")), joints(40)
    rng = np.random.default_rng(2)
    measured = robot.with_parameters(OFF).positions(q) + 5e-5 * rng.standard_normal((40, 2, 3))
    hidden = rng.random((40, 2)) < 0.3
    measured[hidden] = np.nan
    gaps = calib.as_measurements(robot, q, measured)
    assert gaps.n_readings == np.sum(~hidden)
    order = np.array([(visit, t) for t in (1, 0) for visit in rng.permutation(40) if not hidden[visit, t]])
    alone = np.where(np.arange(2)[:, None] == order[:, 1, None, None], measured[order[:, 0]], np.nan)
    written_out = calib.as_measurements(robot, q[order[:, 0]], alone)
    fitted, other = calib.fit(robot, gaps), calib.fit(robot, written_out)
    np.testing.assert_allclose(fitted.robot.values, other.robot.values, atol=1e-9)
    np.testing.assert_allclose(fitted.statistics.std, other.statistics.std, rtol=1e-5)
    assert fitted.statistics.freedom == pytest.approx(3 * gaps.n_readings - 9)
    assert np.all(np.abs(fitted.robot.values - robot.with_parameters(OFF).values) < 4 * fitted.statistics.std)
    assert np.all(np.isfinite(fitted.identification.errors("after", single=True)))
    seen = np.isfinite(fitted.identification.data.points(robot)[..., 0])
    np.testing.assert_array_equal(seen, ~hidden[~hidden.all(axis=1)])  # poses without a reading are no part of a fit


MOVED = YAML.replace("frame: ground", "frame: ground, pose: unknown").replace(
    "  - {origin: turn, components: [x, y, z], sigma: 2 mm}\n", ""
).replace("[ry, rz]", "[ry]") + "setups: {morning: [], evening: [base]}\n"  # fmt: skip


def test_a_tracker_that_was_moved_is_found_at_both_places(tmp_path):
    robot, q = calib.load(write_arm(tmp_path, MOVED)), joints(60)
    places = {
        "base.x": 2.0, "base.y": -1.0, "base.rz": 0.8, "base.rx": 0.1,
        "base@evening.x": -1.5, "base@evening.z": 0.4, "base@evening.rz": -2.0, "base@evening.ry": 0.3,
    }  # fmt: skip
    truth = robot.with_parameters({name: OFF[name] for name in ("slide.y", "wrist.rx")} | places)
    plan = Readings(np.arange(60), np.repeat([0, 1], 30), np.zeros((60, 3)), None, np.zeros((60, 0)))
    predicted = predict_readings(truth, truth.assemble(q), {"tip": plan})["tip"]
    read = predicted.values + 2e-5 * np.random.default_rng(3).standard_normal((60, 3))
    data = replace(calib.as_measurements(robot, q, read), readings={"tip": replace(predicted, values=read)})
    fit = calib.fit(robot, data)
    expected = truth.values
    assert np.all(np.abs(fit.robot.values - expected)[fit.free] < 4.5 * fit.statistics.std)
    assert np.max(np.abs(fit.robot.values - expected)) < 1e-3
    assert fit.sigma == pytest.approx(2e-5, rel=0.25)
    before = fit.identification.table()["before"]["rms"]
    assert 0.05 < before < 5  # each setup is placed: what is left is the robot's own error [mm]
    assert fit.verdict.grade == "PASS"


def test_two_readings_of_one_visit_weigh_like_a_reading_of_half_the_variance(tmp_path):
    robot, q = calib.load(write_arm(tmp_path, with_noise_of(YAML, ", sigma: 0.05 mm"))), joints(40)
    rng = np.random.default_rng(2)
    mean = robot.with_parameters(OFF).positions(q)[:, 0] + 4e-5 * rng.standard_normal((40, 3))
    apart = 4e-5 * rng.standard_normal((40, 3))
    visits = np.repeat(np.arange(40), 2)
    values = np.stack([mean + apart, mean - apart], axis=1).reshape(80, 3)
    once = calib.as_measurements(robot, q, mean)
    twice = replace(once, readings={"tip": Readings(visits, 0 * visits, values, None, np.zeros((80, 0)))})
    np.testing.assert_allclose(twice.points(robot), once.points(robot), atol=1e-15)
    fitted, two = calib.fit(robot, once), calib.fit(robot, twice)
    np.testing.assert_allclose(fitted.robot.values, two.robot.values, atol=1e-9)
    assert len(two.identification.errors("after")) == 40
    assert len(two.identification.errors("after", single=True)) == 80


def test_an_error_of_the_joints_that_a_visit_shares_is_found_and_widens_intervals(tmp_path):
    """Two targets move together where the joints do not come back: 4 rows of 6 are no news."""
    robot, q = calib.load(write_arm(tmp_path, TWO)), joints(150)
    truth = robot.with_parameters(OFF)
    errors, claimed, narrow = [], [], []
    for seed in range(12):
        data = calib.simulate(truth, q, 1e-5, np.random.default_rng(seed), joint_sigma=2e-4)
        fit = calib.fit(robot, data)
        errors.append(fit.robot.values - truth.values)
        claimed.append(fit.statistics.std)
        assert fit.statistics.shared_scatter.ratio > 1.1
        white = fit.rows.jacobian  # by the noise as found, as if all rows were independent
        factor = fit.statistics.factors.values[0]
        narrow.append(factor * np.sqrt(np.diag(np.linalg.inv(white.T @ white))) * fit.unknowns.scales)
    z = np.array(errors) / np.array(claimed)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.25)  # 12 draws of 9 parameters
    assert np.mean(np.array(claimed) / np.array(narrow)) > 1.1


def test_a_column_of_empty_cells_counts_as_no_instrument(tmp_path):
    """One wire is read nowhere, or at three visits, which folds may leave out: the fit and its verdict stand."""
    far = "end: {frame: ground, xyz: [3, 1, 0]}, sigma: 0.05 mm"
    yaml = with_noise_of(YAML, ", sigma: 0.02 mm") + f"  wire: {{kind: distance, target: tip, {far}}}\n"
    robot = calib.load(write_arm(tmp_path, yaml))
    truth = robot.with_parameters(OFF)
    whole = calib.simulate(truth, joints(30), seed=1)
    alone = replace(whole, readings={"tip": whole.readings["tip"]})
    for visits in ([], [4, 5, 20]):
        wire = whole.readings["wire"].subset(np.array(visits, dtype=int))
        data = replace(whole, readings=alone.readings | {"wire": wire})
        fit = calib.fit(robot, data, folds=5)
        assert "Verdict" in str(fit)
        assert {*fit.identification.after} == {*data.readings}
        assert np.array_equal(fit.robot.values, calib.fit(robot, alone).robot.values) == (not visits)

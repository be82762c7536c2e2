"""Joint terms that a choice left undecided: against dense marginal likelihoods, the normal equations, and coverage."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from test_term_choice import five_bar, position_errors, simulated

import calib
from calib.core.numerics.undecided import averaged


def test_chances_and_mean_squares_are_those_of_dense_likelihoods():
    """Of two kinds, by the density of the readings themselves and a fine integral over sizes."""
    rng = np.random.default_rng(3)
    kinds = [0.8 * rng.standard_normal((12, n)) for n in (2, 3)]
    residuals = kinds[0] @ (0.6, -0.4) + rng.standard_normal(12)
    sizes = np.linspace(0.01, 6.0, 600)
    prior = np.exp(-0.5 * sizes**2)
    without = 5 / 6 * scipy.stats.multivariate_normal(cov=np.eye(12)).pdf(residuals)
    for rows in kinds:
        at_size, mean_square = [], []
        for size in sizes:
            of_data = np.eye(12) + size**2 * rows @ rows.T
            at_size.append(scipy.stats.multivariate_normal(cov=of_data).pdf(residuals))
            covariance = np.linalg.inv(rows.T @ rows + np.eye(rows.shape[1]) / size**2)
            mean = covariance @ rows.T @ residuals
            mean_square.append(covariance + np.outer(mean, mean))
        weights = 1 / 6 * prior * at_size / prior.sum()
        total, square = without + weights.sum(), np.tensordot(weights, mean_square, 1)
        found = averaged(rows.T @ rows, rows.T @ residuals)
        assert found.chance == pytest.approx(weights.sum() / total, rel=0.02)
        assert found.spread @ found.spread.T == pytest.approx(square / total, rel=0.05, abs=0.003)


@pytest.fixture(scope="module")
def drifting(tmp_path_factory):
    """Five-bars that drift, and whose data do not prove it: fits, true robots and other commands."""
    robot, cases = five_bar(tmp_path_factory.mktemp("five_bar")), []
    for number in range(20):
        true, data, elsewhere = simulated(robot, ("drift",), np.random.default_rng([1, number]))
        fit = calib.fit(robot, data, terms="auto")
        if not any(term.added for term in fit.terms.tried):
            cases.append((fit, true, elsewhere))
    assert len(cases) >= 4
    return cases


def test_intervals_include_terms_that_are_too_small_to_be_proven(drifting):
    held, narrow = [], []
    for fit, true, elsewhere in drifting:
        errors, inside = position_errors(fit, true, elsewhere)
        alone = replace(fit.uncertainty, undecided=None, joint_error=0.0).at(fit.robot, elsewhere)
        moves = alone.std > 1e-9
        held += inside
        narrow += list((errors <= alone.coverage_factor * alone.std)[moves])
    assert np.mean(narrow) < 0.75
    assert np.mean(held) > np.mean(narrow) + 0.1


def test_free_parameters_follow_undecided_terms_as_the_fit_would(drifting):
    """Along every direction the free parameters are at the minimum: what is left pulls none of them."""
    fit, _, _ = drifting[0]
    undecided, data = fit.undecided, fit.identification.data
    whole = undecided.added_to(fit.robot)
    place = {p.name: k for k, p in enumerate(whole.parameters)}
    directions = np.zeros((len(whole.parameters), undecided.spread.shape[1]))
    directions[[place[name] for name in undecided.names]] = undecided.spread
    step = 1e-3
    moved = []
    for direction in directions.T:
        ends = [whole.with_parameters(whole.values + sign * step * direction) for sign in (1, -1)]
        high, low = (robot.positions(data.joints, data.conditions).ravel() for robot in ends)
        moved.append((high - low) / (2 * step))
    free = fit.unknowns.index
    jacobian = np.concatenate([block.by(free) for block in observed_by(fit).values()]).reshape(-1, len(free))
    pull = (jacobian * fit.unknowns.scales).T @ np.transpose(moved) / fit.sigma**2
    prior = fit.unknowns.prior.has[:, None] * undecided.of_parameters(fit.free_names) / fit.unknowns.scales[:, None]
    size = np.linalg.norm((jacobian * fit.unknowns.scales / fit.sigma), axis=0)[:, None]
    assert np.max(np.abs(pull + prior) / size) < 0.02 * np.max(np.linalg.norm(moved, axis=1)) / fit.sigma


def observed_by(fit):
    return calib.core.rows.observed.observe(fit.robot, fit.configurations, fit.identification.data.readings)


def test_a_saved_result_predicts_and_corrects_as_the_fit_does(drifting, tmp_path):
    fit, _, elsewhere = drifting[0]
    fit.save(tmp_path / "result")
    loaded = calib.load_result(tmp_path / "result")
    assert loaded.predict(elsewhere).std == pytest.approx(fit.predict(elsewhere).std, rel=1e-9)
    corrected, again = (calib.compensate(known, elsewhere[:5]) for known in (fit, loaded))
    assert again.expected == pytest.approx(corrected.expected, rel=1e-6)
    wide = {name: estimate.std_si for name, estimate in loaded.parameters.items()}
    assert any(wide[name] > 1.05 * np.sqrt(loaded.covariance[name, name]) for name in loaded.free_names)


def test_terms_that_were_named_leave_nothing_undecided(drifting):
    fit, _, _ = drifting[0]
    named = calib.fit(fit.nominal, fit.identification.data, terms="drift")
    assert named.undecided is None
    assert named.uncertainty.undecided is None

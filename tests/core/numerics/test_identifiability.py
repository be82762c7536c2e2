"""Rank and information against numpy's own least squares, and MedRUE's eight directions against the paper."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib import fit
from calib.core.base.parameter import Parameter
from calib.core.numerics.identifiability import RANK_TOLERANCE, numerical_rank, reduce_rows
from calib.core.numerics.observability import information
from calib.core.numerics.prior import Prior
from calib.core.robots.jacobian import linearise
from calib.core.rows.determination import Determination, determination
from calib.shared.candidates import assumed_sigma
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.small_robots import small_arm


def random_matrix(rows, columns, rank, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, columns))


def test_rank_of_a_product_is_that_of_its_thinner_factor():
    rank = numerical_rank(random_matrix(40, 12, 7))
    assert (rank.rank, rank.n_columns) == (7, 12)
    assert rank.smallest_kept > 1e6 * rank.threshold > 1e3 * rank.largest_dropped
    assert rank.threshold == RANK_TOLERANCE * rank.singular_values[0]
    assert "rank 7 of 12 (gap: singular value 7 is " in str(rank)
    assert "smallest singular value" in str(numerical_rank(np.eye(3)))


def test_rank_of_a_matrix_with_fewer_rows_than_columns():
    rank = numerical_rank(random_matrix(4, 9, 4))
    assert rank.rank == 4
    assert len(rank.singular_values) == 9
    np.testing.assert_array_equal(rank.singular_values[4:], 0)


@pytest.mark.parametrize(
    ("values", "n", "unclear"),
    [
        ([1.0, 1e-3, 2e-9, 0.9e-9], 3, True),  # a factor of 2 about the threshold
        ([1.0, 1e-3, 2e-9, 1e-11], 3, False),  # a factor of 200
        ([1.0, 1e-3, 1e-4, 3e-9], 4, True),  # full, by a factor of 3
        ([1.0, 1e-3, 1e-4, 1e-7], 4, False),
        ([1.0, 1e-3, 1e-4, 1e-15], 3, False),
    ],
)
def test_a_rank_without_a_gap_says_so(values, n, unclear):
    rng = np.random.default_rng(3)
    left, right = (np.linalg.qr(rng.standard_normal((size, 4)))[0] for size in (20, 4))
    rank = numerical_rank(left * values @ right.T)
    assert (rank.rank, rank.unclear) == (n, unclear)
    assert ("no clear gap" in rank.doubt) == unclear


def test_columns_that_nearly_depend_are_told_wherever_the_rank_is(tmp_path):
    """A copy of a column that is off by 6e-9 of its length: the smallest singular value is that over sqrt(2)."""
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((60, 5))
    columns[:, 4] = columns[:, 3] + 6e-9 * rng.standard_normal(60)
    parameters = [Parameter(f"p{k}", "length", 0.0, 1e-3, "mm", prior=False) for k in range(5)]
    result = determination(columns, parameters, np.ones(5, dtype=bool))
    assert result.together.unclear
    assert result.together.smallest_kept == pytest.approx(6e-9 / np.sqrt(2), rel=0.3)
    assert sum("No clear gap" in line for line in result.lines()) == 1


def test_reduced_keeps_singular_values():
    matrix = random_matrix(50, 6, 5)
    assert reduce_rows(matrix).shape == (6, 6)
    # QR is backward stable: a few units in the last place of the largest singular value
    np.testing.assert_allclose(
        np.linalg.svd(reduce_rows(matrix), compute_uv=False), np.linalg.svd(matrix, compute_uv=False), atol=1e-13
    )


def test_standard_deviations_and_correlations_are_those_of_least_squares():
    rows = random_matrix(30, 5, 5)
    covariance = np.linalg.inv(rows.T @ rows)
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(information(rows / 0.3).standard_deviations(), 0.3 * std, rtol=1e-10)
    np.testing.assert_allclose(information(rows).correlations(), covariance / np.outer(std, std), rtol=1e-9, atol=1e-10)


def test_position_errors_are_the_spread_of_many_simulated_fits():
    rng = np.random.default_rng(4)
    rows, elsewhere = random_matrix(12, 4, 4), rng.standard_normal((3, 6, 4))
    estimates = np.linalg.lstsq(rows, 0.2 * rng.standard_normal((12, 20_000)), rcond=None)[0]
    errors = np.einsum("nki,id->nkd", elsewhere, estimates).reshape(3, 2, 3, -1)
    expected = np.sqrt(np.mean(np.sum(errors**2, axis=2), axis=2))
    result = information(rows / 0.2).position_errors(elsewhere)
    np.testing.assert_allclose(result, expected, rtol=0.03)  # 20 000 draws give the spread to 0.5 %; six sigma


def test_a_direction_that_nothing_determines_is_infinite_and_never_a_number():
    rows = np.zeros((9, 3))
    rows[:, 0] = 1.0
    rows[:, 1] = rows[:, 2] = np.arange(9)
    known = information(rows)
    np.testing.assert_array_equal(known.undetermined, [False, True, True])
    assert np.isinf(known.standard_deviations()[1:]).all()
    assert np.isnan(known.correlations()[1]).all()
    along, across = np.zeros((1, 3, 3)), np.zeros((1, 3, 3))
    along[0, 0] = [1.0, 1.0, 1.0]  # sees only the sum of the two: determined
    across[0, 0] = [1.0, 1.0, 0.0]
    assert np.isfinite(known.position_errors(along)).all()
    assert np.isinf(known.position_errors(across)).all()


def test_a_prior_gives_what_the_rows_do_not():
    has_prior = np.array([True, False, True])
    nothing_measured = information(np.zeros((1, 3, 3)), Prior(has_prior).rows)
    # scaled parameters have a prior of one sigma
    np.testing.assert_allclose(nothing_measured.standard_deviations(), [1.0, np.inf, 1.0], rtol=1e-12)
    rows = random_matrix(6, 3, 3)
    expected = np.linalg.inv(rows.T @ rows + np.diag(has_prior.astype(float)))
    root = information(rows, Prior(has_prior).rows).root
    np.testing.assert_allclose(root @ root.T, expected, rtol=1e-10)


def test_noise_is_stated_or_described_or_assumed(tmp_path, medrue):
    assert assumed_sigma(medrue, None) == (4e-5, False)
    assert assumed_sigma(medrue, 1e-5) == (1e-5, False)
    assert assumed_sigma(small_arm(tmp_path), None) == (1e-4, True)
    with pytest.raises(calib.DataError, match="must be a positive number"):
        assumed_sigma(medrue, 0.0)


def test_the_rank_is_the_same_for_every_half_of_the_poses_and_also_away_from_nominal(medrue):
    q = target_workspace().q
    for robot, some in ((medrue, q[::2]), (medrue, q[1::2]), (medrue.with_parameters(table1().actual), q[::3])):
        jacobian = linearise(robot, robot.assemble(some)).jacobian * [p.sigma_si for p in robot.parameters]
        assert numerical_rank(jacobian.reshape(-1, 36)).rank == 28


def test_other_valid_choices_of_eight_predict_the_same_positions(medrue):
    """Three ways to hold eight parameters, fitted to the same noisy data, agree at poses that were not used."""
    q, generator = target_workspace().q, np.random.default_rng(7)
    used, others = q[::6], q[3::6]
    noisy = forward(used, table1().actual).p_world_tool + 4e-5 * generator.standard_normal((len(used), 3))
    data = calib.as_measurements(medrue, used, noisy)
    predicted = []
    for held in (
        ("A2y", "A2z", "d31", "d32", "d41", "d5", "xb", "zb"),
        ("dq1", "xt", "d42", "A1y", "C1z", "phi_bx", "d31", "d32"),
        ("xb", "d5", "d41", "yb", "zb", "C2y", "d31", "d32"),
    ):
        description = medrue.description.model_copy(update={"held": held})
        predicted.append(fit(replace(medrue, description=description), data).robot.positions(others))
    # The fits stop within a small part of a standard deviation, which is about 10 um at the tool.
    np.testing.assert_allclose(predicted[1], predicted[0], atol=2e-7)
    np.testing.assert_allclose(predicted[2], predicted[0], atol=2e-7)


def test_a_fit_on_an_unclear_rank_gets_a_check_and_says_so(tmp_path, monkeypatch):
    robot = small_arm(tmp_path)
    q = np.random.default_rng(5).uniform([-2, 0.1, -1], [2, 0.9, 1], (40, 3))
    made = fit(robot, calib.as_measurements(robot, q, robot.positions(q) + 2e-5 * np.sin(7 * q)[:, None]))
    assert "rank_unclear" not in [reason.code for reason in made.verdict.reasons]
    n = len(made.unknowns)
    every, nothing = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    unclear = Determination(np.diag([*np.ones(n - 1), 4e-9]), np.ones(n), every, nothing)
    doubtful = replace(made, determination=unclear)
    assert doubtful.verdict.grade == "CHECK"
    assert "no clear gap" in next(r.text for r in doubtful.verdict.reasons if r.code == "rank_unclear")
    assert "No clear gap" in doubtful.report(verbose=True)
    short = Determination(np.diag([*np.ones(n - 2), 2e-9, 0.7e-9]), np.ones(n), every, nothing)
    monkeypatch.setattr("calib.core.fitting.pose_checks.determination", lambda *columns: short)
    with pytest.raises(calib.NotIdentifiableError, match=r"1 is NOT determined.*no clear gap"):
        fit(robot, made.identification.data)

"""Scores of choices against plain linear algebra: every fast path equals the slow one."""

import numpy as np
import pytest

from calib.core.numerics.observability import observability
from calib.planning.selection_problem import CHOICES, TASK, build_problem, index_of_score, index_values
from calib.planning.selection_scores import scores

N, K, D = 14, 3, 6


def made_up(seed=0, n=N, k=K, d=D):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((n, k, d)) * np.array([1.0, 0.3, 2.0, 0.1, 1.0, 0.5])[:d]
    return rows, rng.standard_normal((5, k, d))


def plain_value(rows, task, chosen, index, sigma=1.0, known=None):
    """The index of a choice, from its rows."""
    flat = rows[chosen].reshape(-1, rows.shape[2])
    if known is not None:
        flat = np.vstack([flat, known])
    if index == TASK:
        covariance = sigma**2 * np.linalg.inv(flat.T @ flat)
        errors = np.array([np.trace(block @ covariance @ block.T) for block in task.reshape(-1, 3, task.shape[2])])
        return np.sqrt(np.mean(errors))
    return observability(np.linalg.svd(flat, compute_uv=False), len(rows[chosen]))[index]


@pytest.mark.parametrize("index", CHOICES)
def test_values_are_those_of_the_rows(index):
    rows, task = made_up()
    problem = build_problem(rows / 0.3, task_rows=task)  # whitened by a noise of 0.3
    chosen = np.isin(np.arange(N), [1, 4, 5, 9])
    expected = plain_value(rows, task, chosen, index, 0.3)
    assert index_values(problem, chosen, 0.3)[index] == pytest.approx(expected, rel=1e-9)
    score = scores(problem, index, chosen).value
    assert index_of_score(problem, index, score, 4, 0.3) == pytest.approx(expected, rel=1e-9)
    # with priors and a measured pose, of the stacked rows
    priors = 0.1 * np.eye(D)[:4]
    problem = build_problem(rows[:13], rows[13], priors, 1, task)
    expected = plain_value(rows[:13], task, chosen[:13], index, known=np.vstack([priors, rows[13]]))
    if index == "O1":
        expected *= np.sqrt(4 / 5)  # the measured pose counts among the poses
    assert index_values(problem, chosen[:13], 1.0)[index] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("index", CHOICES)
@pytest.mark.parametrize("k", [3, 6], ids=["one target", "two targets"])
@pytest.mark.parametrize("add", [True, False], ids=["add", "remove"])
def test_the_best_move_is_the_best_of_all_tried_one_by_one(index, k, add):
    for seed in range(5):
        rows, task = made_up(seed, k=k)
        problem = build_problem(rows, task_rows=task)
        chosen = np.isin(np.arange(N), np.random.default_rng(seed).choice(N, 5, replace=False))
        allowed = ~chosen if add else chosen
        allowed[np.flatnonzero(allowed)[0]] = False
        result = scores(problem, index, chosen).best_move(allowed, add=add)
        values = {}
        for j in np.flatnonzero(allowed):
            tried = chosen.copy()
            tried[j] = add
            value = plain_value(rows, task, tried, index)
            values[j] = -value if index == TASK else value
        assert values[result] == pytest.approx(max(values.values()), rel=1e-9)
        assert allowed[result]


@pytest.mark.parametrize("index", CHOICES)
def test_a_hundred_updates_do_not_drift(index):
    rows, task = made_up(n=40)
    problem = build_problem(rows, task_rows=task)
    rng, chosen = np.random.default_rng(3), np.arange(40) < 10
    state = scores(problem, index, chosen)
    for _ in range(100):
        added, removed = rng.choice(np.flatnonzero(~chosen)), rng.choice(np.flatnonzero(chosen))
        state = state.after_move(int(added), add=True).after_move(int(removed), add=False)
        chosen[added], chosen[removed] = True, False
    fresh = scores(problem, index, chosen)
    assert state.value == pytest.approx(fresh.value, rel=1e-9)
    assert state.best_move(~chosen, add=True) == fresh.best_move(~chosen, add=True)


@pytest.mark.parametrize("index", CHOICES)
def test_a_pose_can_be_spared_where_every_direction_keeps_a_hundredth(index):
    """Six directions that keep a hundredth each: their product, 1e-12, says nothing about any of them."""
    alone = 10.0 * np.eye(6)
    problem = build_problem(np.array([alone, np.eye(6), alone]), task_rows=np.eye(6).reshape(2, 3, 6))
    state = scores(problem, index, np.array([True, True, False]))
    assert state.spares(np.array([0]))[0]  # 100 of 101 go


@pytest.mark.parametrize("index", CHOICES)
@pytest.mark.parametrize("weak", [1.0, 1e-4, 1e-8])
def test_a_weak_direction_is_lost_or_kept_by_what_is_seen_of_it(index, weak):
    """Squares of 1e-8 are below the rounding of those of 1; whether a direction is lost does not depend on that."""
    rows, task = made_up()
    turn = np.linalg.qr(np.random.default_rng(5).standard_normal((D, D)))[0]
    for seen_by in (1, 2):
        some = rows.copy()
        some[seen_by:, :, 0] = 0.0
        some[:, :, 0] *= weak
        problem = build_problem(some @ turn, task_rows=task)
        state = scores(problem, index, np.ones(N, dtype=bool))
        assert state.spares(np.arange(N)).tolist() == [seen_by > 1] * seen_by + [True] * (N - seen_by)


@pytest.mark.parametrize("index", ["O2", "O3", "O4", "O5"])
def test_values_of_weak_directions_are_those_of_the_rows(index):
    rows, _ = made_up()
    rows[:, :, 0] *= 1e-8
    chosen = np.arange(N) < 7
    expected = plain_value(rows, None, chosen, index)
    assert index_values(build_problem(rows), chosen, 1.0)[index] == pytest.approx(expected, rel=1e-6, abs=0)


def test_directions_that_no_candidate_sees_take_no_part():
    rows, _ = made_up()
    blind = np.concatenate([rows, rows[:, :, :1]], axis=2)  # two equal columns
    problem = build_problem(blind, task_rows=blind)
    assert problem.pose_information.rank.rank == D
    assert len(problem.strengths) == D
    elsewhere = np.zeros((1, 3, D + 1))
    elsewhere[0, 0, 0] = 1.0  # moves by one of the two only
    assert problem.task_floor == 0
    assert np.isinf(build_problem(blind, task_rows=elsewhere).task_floor)
    held = build_problem(blind, priors=0.1 * np.eye(D + 1)[:1], task_rows=elsewhere)
    assert np.isfinite(held.task_floor)


@pytest.mark.parametrize("prior_columns", [range(8), [0, 3, 6, 7]], ids=["all", "some"])
def test_directions_that_only_priors_hold_are_eliminated_exactly(prior_columns):
    """Eight columns of rank six with priors: the task index and the order by O1 are those of the full matrices."""
    rows, _ = made_up()
    mixed = rows @ np.random.default_rng(9).standard_normal((D, 8))
    priors = 0.3 * np.eye(8)[list(prior_columns)]
    task = np.random.default_rng(8).standard_normal((4, 3, 8))
    problem = build_problem(mixed / 0.2, None, priors / 0.2, 0, task)
    assert problem.pose_information.rank.rank == D
    assert problem.rank.rank == 8
    logs = []
    for chosen in ([0, 1, 2], [5, 8, 9, 11], [3, 4, 10, 12, 13]):
        mask = np.isin(np.arange(N), chosen)
        full = np.vstack([mixed[mask].reshape(-1, 8), priors])
        covariance = 0.2**2 * np.linalg.inv(full.T @ full)
        expected = np.sqrt(np.mean([np.trace(block @ covariance @ block.T) for block in task]))
        assert index_values(problem, mask, 0.2)[TASK] == pytest.approx(expected, rel=1e-9)
        logs.append((scores(problem, "O1", mask).value, np.linalg.slogdet(full.T @ full)[1]))
    result, expected = np.array(logs).T
    np.testing.assert_allclose(np.diff(result), np.diff(expected), rtol=1e-9)


def test_all_candidates_together_are_the_identity():
    rows, task = made_up()
    problem = build_problem(rows[2:], rows[:2].reshape(-1, D), None, 2, task)
    np.testing.assert_allclose(problem.information_of(np.ones(N - 2)), np.eye(D), atol=1e-12)

"""The certificate: never below the true best of all subsets, and tight where it can be."""

from itertools import combinations

import numpy as np
import pytest

from calib.planning.exchange import Spacing, exchange, swap, uniform_start
from calib.planning.selection_bound import CERTIFIED, log_phi, relax
from calib.planning.selection_problem import TASK, build_problem, index_values

N, COUNT, D = 11, 4, 5


def made_up(seed, n=N, d=D, known=None):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((n, 3, d)) * rng.uniform(0.2, 1, d)
    return build_problem(rows, None, known, 0, rows)


def mask_of(chosen, n=N):
    return np.isin(np.arange(n), list(chosen))


def best_of_all(problem, index, among=range(N), count=COUNT):
    """The largest log phi of all subsets."""
    masks = (mask_of(subset, len(problem)).astype(float) for subset in combinations(among, count))
    return max(log_phi(problem, index, problem.information_of(mask)) for mask in masks)


@pytest.mark.quick(1)
@pytest.mark.parametrize("index", CERTIFIED)
@pytest.mark.parametrize("known", [None, 0.3 * np.eye(D)], ids=["poses alone", "with priors"])
def test_no_subset_exceeds_the_bound(index, known):
    for seed in range(8):
        problem = made_up(seed, known=known)
        bound, _ = relax(problem, index, mask_of(range(COUNT)), Spacing.free(np.ones(N, dtype=bool)))
        best = best_of_all(problem, index)
        assert best <= bound + 1e-12
        assert bound <= best + 0.3  # and it says something: a quarter of the index at most, on so few poses


@pytest.mark.parametrize("index", CERTIFIED)
def test_weights_are_feasible_and_attain_the_bound(index):
    problem = made_up(1, n=60)
    bound, weights = relax(problem, index, mask_of(range(15), 60), Spacing.free(np.ones(60, dtype=bool)))
    assert weights.min() >= 0
    assert weights.max() <= 1
    assert weights.sum() == pytest.approx(15, abs=1e-9)
    # it stops at a gap of 2e-5
    assert bound - log_phi(problem, index, problem.information_of(weights)) < 3e-5


@pytest.mark.parametrize("index", CERTIFIED)
def test_phi_goes_with_the_index(index):
    problem = made_up(4)
    masks = mask_of([0, 1, 2, 3]), mask_of([4, 5, 6, 7])
    first, second = (index_values(problem, mask, 1.0)[index] for mask in masks)
    logs = [log_phi(problem, index, problem.information_of(mask.astype(float))) for mask in masks]
    ratio, expected = first / second, np.exp(0.5 * (logs[0] - logs[1]))
    assert (1 / ratio if index == TASK else ratio) == pytest.approx(expected, rel=1e-9)


def test_candidates_that_may_not_be_chosen_do_not_lift_the_bound():
    problem = made_up(5)
    usable = np.ones(N, dtype=bool)
    strongest = np.argsort(-np.sum(problem.rows**2, axis=(1, 2)))[:3]
    usable[strongest] = False
    bound, weights = relax(problem, "O1", mask_of(np.flatnonzero(usable)[:COUNT]), Spacing.free(usable))
    assert weights[strongest].sum() == 0
    assert best_of_all(problem, "O1", np.flatnonzero(usable)) <= bound + 1e-12


def test_choosing_everything_is_certainly_best():
    problem = made_up(6)
    everything = np.ones(N, dtype=bool)
    bound, _ = relax(problem, "O1", everything, Spacing.free(everything))
    reached = log_phi(problem, "O1", problem.information_of(np.ones(N)))
    assert reached == pytest.approx(bound, abs=2e-12)


def test_many_candidates_are_certified_by_few_unclear_ones():
    problem = made_up(7, n=3000, d=8)
    space = Spacing.free(np.ones(3000, dtype=bool))
    done = swap(exchange(problem, "O1", uniform_start(np.arange(3000), 60), space), space)
    bound, _ = relax(problem, "O1", done.chosen, space)
    reached = log_phi(problem, "O1", problem.information_of(done.chosen.astype(float)))
    assert np.exp(0.5 * (reached - bound)) > 0.999


def test_the_task_is_bounded_although_the_best_weights_leave_out_what_it_does_not_need():
    rng, free = np.random.default_rng(2), np.eye(D + 1)
    rows = np.concatenate([rng.standard_normal((N, 3, D)), np.zeros((N, 3, 1))], axis=2)
    rows = np.concatenate([rows, np.tile(1e-3 * free[D:], (2, 3, 1))])  # two readings of a zero that the task lacks
    problem = build_problem(rows, task_rows=rows[:N])
    determined = mask_of([*range(COUNT), N], N + 2)
    bound, _ = relax(problem, TASK, determined, Spacing.free(np.ones(N + 2, dtype=bool)))
    alone = build_problem(rows[:N, :, :D], task_rows=rows[:N, :, :D])
    best = best_of_all(alone, TASK, count=COUNT + 1)
    assert best <= bound <= best + 0.3

"""Exchange and swaps: against brute force on small problems, and that they stop where they say."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import calib
from calib.planning.exchange import Spacing, exchange, swap, uniform_start
from calib.planning.selection_problem import CHOICES, TASK, build_problem, index_values

N, COUNT, D = 12, 4, 5
LARGEST_GAP = {"O1": 0.0, "O2": 0.05, "O3": 0.04, "O4": 0.05, "O5": 0.01, TASK: 0.005}
"""How far five starts may stay behind the best of all subsets; brute force over 20 problems found at most this."""


def made_up(seed):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((N, 3, D)) * rng.uniform(0.2, 1, D)
    return build_problem(rows, task_rows=rows), rng


def everywhere(n=N):
    return Spacing.free(np.ones(n, dtype=bool))


def merit(problem, chosen, index):
    value = index_values(problem, np.isin(np.arange(len(problem)), list(chosen)), 1.0)[index]
    return 1 / value if index == TASK else value


def improved(problem, index, start):
    """The best choice that exchanges and swaps reach from a start."""
    return swap(exchange(problem, index, start, everywhere()), everywhere()).chosen


@pytest.mark.quick(1)
@pytest.mark.parametrize("index", CHOICES)
def test_five_starts_against_all_subsets(index):
    equal = 0
    for seed in range(8):
        problem, rng = made_up(seed)
        starts = [uniform_start(np.arange(N), COUNT)] + [rng.choice(N, COUNT, replace=False) for _ in range(4)]
        result = max(merit(problem, np.flatnonzero(improved(problem, index, start)), index) for start in starts)
        best = max(merit(problem, subset, index) for subset in combinations(range(N), COUNT))
        assert best * (1 - LARGEST_GAP[index] - 1e-9) <= result <= best * (1 + 1e-9)
        equal += result >= best * (1 - 1e-9)
    assert equal >= 7


@pytest.mark.parametrize("index", CHOICES)
def test_after_swaps_no_single_swap_helps(index):
    problem, _ = made_up(1)
    chosen = improved(problem, index, uniform_start(np.arange(N), COUNT))
    inside, outside = np.flatnonzero(chosen), np.flatnonzero(~chosen)
    reached = merit(problem, inside, index)
    for out in inside:
        for into in outside:
            assert merit(problem, set(inside) - {out} | {into}, index) <= reached * (1 + 1e-8)


@pytest.mark.parametrize("index", CHOICES)
def test_the_history_rises_and_leads_from_start_to_end(index):
    problem, rng = made_up(2)
    start = rng.choice(N, COUNT, replace=False)
    done = exchange(problem, index, start, everywhere())
    assert np.all(np.diff(done.values) > 0)
    chosen = set(start.tolist())
    for added, removed in done.history:
        chosen = chosen - {removed} | {added}
    assert chosen == set(np.flatnonzero(done.chosen).tolist())
    assert len(chosen) == COUNT


@pytest.mark.parametrize("index", CHOICES)
def test_a_start_that_determines_too_little_is_mended(index):
    rows = np.random.default_rng(0).standard_normal((N, 3, D))
    rows[:COUNT, :, 0] = 0.0  # the start sees nothing of the first direction
    problem = build_problem(rows, task_rows=rows)
    done = exchange(problem, index, np.arange(COUNT), everywhere())
    assert problem.is_determined_by(done.chosen)
    values = np.array(done.values)
    assert values[0] in (0.0, -np.inf)
    assert np.isfinite(values[-1])


def test_too_few_poses_for_all_directions_is_an_error():
    rows = np.zeros((N, 3, D))
    for k in range(N):
        rows[k, :, k % D] = 1.0  # each pose sees one direction: four of them cannot see five
    with pytest.raises(calib.NotIdentifiableError, match="choose more poses"):
        exchange(build_problem(rows), "O1", np.arange(4), everywhere())


def test_a_uniform_start_is_evenly_spread():
    assert uniform_start(np.arange(420), 84).tolist() == list(range(2, 420, 5))
    assert uniform_start(np.arange(7), 7).tolist() == list(range(7))
    assert len(set(uniform_start(np.arange(100), 33).tolist())) == 33


def test_spread_gives_fewer_poses_where_there_is_no_room():
    space = replace(Spacing.free(np.ones(4, dtype=bool)), points=np.array([[0.0], [0.1], [0.2], [1.0]]), distance=0.5)
    assert space.select_spread(np.array([1, 2, 0]), 3).tolist() == [1, 3]

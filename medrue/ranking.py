"""Which choice of poses is better, and whether that is more than luck.

Every draw gives one error for each set of poses, on the same noise. Sets are put in the order of their mean error. That
order alone says little, so every pair of sets is compared: the ratio of the mean of their paired differences to its
standard error is Student's t, with one degree of freedom less than draws, if the two are equally good. n sets are
n (n - 1) / 2 questions; Holm's correction keeps the chance that luck answers any of them wrongly below `LUCK`. To
compare neighbours in the order is not enough: the first may be like the second, the second like the third, and the
first still better than the third.

Reference: holm1979.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.words import count_noun
from calib.fleets.comparing_results import holm
from medrue.result_tables import Cell, ResultTable, TableColumn

LUCK = 1e-3
"""Chance that luck alone makes any difference in a ranking look sure."""
LEGEND = "Better: if all choices were equal, one ranking in a thousand would show such a difference"


@dataclass(frozen=True, eq=False)
class Ranking:
    """Sets of poses, the least mean error first; all axes are in that order.

    Attributes:
        names: Names.
        means: Mean error of each, (n_sets,).
        n_draws: Number of draws.
        steps: Mean of column's minus row's error over its standard error, (n_sets, n_sets); NaN where not known.
        better: Whether the row's set is surely better than the column's, (n_sets, n_sets).
    """

    names: tuple[str, ...]
    means: FloatArray
    n_draws: int
    steps: FloatArray
    better: BoolArray

    def __str__(self) -> str:
        """The order, and every sure comparison."""
        return f"{', '.join(self.names)}; {self.sure_differences()}"

    def sure_differences(self) -> str:
        """Say which sets are surely better than which, every pair of them."""
        winners: dict[str, list[str]] = {}
        for row, name in enumerate(self.names):
            if np.any(self.better[row]):
                winners.setdefault(self._losers(row), []).append(name)
        if not winners:
            return "no set is better by more than chance"
        clauses = [f"{_enumerate_names(names)} than {losers}" for losers, names in winners.items()]
        return f"better by more than chance: {'; '.join(clauses)}; every other difference may be chance"

    def compare(self, row: int, column: int) -> str:
        """Return `better`, `worse` or `open` for a set (by rank) against another, nothing for itself."""
        if row == column:
            return ""
        return "better" if self.better[row, column] else "worse" if self.better[column, row] else "open"

    def _losers(self, row: int) -> str:
        """The sets that this one is surely better than; if all after some set, only that set and "all after it"."""
        losers = np.flatnonzero(self.better[row])
        first = len(self.names)
        while first - 1 in losers:
            first -= 1
        alone = [self.names[k] for k in losers if k < first]
        behind = len(self.names) - first
        if behind > 2:
            alone.append(f"{self.names[first]} and all after it")
            return ", ".join(alone)
        return _enumerate_names([*alone, *self.names[first:]])


def rank(names: tuple[str, ...], errors: FloatArray) -> Ranking:
    """Rank sets of poses by one error for each draw and set, (n_draws, n_sets)."""
    means = errors.mean(axis=0)
    order = np.argsort(means, kind="stable")
    n = len(errors)
    differences = errors[:, None, order] - errors[:, order, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = differences.mean(axis=0) / standard_error(differences)
        luck = 2 * scipy.special.stdtr(n - 1, -np.abs(steps)) if n > 1 else np.full(steps.shape, np.nan)
    upper = np.triu_indices(len(luck), 1)
    sure = np.zeros(luck.shape, dtype=bool)
    sure[upper] = holm(np.nan_to_num(luck[upper], nan=1.0)) <= LUCK
    return Ranking(tuple(names[k] for k in order), means[order], n, steps, (sure | sure.T) & (steps > 0))


def ranking_table(rankings: dict[str, Ranking]) -> ResultTable:
    """Return every pair of sets, from rankings of them over the same draws, of errors in mm, by what was ranked."""
    first = next(iter(rankings.values()))
    names = sorted(first.names)
    rows: list[list[Cell]] = []
    for what, ranking in rankings.items():
        place = {name: k for k, name in enumerate(ranking.names)}
        for k, name in enumerate(ranking.names):
            compared: list[Cell] = [ranking.compare(k, place[other]) for other in names]
            rows.append([f"{what}: {name}", float(ranking.means[k]), *compared])
    headers = ["poses chosen by", "mean over draws [mm]", *(f"against {name}" for name in names)]
    cells = zip(headers, zip(*rows, strict=True), strict=True)
    return ResultTable(
        "ranking",
        "Which choice of poses is better than which",
        tuple(TableColumn(header, column, 4) for header, column in cells),
        (
            f"simulated; better or worse: by paired differences over {count_noun(first.n_draws, 'draw')}, Student's t"
            f" with Holm's correction; by chance alone, one ranking in {1 / LUCK:.0f} has such a pair; open: may be"
            " chance",
        ),
    )


def standard_error(draws: FloatArray) -> FloatArray:
    """Standard error of the mean over the first axis, (n_draws, ...) -> (...); NaN for a single draw."""
    if len(draws) < 2:
        return np.full(draws.shape[1:], np.nan)
    return np.asarray(scipy.stats.sem(draws))


def agreement(first: dict[str, float], second: dict[str, float]) -> float:
    """Kendall's tau of two lists of errors by name: 1 for the same order, 0 for none, -1 for the reverse."""
    names = sorted(set(first) & set(second))
    return float(scipy.stats.kendalltau([first[name] for name in names], [second[name] for name in names]).statistic)


def _enumerate_names(names: list[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

"""Which choice of poses is better, and whether that is more than luck.

Every draw gives one error for each set of poses, on the same noise. Sets are ranked by their mean error; neighbours in
the ranking are told apart where the mean of their paired differences, over its standard error, exceeds what luck gives
once in a thousand (Student's t, so that few draws prove little).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import kendalltau
from scipy.stats import t as student_t

from calib.model.mechanism import FloatArray

LUCK = 1e-3
"""How often luck alone may make a difference look sure."""
LEGEND = "a < b: surely better, luck does that once in a thousand; a ~ b: may be luck"


@dataclass(frozen=True, eq=False)
class Ranking:
    """Sets of poses, the best first.

    Attributes:
        names: Names in the order of rank.
        means: Mean error of each, in that order, (n_sets,).
        n_draws: Of how many draws.
        standard_errors: Of these means, (n_sets,); NaN for a single draw.
        steps: Mean paired difference of each to the next, over its standard error, (n_sets - 1,).
    """

    names: tuple[str, ...]
    means: FloatArray
    n_draws: int
    standard_errors: FloatArray
    steps: FloatArray

    def __str__(self) -> str:
        """The order in one line: `a < b` where b is surely worse, `a ~ b` where that may be luck."""
        text = self.names[0]
        sure = float(student_t.isf(LUCK, self.n_draws - 1)) if self.n_draws > 1 else np.inf
        for name, step in zip(self.names[1:], self.steps, strict=True):
            text += f" {'<' if step > sure else '~'} {name}"
        return text


def rank(names: tuple[str, ...], errors: FloatArray) -> Ranking:
    """Rank sets of poses.

    Args:
        names: The sets.
        errors: One error for each draw and set, (n_draws, n_sets).
    """
    means = errors.mean(axis=0)
    order = np.argsort(means, kind="stable")
    n = len(errors)
    differences = np.diff(errors[:, order], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = differences.std(axis=0, ddof=1) / np.sqrt(n) if n > 1 else np.full(len(names) - 1, np.nan)
        steps = differences.mean(axis=0) / spread
    return Ranking(tuple(names[k] for k in order), means[order], n, standard_error(errors)[order], steps)


def standard_error(draws: FloatArray) -> FloatArray:
    """Standard error of the mean over the first axis, (n_draws, ...) -> (...); NaN for a single draw."""
    n = len(draws)
    if n < 2:
        return np.full(draws.shape[1:], np.nan)
    return np.asarray(draws.std(axis=0, ddof=1) / np.sqrt(n))


def agreement(first: dict[str, float], second: dict[str, float]) -> float:
    """Kendall's tau of two lists of errors by name: 1 for the same order, 0 for none, -1 for the reverse."""
    names = sorted(set(first) & set(second))
    return float(kendalltau([first[name] for name in names], [second[name] for name in names]).statistic)

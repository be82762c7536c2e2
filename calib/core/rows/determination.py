"""Ranks of poses and priors, and their wording for every command.

Whether a combination of parameters is seen depends on the mechanism and the poses, not on the expected size of an error
(sigma). So each column is divided by its own length before ranks are computed
(`calib.core.numerics.identifiability.unit_columns`). A prior determines its parameter, however wide it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter
from calib.core.base.words import sentence
from calib.core.numerics.identifiability import Rank, numerical_rank, reduce_rows, unit_columns


@dataclass(frozen=True, eq=False)
class Determination(ReadOnlyArrays):
    """Ranks of one set of poses.

    Attributes:
        everything: Rank of all parameters, poses alone.
        free: Rank of the free parameters, poses alone.
        together: Rank of the free parameters, poses and priors.
        columns: Unit columns of all parameters, or their triangular factor, (n, n_parameters).
        lengths: Divisor of each column, (n_parameters,) [m per m or rad].
        free_columns: Unit columns of the free parameters, and a row for each prior, (n, n_free).
    """

    everything: Rank
    free: Rank
    together: Rank
    columns: FloatArray
    lengths: FloatArray
    free_columns: FloatArray

    def lines(self) -> list[str]:
        """Return sentences with both ranks of the poses alone, their gaps, and doubts where they are unclear."""
        lines = [f"All {self.everything.n_columns} parameters, poses alone: {self.everything}"]
        if self.free.n_columns != self.everything.n_columns:
            lines.append(f"The {self.free.n_columns} free parameters, poses alone: {self.free}")
        doubts = dict.fromkeys(rank.doubt for rank in (self.everything, self.free) if rank.unclear)
        return lines + [sentence(doubt) for doubt in doubts]

    @property
    def missing(self) -> int:
        """Number of combinations of the free parameters that neither poses nor priors determine."""
        return self.together.n_columns - self.together.rank

    def words(self) -> str:
        """Return a clause with the number of combinations of free parameters that poses and priors determine."""
        poses, n_free = self.free.rank, self.free.n_columns
        if poses == n_free:
            return f"all {n_free} free parameters can be found from these poses"
        text = f"{poses} combinations of the {n_free} free parameters can be found from these poses"
        more = self.together.rank - poses
        if self.missing == 0:
            return f"{text}; the other {more} stay near nominal"
        are = "is" if self.missing == 1 else "are"
        return f"{text}{f', {more} more stay near nominal' if more else ''}; {self.missing} {are} NOT determined"


def determination(columns: FloatArray, parameters: Sequence[Parameter], free: BoolArray) -> Determination:
    """Return the ranks of the derivatives of measured coordinates.

    Args:
        columns: d(coordinates)/d(parameters), not scaled, (n_rows, n_parameters) [m per m or rad].
        free: Mask of the parameters that are not held, (n_parameters,).
    """
    unit, lengths = unit_columns(columns)
    unit = reduce_rows(unit)
    has_prior = np.array([p.prior for p, use in zip(parameters, free, strict=True) if use], dtype=bool)
    together = np.vstack([unit[:, free], np.eye(len(has_prior))[has_prior]])
    of_all = numerical_rank(unit)
    of_free = of_all if np.all(free) else numerical_rank(unit[:, free])
    with_priors = numerical_rank(together) if np.any(has_prior) else of_free
    return Determination(of_all, of_free, with_priors, unit, lengths, together)

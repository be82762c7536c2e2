"""Ranks of poses and priors, and their wording for every command.

Whether a combination of parameters is seen depends on the mechanism and the poses, not on the expected size of an error
(sigma). So each column is divided by its own length before ranks are computed
(`calib.core.numerics.identifiability.unit_columns`). A prior determines its parameter, however wide it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter
from calib.core.base.words import sentence
from calib.core.numerics.identifiability import Rank, numerical_rank, unit_columns


@dataclass(frozen=True, eq=False)
class Determination(ReadOnlyArrays):
    """Ranks of one set of poses, each computed at first use.

    Attributes:
        columns: Unit columns of all parameters, or their triangular factor, (n, n_parameters).
        lengths: Divisor of each column, (n_parameters,) [m per m or rad].
        is_free: Mask of the parameters that are not held, (n_parameters,).
        has_prior: Mask of the free parameters with a prior, (n_free,).
    """

    columns: FloatArray
    lengths: FloatArray
    is_free: BoolArray
    has_prior: BoolArray

    @cached_property
    def everything(self) -> Rank:
        """Rank of all parameters, poses alone."""
        return numerical_rank(self.columns)

    @cached_property
    def free(self) -> Rank:
        """Rank of the free parameters, poses alone."""
        return self.everything if np.all(self.is_free) else numerical_rank(self.columns[:, self.is_free])

    @cached_property
    def together(self) -> Rank:
        """Rank of the free parameters, poses and priors."""
        return numerical_rank(self.free_columns) if np.any(self.has_prior) else self.free

    @property
    def free_columns(self) -> FloatArray:
        """Unit columns of the free parameters, and a row for each prior, (n, n_free)."""
        return np.vstack([self.columns[:, self.is_free], np.eye(len(self.has_prior))[self.has_prior]])

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
    """Return the ranks of the derivatives of measured coordinates by parameters, `free` where they are not held.

    The derivatives, or their triangular factor, are not scaled, (n_rows, n_parameters) [m per m or rad].
    """
    unit, lengths = unit_columns(columns)
    has_prior = np.array([p.prior for p, use in zip(parameters, free, strict=True) if use], dtype=bool)
    return Determination(unit, lengths, free, has_prior)

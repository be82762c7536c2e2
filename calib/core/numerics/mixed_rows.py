"""Rows of a mixed model, and the components that replace their columns (`calib.core.numerics.mixed_model`)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics import linalg
from calib.core.numerics.clusters import blocks_of_equal_length
from calib.core.numerics.identifiability import reduce_rows
from calib.core.numerics.linear_model import LinearModel
from calib.core.numerics.prior import Prior

FLAT, KNOWN = -2, -1
"""Family numbers with a meaning: `FLAT` is a column without a prior, `KNOWN` is one with the prior N(0, 1)."""
UNSEEN = 1e-3
"""Of a component of this length, rows decide a millionth of the variance."""
_ASIDE = 1e-4  # components of a family below this part of its largest singular value are dropped
_ROUNDING = 1e-11  # the same part for columns without a prior: less is rounding of columns that depend on others


@dataclass(frozen=True, eq=False)
class MixedRows(ReadOnlyArrays):
    """Rows of the model.

    Attributes:
        columns: X, whitened by what is stated, (n_rows, n_columns).
        values: y, whitened, (n_rows,).
        family: Family of each column from 0 on, or `FLAT` or `KNOWN`, (n_columns,).
        group: Group of the noise of each row, (n_rows,).
        has_stated_noise: Whether the noise of each group is 1, (n_groups,).
        pose: Pose of each row, (n_rows,).
        levers: H: derivatives by the variables that scatter from pose to pose, (n_rows, n_scattering); may be empty.
        counts: Number of rows of each group that were read, (n_groups,): where nothing scatters, fewer rows with the
            same products may replace them. If not given, all are here.
        present: Families that are known to be there (`calib.core.numerics.size_search`), (n,).
    """

    columns: FloatArray
    values: FloatArray
    family: IntArray
    group: IntArray
    has_stated_noise: BoolArray
    pose: IntArray
    levers: FloatArray
    counts: IntArray | None = None
    present: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @cached_property
    def stands_for(self) -> FloatArray:
        """Number of rows that each row stands for, (n_rows,)."""
        if self.counts is None:
            return np.ones(len(self.group))
        return (self.counts / np.maximum(np.bincount(self.group, minlength=len(self.counts)), 1))[self.group]

    @staticmethod
    def from_linear_problem(
        model: LinearModel, family: IntArray, stated: BoolArray, pose: IntArray, levers: FloatArray
    ) -> MixedRows:
        """Return the rows of a linear model whose residuals are predicted minus read.

        Args:
            model: Linear model around some deviations from the expected values.
            family: Family of each parameter whose size is found, -1 for others, (n_columns,).
            stated: Whether the noise of each group is stated, (n_groups,).
            pose, levers: Attributes of the rows.
        """
        rows, prior = model.jacobian, model.prior
        kind = np.where(family >= 0, family, np.where(prior.has, KNOWN, FLAT))
        values = rows @ np.where(prior.has, model.deviations, 0.0) - model.residuals
        columns = rows @ (prior.root + np.diag(~prior.has)) if len(prior.together) else rows
        return MixedRows(columns, values, kind, model.layout.group, stated, pose, levers, model.layout.counts)


@dataclass(frozen=True, eq=False)
class FamilyPart(ReadOnlyArrays):
    """Columns of a family and the components that replace them.

    Attributes:
        members: Places of the columns, (n,).
        kept: Components that the rows see, (n, n_kept).
        family: Number of the family.
    """

    members: IntArray
    kept: FloatArray
    family: int

    @staticmethod
    def from_columns(
        members: IntArray, columns: FloatArray, family: int, least: float = 0.0, aside: float = _ASIDE
    ) -> FamilyPart:
        """Return the part of the columns of a family, (n_rows, n), whose components are at least `least` long.

        Others are dropped, as are those below the part `aside` of the longest; of columns with known priors, which have
        many units, those that are shorter than both.
        """
        if family == FLAT:
            lengths = np.linalg.norm(columns, axis=0)
            lengths[lengths == 0.0] = 1.0
            _, values, vectors = linalg.svd(reduce_rows(columns / lengths), full_matrices=False)
            seen = values > _ROUNDING * values[0]
            kept = vectors[seen].T / values[seen] / lengths[:, None]
            return FamilyPart(members, kept, family)
        if family == KNOWN and least == 0.0:
            return FamilyPart(members, np.eye(len(members)), family)
        values, vectors = _principal(columns)
        together = min if family == KNOWN else max
        seen = values > together(aside**2 * values[-1], least**2)
        return FamilyPart(members, vectors[:, seen], family)


@dataclass(frozen=True, eq=False)
class Components(ReadOnlyArrays):
    """Components in place of all columns: with w their coefficients, those of the columns are u = B w.

    Attributes:
        parts: Parts of the columns, in the order of their components.
    """

    parts: tuple[FamilyPart, ...]

    @cached_property
    def family(self) -> IntArray:
        """Family of each component, (n_new,)."""
        return np.repeat([part.family for part in self.parts], [part.kept.shape[1] for part in self.parts])

    @cached_property
    def places(self) -> list[tuple[FamilyPart, slice]]:
        """Each part, and the places of its components among those of all."""
        ends = np.cumsum([0, *(part.kept.shape[1] for part in self.parts)]).tolist()
        return list(zip(self.parts, map(slice, ends, ends[1:]), strict=True))

    def combine(self, columns: FloatArray) -> FloatArray:
        """Return `columns` times B, (..., n_new), from (..., n)."""
        result = np.empty((*columns.shape[:-1], len(self.family)))
        for part, place in self.places:
            first, last = part.members[[0, -1]] if len(part.members) else (0, -1)
            together = last - first == len(part.members) - 1  # a slice copies nothing
            own = columns[..., first : last + 1] if together else columns[..., part.members]
            result[..., place] = own @ part.kept
        return result

    def coefficients(self, combined: FloatArray) -> FloatArray:
        """Return u = B w, (n, ...), from w (n_new, ...)."""
        result = np.zeros((sum(len(part.members) for part in self.parts), *combined.shape[1:]))
        for part, place in self.places:
            result[part.members] = part.kept @ combined[place]
        return result


@dataclass(frozen=True, eq=False)
class SeenColumns(Components):
    """Columns other than those of families (family -1), then the components of families that the rows see.

    B has orthonormal columns. Components that rows do not see keep the mean of their prior, whatever the size of the
    family is. Each family has at least one component.

    Attributes:
        prior: Prior of w.
    """

    prior: Prior

    @staticmethod
    def from_rows(rows: FloatArray, prior: Prior, family: IntArray, least: float | None = None) -> SeenColumns:
        """Return what rows see.

        Args:
            rows: (n_rows, n).
            family: Family of each column, -1 for none, (n,).
            least: Length of the shortest component; a ten-thousandth of the longest of its family if not given.
        """
        others = np.flatnonzero(family < 0)
        parts = [FamilyPart(others, np.eye(len(others)), KNOWN)]
        for number in range(int(np.max(family, initial=-1)) + 1):
            members = np.flatnonzero(family == number)
            aside, shortest = (_ASIDE, 0.0) if least is None else (0.0, least)
            part = FamilyPart.from_columns(members, rows[:, members], number, shortest, aside)
            any_of_them = np.eye(len(members), 1)  # each family has a component, if rows see none of them
            parts.append(part if part.kept.size else replace(part, kept=any_of_them))
        known = prior.select(others)  # families have independent priors
        of_families = np.ones(sum(part.kept.shape[1] for part in parts[1:]), dtype=bool)
        return SeenColumns(tuple(parts), replace(known, has=np.append(known.has, of_families)))

    def model(self, linear: LinearModel) -> LinearModel:
        """Return a linear model of u as one of w."""
        columns, deviations = self.combine(linear.jacobian), self.combine(linear.deviations)
        return LinearModel(linear.residuals, columns, self.prior, deviations, linear.layout)

    def covariance(self, combined: FloatArray, unseen: FloatArray) -> FloatArray:
        """Return the covariance of u, (n, n).

        Args:
            combined: Covariance of w, (n_new, n_new).
            unseen: Variance of the components of each family that rows do not see, (n_families,).
        """
        left = self.coefficients(combined)
        result = np.empty((len(left), len(left)))
        for part, place in self.places:
            result[:, part.members] = left[:, place] @ part.kept.T
        for part, variance in zip(self.parts[1:], unseen, strict=True):
            aside = np.eye(len(part.members)) - part.kept @ part.kept.T
            result[np.ix_(part.members, part.members)] += variance * aside
        return result


def whiten_scatter(levers: FloatArray, pose: IntArray, *arrays: FloatArray) -> list[FloatArray]:
    """Return rows whose noise is white, from rows with the noise N(0, I + H_k H_k^T) at each pose k.

    Args:
        levers: H: derivatives by the variables that scatter, times their standard deviations, (n_rows, n_scattering).
        pose: Pose of each row, (n_rows,).
        arrays: Any rows, (n_rows, ...).
    """
    result = [array.copy() for array in arrays]
    for places in blocks_of_equal_length(pose) if np.any(levers) else ():
        own = levers[places]
        values, turn = linalg.eigh(np.matmul(own.swapaxes(1, 2), own))
        root = np.sqrt(1.0 + np.maximum(values, 0.0))
        across = np.matmul(own, turn)  # (1 + H H^T)^-1/2 = 1 - A diag(1 / (root + root^2)) A^T with A = H `turn`
        for array in result:
            flat = array[places].reshape(*places.shape, -1)
            inner = np.matmul(across.swapaxes(1, 2), flat) / (root + root**2)[:, :, None]
            array[places] -= np.matmul(across, inner).reshape(array[places].shape)
    return result


def _principal(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squares of singular values in rising order (k,), and right singular vectors (n, k), k at most the rows."""
    if columns.shape[1] <= len(columns):
        return linalg.eigh(columns.T @ columns)
    values, left = linalg.eigh(columns @ columns.T)
    return values, columns.T @ (left / np.sqrt(np.maximum(values, np.finfo(float).tiny)))

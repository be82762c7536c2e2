"""Rows of a mixed model, and the components that replace their columns (`calib.core.numerics.mixed_model`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics import linalg
from calib.core.numerics.linear_model import LinearModel

FLAT, KNOWN = -2, -1
"""Family numbers with a meaning: `FLAT` is a column without a prior, `KNOWN` is one with the prior N(0, 1)."""
_ASIDE = 1e-4  # components of a family below this part of its largest singular value are dropped
_UNSEEN = 1e-11  # the same part for columns without a prior: less is rounding of columns that depend on others


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
    """

    columns: FloatArray
    values: FloatArray
    family: IntArray
    group: IntArray
    has_stated_noise: BoolArray
    pose: IntArray
    levers: FloatArray

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
        return MixedRows(columns, values, kind, model.layout.group, stated, pose, levers)


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
    def from_columns(members: IntArray, columns: FloatArray, family: int, least: float = 0.0) -> FamilyPart:
        """Return the part of the columns of a family, (n_rows, n); without components shorter than `least`."""
        if family == FLAT:
            lengths = np.linalg.norm(columns, axis=0)
            lengths[lengths == 0.0] = 1.0
            values, vectors = _principal(columns / lengths)
            seen = values > _UNSEEN**2 * values[-1]
            kept = vectors[:, seen] / np.sqrt(values[seen]) / lengths[:, None]
            return FamilyPart(members, kept, family)
        values, vectors = _principal(columns)
        seen = values > max(_ASIDE**2 * values[-1], least**2 if family >= 0 else 0.0)
        return FamilyPart(members, vectors[:, seen], family)


def _principal(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squares of singular values in rising order (k,), and right singular vectors (n, k), k at most the rows."""
    if columns.shape[1] <= len(columns):
        return linalg.eigh(columns.T @ columns)
    values, left = linalg.eigh(columns @ columns.T)
    return values, columns.T @ (left / np.sqrt(np.maximum(values, np.finfo(float).tiny)))

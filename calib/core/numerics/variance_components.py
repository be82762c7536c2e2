"""Size of the noise from the residuals: scales of groups of rows.

Model. The rows y of a linear problem with priors are whitened by the stated noise. They have the covariance V =
diag(s_g^2), with s_g = 1 for groups whose noise is stated; the other s_g are found by restricted maximum likelihood:
with A = J^T V^-1 J + P and Q = V^-1 - V^-1 J A^-1 J^T V^-1, the part V_g of V of each group has at the stationary point

    y^T Q V_g Q y = trace(Q V_g)

Each scale is repeatedly multiplied by the root of the ratio of the left side to the right side (Förstner's iteration).
With one group this is sigma^2 = |r|^2 / (rows - effective parameters).

When it fails. The noise of a group is undetermined if the group has fewer rows than parameters that it alone
determines.

Reference: foerstner1979; patterson1971.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import NotIdentifiableError
from calib.core.numerics.chances import EXACT
from calib.core.numerics.identifiability import reduce_rows
from calib.core.numerics.linear_model import LinearModel

_ROUNDS = 60
_SETTLED = 1e-4


def require_freedom(freedom: float, n_rows: int) -> None:
    """Raise `NotIdentifiableError` unless n_rows measured values leave at least one degree of freedom."""
    if freedom < 1 - 1e-9:
        raise NotIdentifiableError(
            f"{n_rows} measured values for {n_rows - max(freedom, 0.0):.0f} parameters: too few to find the"
            " uncertainty of the result. Measure more poses"
        )


def find_scales(model: LinearModel, start: FloatArray, sought: BoolArray) -> FloatArray:
    """Return the scales, (n_groups,), from the triangular factor of each group's rows.

    Args:
        model: The rows, whitened by the stated noise.
        start: Scales to start from, (n_groups,).
        sought: Mask of the scales to be found, (n_groups,).

    Raises:
        NotIdentifiableError: No degrees of freedom are left.
    """
    members, counts = [model.layout.group == g for g in range(len(start))], model.layout.counts
    factors = [
        model.factor if np.all(rows) else reduce_rows(model.jacobian[rows], model.residuals[rows]) for rows in members
    ]
    scales = start.copy()

    def scaled() -> LinearModel:
        stacked = np.vstack([factor / scale for factor, scale in zip(factors, scales, strict=True)])
        return replace(model, residuals=stacked[:, -1], jacobian=stacked[:, :-1])

    for _ in range(_ROUNDS):
        now = scaled()
        known, step = now.posterior_information, now.step()
        change = np.ones(len(start))
        for g in map(int, np.flatnonzero(sought & (counts > 0))):
            factor = factors[g] / scales[g]
            left = factor[:, :-1] @ step + factor[:, -1]
            freedom = counts[g] - float(np.sum((factor[:, :-1] @ known.root) ** 2))
            change[g] = np.sqrt(float(left @ left) / max(freedom, 0.5))
        scales = np.maximum(scales * change, EXACT / 10)
        if np.all(np.abs(change - 1.0) <= _SETTLED) or np.all((scales < EXACT) | ~sought):
            break
    freedom_left = int(np.sum(counts)) - known.root.shape[1] + float(np.sum(model.prior.times(known.root) ** 2))
    require_freedom(freedom_left, int(np.sum(counts)))
    return scales

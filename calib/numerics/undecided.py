"""What models that the data do not exclude leave uncertain, beside one that was taken.

Each of several kinds of columns may stand beside those of a linear model, one at most. Coefficients of a kind have the
prior c ~ N(0, a^2) in units of what is expected, and its size a is half-normal: a kind that is there is about as large
as is expected. Before measuring, some kind is as likely as none, and each as likely as the others. With M the
information that the rows have about c beside all others, and z their pull on it, both beside the model that was taken,
a kind of size a has

    evidence over that of none     |1 + a^2 M|^(-1/2)  exp( z^T G z / 2 ),      G = (M + a^-2)^-1
    coefficients                   -G z,  with covariance G

Averaged over sizes and kinds by their evidence, the mean square of c counts the chance that a kind is there and was not
taken (hoeting1999): an evidence too small to prove it does not say that it is zero. What else follows c comes with it.

When it fails. Several kinds that are there together and each unproven: only one is counted at a time.

Reference: hoeting1999; kass1995.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.base.arrays import FloatArray, ReadOnlyArrays

_SIZES = np.geomspace(0.05, 3.0, 12)
"""Sizes over what is expected."""
_NOTHING = 1e-12  # part of the largest information that is rounding


@dataclass(frozen=True, eq=False)
class Averaged(ReadOnlyArrays):
    """What is known of the coefficients of a kind that was not taken.

    Attributes:
        chance: That it is there.
        spread: R with R R^T the mean square of its coefficients, (n, n).
    """

    chance: float
    spread: FloatArray


def averaged(kinds: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[Averaged, ...]:
    """Return what is known of each kind, from M (n, n) and z (n,) of each; see the module docstring."""
    density = _SIZES * np.exp(-0.5 * _SIZES**2)  # of log a
    density /= density.sum() * max(len(kinds), 1)
    parts = []
    for inner, pull in kinds:
        values, vectors = np.linalg.eigh(inner)
        known = np.maximum(values, _NOTHING * values.max(initial=0.0))
        pulled = vectors.T @ pull
        left = 1.0 / (known + _SIZES[:, None] ** -2.0)  # G of each size, along each direction
        rise = 0.5 * np.sum(left * pulled**2, axis=1) - 0.5 * np.sum(np.log1p(_SIZES[:, None] ** 2 * known), axis=1)
        parts.append((rise + np.log(density), left, left * pulled, vectors))
    total = scipy.special.logsumexp(np.concatenate([[0.0], *(rise for rise, *_ in parts)]))
    result = []
    for rise, left, found, vectors in parts:
        chance = np.exp(rise - total)
        square = np.diag(chance @ left) + (found.T * chance) @ found
        size, directions = np.linalg.eigh(square)
        root = vectors @ (directions * np.sqrt(np.maximum(size, 0.0)))
        result.append(Averaged(float(np.sum(chance)), root))
    return tuple(result)

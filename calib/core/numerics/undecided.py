"""What models that the data do not exclude leave uncertain, beside one that was taken.

Each of several kinds of columns may stand beside those of a linear model. Coefficients of a kind have the prior
c ~ N(0, a^2) in units of what is expected, and its size a is half-normal: a kind that is there is about as large as is
expected. Before measuring, each kind is there with a chance of one in six, whatever the others are. With M the
information that the rows have about c beside the model that was taken, and z their pull on it, a kind of size a has

    evidence over that of none     |1 + a^2 M|^(-1/2)  exp( z^T G z / 2 ),      G = (M + a^-2)^-1
    coefficients                   -G z,  with covariance G

Averaged over sizes by their evidence, the mean square of c counts the chance that the kind is there and was not taken
(hoeting1999): an evidence too small to prove it does not say that it is zero. What else follows c comes with it.

Why one in six. Readings cannot tell a robot without a kind from one that has little of it, so no interval is right for
both (leeb2005). A larger chance widens the intervals of robots that have none of the kinds; a smaller one makes those
of robots that have one too narrow. With one in six, both are wrong by about as much (`docs/theory/joint_terms.md`). A
chance that all kinds share would get smaller with every kind that a robot can be asked for.

When it fails. Kinds that look alike are each counted as if the others were not there: intervals are then wide.

Reference: hoeting1999; kass1995; leeb2005.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.numerics import linalg

_SIZES = np.geomspace(0.05, 3.0, 12)
"""Sizes over what is expected."""
_CHANCE = 1.0 / 6.0  # that a kind is there, before measuring
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


def averaged(inner: FloatArray, pull: FloatArray) -> Averaged:
    """Return what is known of a kind, from M (n, n) and z (n,); see the module docstring."""
    density = _SIZES * np.exp(-0.5 * _SIZES**2)  # of log a
    density *= _CHANCE / (1.0 - _CHANCE) / density.sum()
    values, vectors = linalg.eigh(inner)
    known = np.maximum(values, _NOTHING * values.max(initial=0.0))
    pulled = vectors.T @ pull
    left = 1.0 / (known + _SIZES[:, None] ** -2.0)  # G of each size, along each direction
    rise = 0.5 * np.sum(left * pulled**2, axis=1) - 0.5 * np.sum(np.log1p(_SIZES[:, None] ** 2 * known), axis=1)
    odds = rise + np.log(density)
    chance, coefficients = np.exp(odds - scipy.special.logsumexp(np.append(odds, 0.0))), left * pulled
    square = np.diag(chance @ left) + (coefficients.T * chance) @ coefficients
    size, directions = linalg.eigh(square)
    return Averaged(float(np.sum(chance)), vectors @ (directions * np.sqrt(np.maximum(size, 0.0))))

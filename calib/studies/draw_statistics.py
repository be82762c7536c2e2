"""What the minima of many draws say, computed for all of them at once.

The formulas are those of `calib.core.numerics.statistics`, with one more axis for the draws. With the common
coordinates z, u = u_0 + T z, and L L^T the Hessian of a draw in these (`calib.core.numerics.nearby`), its own T is T
L^-T, and the span of its rows J L^-T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.fitting.fitted import Fit
from calib.core.fitting.solving import ROUNDING, STEP_LEFT
from calib.core.numerics.chances import UNLIKELY
from calib.core.numerics.clusters import directions, of_equal_length, scatters
from calib.core.numerics.losses import any_outlier, studentised_squares
from calib.core.numerics.nearby import Minima, Nearby
from calib.core.numerics.statistics import noise_factors
from calib.core.rows.rows import Layout


@dataclass(frozen=True, eq=False)
class Estimate:
    """What one draw gave.

    Attributes:
        values: Of the free parameters, (n_free,) [m or rad].
        covariance: Theirs, (n_free, n_free).
        std: Their standard deviations, (n_free,).
        half_width: Half their 95 % intervals, (n_free,).
        coverage_factor: How many standard deviations make half a 95 % interval.
        sigma: Noise found of each group of rows, (n_groups,) [SI].
        chi_square: Sum of squares of the residuals in units of the stated noise, where all of it is stated.
        freedom: Degrees of freedom.
        names_outliers: Whether some reading lies further off than noise explains.
        open: Why it is no minimum; empty where it is one.
    """

    values: FloatArray
    covariance: FloatArray
    std: FloatArray
    half_width: FloatArray
    coverage_factor: float
    sigma: FloatArray
    chi_square: float
    freedom: float
    names_outliers: bool
    open: str = ""


def estimates_at(minima: Minima, nearby: Nearby, first: Fit) -> dict[int, Estimate]:
    """Return what draws gave whose noise is as stated, by their numbers; without those that are no minimum.

    Args:
        minima: Of the draws.
        nearby: In which coordinates.
        first: The calibration at the known minimum, with the same rows.
    """
    layout, unknowns = first.rows.layout, first.unknowns
    inverse = np.linalg.inv(minima.root).transpose(0, 2, 1)
    span, root = minima.jacobian @ inverse, first.rows.known.root @ inverse
    held = nearby.held @ inverse
    factors, freedom = noise_factors(
        minima.residuals**2, np.einsum("dij,dij->di", span, span), layout.group, len(layout.groups)
    )
    total = np.sum(freedom, axis=1)
    noise = np.where(layout.group >= 0, factors[:, layout.group], 1.0)
    (scatter, shared, behind), outlier = _judged(span, minima.residuals, noise, total, layout)
    weighed = span * np.where(layout.group >= 0, noise, 0.0)[:, :, None]
    core = held.transpose(0, 2, 1) @ held
    core += np.where(shared[:, None, None], scatter, weighed.transpose(0, 2, 1) @ weighed)
    covariance = np.multiply.outer(unknowns.scales, unknowns.scales) * (root @ core @ root.transpose(0, 2, 1))
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    coverage = scipy.special.stdtrit(np.where(shared, np.minimum(total, behind), total), 0.975)
    beyond = first.statistics.beyond_linear
    half_width = coverage[:, None] * np.sqrt(std**2 + (0.0 if beyond is None else beyond.values))
    values = unknowns.values_at(first.rows.deviations + minima.z @ first.rows.known.root.T)
    away = unknowns.scales * np.abs(np.matmul(root, minima.step[:, :, None])[:, :, 0]) / (std + ROUNDING)
    ok = (total >= 1.0) & np.all(away < STEP_LEFT, axis=1)
    sigma = factors * np.array([group.typical for group in layout.groups])
    chi_square = np.sum(freedom * factors**2, axis=1)
    told = zip(values, covariance, std, half_width, coverage, sigma, chi_square, total, outlier, strict=True)
    return {k: Estimate(*each) for k, use, each in zip(minima.draws.tolist(), ok, told, strict=True) if use}


def _judged(
    span: FloatArray, residuals: FloatArray, noise: FloatArray, freedom: FloatArray, layout: Layout
) -> tuple[tuple[FloatArray, BoolArray, FloatArray], BoolArray]:
    """How poses scatter: core, whether that is beyond chance, and its freedom; and which draws name outliers."""
    poses = [(rows, directions(span[:, rows], residuals[:, rows])) for rows in of_equal_length(layout.pose_of_row)]
    readings = poses
    if len(np.unique(layout.pose)) < layout.n_readings:
        readings = [(rows, directions(span[:, rows], residuals[:, rows])) for rows in of_equal_length(layout.reading)]
    squares = np.empty((len(span), layout.n_readings))
    for rows, (values, errors, _) in readings:
        squares[:, layout.reading[rows[:, 0]]] = studentised_squares(residuals[:, rows], values, errors)
    parts = ((*seen, noise[:, rows]) for rows, seen in poses)
    core, ratio, chance, behind, _ = scatters(parts, (len(span), span.shape[2]), freedom)
    return (core, (ratio > 1.0) & (chance < UNLIKELY), behind), any_outlier(squares, layout.width, freedom)

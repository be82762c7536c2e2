"""The figures of ISO 9283, each with a 95 % interval for what infinitely many cycles would give.

For n cycles of one commanded pose, with x_j the attained minus the commanded position, x their mean, l_j = |x_j - x|:

    pose accuracy                     AP = |x|                       angles: AP_a = mean of a_j
    pose repeatability                RP = mean(l) + 3 std(l)        angles: RP_a = 3 std(a)
    multi-directional variation       vAP = largest |x_h - x_k| of the directions h, k of approach
    distance accuracy                 AD = mean(D_j) - D_c       D_j attained distance of two poses, D_c commanded
    distance repeatability            RD = 3 std(D)
    drift                             dAP, dRP = largest |value - first value| of blocks of cycles in the order of time

The standard requires 30 cycles; fewer give wider intervals.

Intervals. Scatter is taken as normal. Means of angles and distances have Student's t, deviations chi-square. AP is the
length of a mean with covariance S: |x|^2 / g is about noncentral chi-square with h = tr(S) / g degrees of freedom and
|mu|^2 / g, and is inverted for |mu|. g is the larger of tr(S^2) / tr(S), which gives |x|^2 its variance without an
offset, and the variance along x, which decides where the offset outweighs the scatter. It is multiplied by the square
of Student's t over the normal quantile, as S is found from n cycles. RP over its true value has a distribution that
depends only on n and the shape of the scatter; it is drawn with the shape as found. The interval of a largest value
takes each candidate's interval at its share of the chance, which errs on the wide side.

Sources. AP, RP, vAP and AD follow descriptions of the standard in the literature; its own text was not at hand. RD and
the figures of angles apply the same formulas to one number. For drift, the standard compares repeated values of AP and
RP over time; that the largest change counts, with blocks of ten cycles, is an assumption. vAP, distances and drift of
orientations are not computed.

Reference: iso9283.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg

CYCLES = 30
"""Cycles of each pose that the standard requires."""
_TAIL = 0.025
_DRAWS = 1500


@dataclass(frozen=True)
class Figure:
    """A figure of the standard, with its 95 % limits for infinitely many cycles [m or rad]."""

    value: float
    low95: float
    high95: float


def repeatability(positions: FloatArray) -> float:
    """Return RP of one pose from positions of its cycles (n, 3), n of 2 or more [m]."""
    distance = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    return float(distance.mean() + 3.0 * distance.std(ddof=1))


def pose_accuracy(errors: FloatArray, tail: float = _TAIL) -> Figure:
    """Return AP of attained minus commanded positions, (n, 3), n of 2 or more [m]; `tail` is the chance per side."""
    return _length(errors.mean(axis=0), np.cov(errors.T) / len(errors), len(errors) - 1, tail)


def pose_repeatability(errors: FloatArray, rng: np.random.Generator) -> Figure:
    """Return RP of attained minus commanded positions, (n, 3), n of 2 or more [m]; `rng` draws its interval."""
    value = repeatability(errors)
    axes = np.sqrt(np.maximum(linalg.eigvalsh(np.cov(errors.T)), 0.0))
    if not np.any(axes > 0):
        return Figure(value, value, value)
    drawn = rng.standard_normal((_DRAWS, len(errors), 3)) * axes
    length = np.linalg.norm(drawn, axis=2)
    truth = float(length.mean() + 3.0 * length.std())
    about = np.linalg.norm(drawn - drawn.mean(axis=1, keepdims=True), axis=2)
    ratio = (about.mean(axis=1) + 3.0 * about.std(axis=1, ddof=1)) / truth
    low, high = np.quantile(ratio, [_TAIL, 1 - _TAIL])
    return Figure(value, value / float(high), value / float(low))


def mean_of(values: FloatArray) -> Figure:
    """Return the mean of values (n,): AP of an angle, or AD of attained minus commanded distances [m or rad]."""
    value, n = float(values.mean()), len(values)
    half = float(scipy.special.stdtrit(n - 1, 1 - _TAIL) * values.std(ddof=1) / np.sqrt(n))
    return Figure(value, value - half, value + half)


def three_deviations(values: FloatArray) -> Figure:
    """Return 3 std of values (n,): RP of an angle, or RD of distances [m or rad]."""
    value, freedom = 3.0 * float(values.std(ddof=1)), len(values) - 1
    low, high = (value * np.sqrt(freedom / scipy.special.chdtri(freedom, p)) for p in (_TAIL, 1 - _TAIL))
    return Figure(value, float(low), float(high))


def distances(first: FloatArray, second: FloatArray, commanded: FloatArray) -> FloatArray:
    """Return attained minus commanded distance of two poses, cycle by cycle, (n,) [m].

    Args:
        first, second: Attained minus commanded positions of the cycles at each pose, (n, 3) [m].
        commanded: Vector from the first commanded position to the second, (3,) [m].
    """
    return np.asarray(np.linalg.norm(commanded + second - first, axis=1) - np.linalg.norm(commanded))


def direction_variation(groups: Sequence[FloatArray]) -> Figure:
    """Return vAP of a pose [m] from attained minus commanded positions by direction of approach, (n, 3) each [m]."""
    pairs = list(combinations(groups, 2))
    lengths = []
    for first, second in pairs:
        apart, freedom = first.mean(axis=0) - second.mean(axis=0), min(len(first), len(second)) - 1
        spread = np.cov(first.T) / len(first) + np.cov(second.T) / len(second)
        lengths.append(_length(apart, spread, freedom, _TAIL / len(pairs)))
    return _largest(lengths)


def drift(blocks: Sequence[FloatArray], rng: np.random.Generator) -> tuple[Figure, Figure]:
    """Return dAP and dRP of a pose [m].

    Args:
        blocks: Attained minus commanded positions of blocks of cycles in the order of time, (n, 3) each [m].
    """
    tail = _TAIL / len(blocks)
    accuracy = [pose_accuracy(block, tail) for block in blocks]
    scatter = [pose_repeatability(block, rng) for block in blocks]
    return _largest_change(accuracy), _largest_change(scatter)


def _largest_change(figures: Sequence[Figure]) -> Figure:
    first, changes = figures[0], []
    for figure in figures[1:]:
        apart = max(figure.low95 - first.high95, first.low95 - figure.high95, 0.0)
        most = max(figure.high95 - first.low95, first.high95 - figure.low95)
        changes.append(Figure(abs(figure.value - first.value), apart, most))
    return _largest(changes)


def _largest(figures: Sequence[Figure]) -> Figure:
    return Figure(max(f.value for f in figures), max(f.low95 for f in figures), max(f.high95 for f in figures))


def _length(mean: FloatArray, covariance: FloatArray, freedom: int, tail: float) -> Figure:
    """The length of a mean (3,) whose covariance (3, 3) was found with so many degrees of freedom."""
    value, trace = float(np.linalg.norm(mean)), float(np.trace(covariance))
    if trace <= 0:
        return Figure(value, value, value)
    along = float(mean @ covariance @ mean) / value**2 if value > 0 else 0.0
    g = max(float(np.sum(covariance**2)) / trace, along)
    h = trace / g
    g *= float(scipy.special.stdtrit(freedom, 1 - tail) / scipy.special.ndtri(1 - tail)) ** 2

    def length_at(chance: float) -> float:
        """The true length with which so short a mean has this chance: the longer, the less often."""

        def missing(square: float) -> float:
            return float(scipy.special.chndtr(value**2 / g, h, square / g)) - chance

        if missing(1e-9 * g) <= 0:
            return 0.0
        beyond = value**2 + g
        while missing(beyond) > 0:
            beyond *= 2.0
        return float(np.sqrt(scipy.optimize.brentq(missing, 1e-9 * g, beyond, xtol=1e-9 * g)))

    return Figure(value, length_at(1 - tail), length_at(tail))

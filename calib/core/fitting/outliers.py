"""Outliers of a fit: reading, instrument, visit, and size.

An outlier is alone where the other readings of its visit agree with the fit: a corner that was found on a reflection,
one target of several. The readings of a visit are off together where more than half of them are as far off as only one
good reading in a hundred is: a wrong image, a wrong pose of the robot, a board that was moved. With one reading per
visit, the two cases are the same.

A gross error of one reading says nothing of the errors that all poses have, but its square would count as theirs. So
what is found of these errors reads an outlier with the weight (T_0 / T)^2, with T its studentised error and T_0 the
largest one that is no outlier: as if its noise were so much larger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.memoize import memoize
from calib.core.base.units import ERROR_UNIT, quantity_text
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.solved_fit import SolvedFit
from calib.core.instruments.kind import Instrument
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.numerics.clusters import directions
from calib.core.numerics.losses import StudentisedErrors
from calib.core.numerics.tall import Span
from calib.core.rows.rows import Layout, Rows

_ALL = 1.0 - 1e-9  # if outliers decide this part of a direction, nothing else determines it
_LEAST_FACTOR = 1e-3  # least found noise over stated noise of a group, as part of this ratio for all groups


@dataclass(frozen=True)
class Outlier:
    """One reading that does not fit.

    Attributes:
        pose: Index of the visit in its set.
        reading: Index of the reading among all of its set.
        target: Name of the instrument; for positions, this is the name of the target.
        detail: Observed thing, such as a corner of a board; empty where the instrument observes only one.
        n_together: Number of readings of this visit, if they are off together; 0 if this one is off alone.
        label: File, line and pose name.
        distance: Distance between prediction and reading in the first part [SI].
        size: Errors of all parts in words.
        studentised: Studentised error T over its scale, see `calib.core.numerics.losses`.
        leverage: See `calib.core.numerics.losses`.
        p_value: Chance of at least one such error among as many good readings.
    """

    pose: int
    reading: int
    target: str
    detail: str
    n_together: int
    label: str
    distance: float
    size: str
    studentised: float
    leverage: float
    p_value: float

    def __str__(self) -> str:
        return f"{self.label}, {self.description}"

    @property
    def description(self) -> str:
        """The reading and its error in words."""
        what = f"{self.target} {self.detail}" if self.detail else self.target
        return f"{what}: {self.size} off, {self.studentised:.1f} times the error expected there"


@memoize
def studentise_errors(fit: SolvedFit) -> StudentisedErrors:
    """Return the studentised error of every used reading; see `calib.core.numerics.losses`."""
    return _studentise(fit, fit.rows, fit.span, fit.weights)


def bounded_weights(fit: SolvedFit) -> FloatArray:
    """Return the weights of the readings, those of outliers by the module docstring, (n_readings,).

    Outliers pull a fit to themselves, so their errors are those by the linear fit without them.
    """
    errors, is_outlier, used = studentise_errors(fit), np.zeros(len(fit.weights), dtype=bool), fit.weighted_rows
    while not np.all(is_outlier[errors.outliers]):
        is_outlier[errors.outliers] = True
        out = np.flatnonzero(is_outlier[used.layout.reading])
        decided, own, turned = directions(used.span[out], used.residuals[out])
        gain = np.where(decided < _ALL, 1.0 / np.maximum(1.0 - decided, 1.0 - _ALL), 0.0)
        rows = replace(fit.rows, residuals=fit.rows.residuals + fit.span.times(turned.T @ (gain * own)))
        span = fit.span.with_columns(fit.span.times(turned.T * np.sqrt(gain)))  # it has the products U (1 + G) U^T
        errors = _studentise(fit, rows, span, np.where(is_outlier, 0.0, fit.weights))
    return np.minimum(fit.weights, errors.bounded_weights)


def _studentise(fit: SolvedFit, rows: Rows, span: Span, weights: FloatArray) -> StudentisedErrors:
    number = rows.layout.group
    # stated noise of groups may be wrong by different factors: each group is tested by its real noise
    relative = np.maximum(fit.statistics.factors.values / noise_factor(fit), _LEAST_FACTOR)
    divisor = np.where(number >= 0, relative[number], 1.0)
    return replace(rows, residuals=rows.residuals / divisor).studentise(span, weights, fit.statistics.freedom)


def noise_factor(fit: SolvedFit) -> float:
    """Return the ratio of found to stated noise over all groups."""
    return max(float(np.sqrt(np.mean(fit.statistics.factors.values**2))), 1e-30)


def outliers_of(studentised: StudentisedErrors, error_set: ErrorSet, layout: Layout) -> tuple[Outlier, ...]:
    """Return the outliers of a set, worst first."""
    together = _n_far_off(studentised, layout)
    result = []
    for k in map(int, studentised.outliers):
        name = next(name for name in layout.instruments if layout.readings_of(name).stop > k)
        instrument = next(each for each in error_set.instruments if each.name == name)
        number = k - layout.readings_of(name).start
        errors, readings = error_set.after[name][number], error_set.data.readings[name]
        texts = instrument.texts(readings.pairs[[number]], readings.details[[number]])
        visit = int(layout.visit[k])
        result.append(
            Outlier(
                pose=visit,
                reading=k,
                target=name,
                detail=" ".join(word for words in texts.values() for word in words),
                n_together=int(together[visit]),
                label=error_set.data.labels[visit] if readings.labels is None else readings.labels[number],
                distance=float(_lengths(instrument, errors)[0]),
                size=size_in_words(instrument, errors),
                studentised=float(studentised.ratio[k]),
                leverage=float(studentised.leverage[k]),
                p_value=float(studentised.p_value[k]),
            )
        )
    return tuple(result)


def _n_far_off(studentised: StudentisedErrors, layout: Layout) -> IntArray:
    n_visits = int(layout.visit.max(initial=-1)) + 1
    readings = np.bincount(layout.visit, minlength=n_visits)
    suspects = np.bincount(layout.visit, studentised.chance < FALSE_ALARM, minlength=n_visits)
    return np.where((readings > 1) & (2 * suspects > readings), readings, 0)


def outliers_in_words(outliers: Sequence[Outlier]) -> list[str]:
    """Return each outlier in words; a visit whose readings are off together is one text."""
    words: dict[object, str] = {}
    for number, outlier in enumerate(outliers):
        if outlier.n_together:
            text = f"{outlier.label}, all {outlier.n_together} readings together, such as {outlier.description}"
            words.setdefault(("visit", outlier.pose), text)
        else:
            words["reading", number] = str(outlier)
    return list(words.values())


def readings_of_outliers(outliers: Sequence[Outlier], layout: Layout) -> dict[str, IntArray]:
    """Return indices of the outliers' readings by instrument, (n,): the reading alone, or all readings of its visit."""
    visits = [outlier.pose for outlier in outliers if outlier.n_together]
    gone = np.isin(np.arange(layout.n_readings), [outlier.reading for outlier in outliers])
    gone |= np.isin(layout.visit, visits)
    return numbers_by_instrument(np.flatnonzero(gone), layout)


def numbers_by_instrument(readings: Sequence[int] | IntArray, layout: Layout) -> dict[str, IntArray]:
    """Return indices among all readings (n,) as indices among the readings of each instrument, (n_own,)."""
    chosen = np.isin(np.arange(layout.n_readings), readings)
    return {name: np.flatnonzero(chosen[layout.readings_of(name)]) for name in layout.instruments}


def size_in_words(instrument: Instrument, errors: FloatArray) -> str:
    """Return the errors (n_rows,) [SI] of one reading in words, such as `0.123 mm and 0.4 mrad`."""
    sizes = zip(instrument.parts, _lengths(instrument, errors), strict=True)
    return " and ".join(quantity_text(length, ERROR_UNIT[part.dimension], ".3f") for part, length in sizes)


def _lengths(instrument: Instrument, errors: FloatArray) -> list[float]:
    number = np.array(instrument.part_of_row)
    return [float(np.sqrt(np.nansum(errors[number == k] ** 2))) for k in range(len(instrument.parts))]

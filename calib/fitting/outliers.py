"""Outliers of a fit by name: which reading of which instrument at which visit, and how far off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.base.arrays import FloatArray
from calib.base.units import ERROR_UNIT, error_scale
from calib.fitting.error_sets import ErrorSet
from calib.instruments.kind import Instrument
from calib.numerics.losses import Blocks, Studentised
from calib.rows.rows import Layout, Rows


@dataclass(frozen=True)
class Outlier:
    """One reading that does not fit.

    Attributes:
        pose: Index of the visit in its set.
        reading: Index of the reading among all of its set.
        target: Name of the instrument, which for positions is that of the point.
        label: File, line and pose name.
        distance: Length of the error of its first part, predicted to read [SI].
        size: The errors of its parts in words.
        studentised: T over its scale.
        leverage: See `calib.numerics.losses`.
        p_value: Chance of such a reading among good measurements of this number.
    """

    pose: int
    reading: int
    target: str
    label: str
    distance: float
    size: str
    studentised: float
    leverage: float
    p_value: float

    def __str__(self) -> str:
        return (
            f"{self.label}, {self.target}: {self.size} off, {self.studentised:.1f} times the noise"
            f" (leverage {self.leverage:.2f})"
        )


def blocks(rows: Rows, weights: FloatArray) -> list[Blocks]:
    """Return the readings of each instrument, with these weights (n_readings,), as blocks of equally many rows."""
    layout, result = rows.layout, []
    for name in layout.instruments:
        part, readings = layout.rows_of(name), layout.readings_of(name)
        n = readings.stop - readings.start
        residuals = rows.residuals[part].reshape(n, -1)
        columns = rows.jacobian[part].reshape(n, residuals.shape[1], -1)
        result.append(Blocks(residuals, columns, layout.width[readings], weights[readings]))
    return result


def outliers_of(studentised: Studentised, error_set: ErrorSet, layout: Layout) -> tuple[Outlier, ...]:
    """Return the outliers of a set, worst first."""
    result = []
    for k in map(int, studentised.outliers):
        name = next(name for name in layout.instruments if layout.readings_of(name).stop > k)
        instrument = next(instrument for instrument in error_set.instruments if instrument.name == name)
        errors = error_set.after[name][k - layout.readings_of(name).start]
        visit = int(layout.visit[k])
        result.append(
            Outlier(
                visit,
                k,
                name,
                error_set.data.labels[visit],
                float(_lengths(instrument, errors)[0]),
                size_in_words(instrument, errors),
                float(studentised.ratio[k]),
                float(studentised.leverage[k]),
                float(studentised.p_value[k]),
            )
        )
    return tuple(result)


def size_in_words(instrument: Instrument, errors: FloatArray) -> str:
    """Return the errors (n_rows,) [SI] of one reading in words, such as `0.123 mm and 0.4 mrad`."""
    sizes = []
    for part, length in zip(instrument.parts, _lengths(instrument, errors), strict=True):
        sizes.append(f"{length * error_scale(part.dimension):.3f} {ERROR_UNIT[part.dimension]}")
    return " and ".join(sizes)


def _lengths(instrument: Instrument, errors: FloatArray) -> list[float]:
    number = np.array(instrument.part_of_row)
    return [float(np.sqrt(np.nansum(errors[number == k] ** 2))) for k in range(len(instrument.parts))]

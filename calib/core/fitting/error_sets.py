"""Errors before and after calibration: predicted minus read, instrument by instrument, and tables of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray, IntArray, ReadAsArray, ReadOnlyArrays
from calib.core.base.errors import InputError, nearest
from calib.core.base.memoize import memoize
from calib.core.base.units import ERROR_UNIT, in_unit
from calib.core.data.measurements import Measurements
from calib.core.instruments.kind import Instrument, Part

PERCENTILES = {"median": 50, "p90": 90, "p95": 95, "p99": 99}
"""Percentiles of error tables by their key."""
STATES = ("before", "after")


@dataclass(frozen=True, eq=False)
class ErrorSet(ReadOnlyArrays):
    """Predicted minus read at one set of visits.

    Attributes:
        before, after: Errors before and after calibration of each instrument, by name, (n, n_rows) [SI]; NaN where a
            component was not read.
        singular_value: Each visit's distance to a singularity of the loops; infinite without loops, (n_visits,).
        passive: Passive joints after calibration, from which the loops can be closed again, (n_visits, n_passive)
            [m or rad]; None if they were not kept.
    """

    data: Measurements
    instruments: tuple[Instrument, ...]
    before: Mapping[str, FloatArray]
    after: Mapping[str, FloatArray]
    singular_value: FloatArray
    passive: FloatArray | None = None

    def parts(self) -> tuple[tuple[Instrument, Part, IntArray], ...]:
        """Return every part of every instrument with readings, and its rows, (n_rows,)."""
        return self._parts

    @cached_property
    def _parts(self) -> tuple[tuple[Instrument, Part, IntArray], ...]:
        return tuple(
            (instrument, part, np.flatnonzero(np.array(instrument.part_of_row) == k))
            for instrument in self.instruments
            for k, part in enumerate(instrument.parts)
            if len(self.after.get(instrument.name, ()))
        )

    def errors(self, state: str, part: str = "", *, single: bool = False) -> FloatArray:
        """Return errors of a part of all instruments that have it, (n, k) [SI].

        Args:
            state: `before` or `after`.
            part: Name of the part; the positions if not given.
            single: Whether every reading counts by itself; else those that repeat one pose are averaged, which leaves
                the error of the model.
        """
        pieces = []
        for instrument, measured, rows in self.parts():
            if measured.name == part if part else measured.is_position:
                errors = getattr(self, state)[instrument.name][:, rows]
                pieces.append(errors if single else self._pose_means(instrument.name, errors))
        return np.concatenate(pieces) if pieces else np.zeros((0, 3))

    def _pose_means(self, name: str, errors: FloatArray) -> FloatArray:
        """Means over an instrument's readings of one pose and one pair of frames, in order of first appearance."""
        first, number = repeats(self.data)[name]
        if len(first) == len(errors):
            return errors
        total, count = np.zeros((len(first), errors.shape[1])), np.zeros((len(first), errors.shape[1]))
        np.add.at(total, number, np.nan_to_num(errors))
        np.add.at(count, number, np.isfinite(errors).astype(float))
        with np.errstate(invalid="ignore"):
            means: FloatArray = (total / count)[np.argsort(first)]
        return means

    @property
    def main_part(self) -> Part:
        """The part of summary tables: positions, or the first part where none were measured."""
        parts = [part for _, part, _ in self.parts()]
        return next((part for part in parts if part.is_position), parts[0])

    def squares(self, state: str) -> FloatArray:
        """Return the squared errors `before` or `after` of the main part, (n,) [SI, squared]."""
        return np.asarray(np.nansum(self.errors(state, self.main_part.name) ** 2, axis=1))

    def rms(self, state: str) -> float:
        """Return the root mean square error `before` or `after` of the main part [SI]."""
        return float(np.sqrt(np.mean(self.squares(state))))

    def table(self) -> dict[str, dict[str, object]]:
        """Return error tables `before` and `after` of the main part of all readings [mm for positions]."""
        part = self.main_part
        return {state: error_table(self.errors(state, part.name), part) for state in STATES}

    def tables(self) -> dict[str, dict[str, dict[str, dict[str, object]]]]:
        """Return error tables by instrument, part and state, in the part's unit of errors."""
        result: dict[str, dict[str, dict[str, dict[str, object]]]] = {}
        for instrument, part, rows in self.parts():
            name = instrument.name
            errors = {state: self._pose_means(name, getattr(self, state)[name][:, rows]) for state in STATES}
            tables = {state: error_table(own, part) for state, own in errors.items()}
            result.setdefault(name, {})[part.name] = tables
        return result


@dataclass(frozen=True, eq=False)
class Folds:
    """Errors of all poses, each predicted by the fit of the other folds.

    Attributes:
        errors: Errors in the order of the data.
        rms: Root mean square distance after calibration of each fold [m], (count,).
        setups: Setup of each fold, as the description counts them, (count,); empty for random folds.
    """

    count: int
    seed: int
    errors: ErrorSet
    rms: tuple[float, ...]
    converged: bool
    setups: tuple[int, ...] = ()


@memoize
def repeats(data: Measurements) -> dict[str, tuple[IntArray, IntArray]]:
    """Return the first reading of each pose and pair of frames, (n_poses,), and their number for each reading, (n,)."""
    result = {}
    for name, readings in data.readings.items():
        columns = np.column_stack([data.pose_numbers[readings.visits], readings.pairs, readings.details])
        _, first, number = np.unique(columns, axis=0, return_index=True, return_inverse=True)
        result[name] = first, number.reshape(-1)
    return result


def error_table(errors: FloatArray, part: Part | None = None) -> dict[str, object]:
    """Summarise errors.

    Args:
        errors: Predicted minus read, (n, k) [SI]; NaN where a component was not read.
        part: Part of the rows; a position if not given.

    Returns:
        `mean`, `max`, `rms`, `std`, `median`, `p90`, `p95`, `p99` of the length; and for each axis the `mean`, `max`
        and percentiles of the absolute component, its `rms`, its `std` and its signed mean `bias`. In the unit of
        errors of the part (mm for a position); std is NaN for a single error.
    """
    axes = ("x", "y", "z") if part is None else part.axes
    shown = in_unit(np.asarray(errors), ERROR_UNIT["length" if part is None else part.dimension])
    table: dict[str, object] = {**_summary(np.sqrt(np.nansum(shown**2, axis=1)))}
    for axis, column in zip(axes, shown.T, strict=True):
        values = column[np.isfinite(column)]
        if len(values):
            table[axis] = _summary(values, bias=np.mean(values))
    return table


def _summary(values: FloatArray, **bias: np.floating[Any]) -> dict[str, float]:
    size = np.abs(values)
    numbers = {"mean": np.mean(size), "max": np.max(size), "rms": np.sqrt(np.mean(size**2))}
    numbers["std"] = np.std(values, ddof=1) if len(values) > 1 else np.float64("nan")
    percentiles = zip(PERCENTILES, np.percentile(size, list(PERCENTILES.values())), strict=True)
    return {key: float(value) for key, value in (numbers | bias | dict(percentiles)).items()}


class Errors(dict[str, dict[str, dict[str, object]]]):
    """Errors by set of rows, state and quantity."""

    def __missing__(self, key: object) -> NoReturn:
        raise InputError(f"no errors of '{key}'{nearest(str(key), self)}")


class Residuals(ReadAsArray, dict[str, FloatArray]):
    """Residuals by instrument; if there is only one, also its array: `np.std(fit.residuals)`, `fit.residuals[:10]`."""

    __len__ = dict.__len__

    def __getitem__(self, key: Any) -> Any:
        """Return the residuals of an instrument by its name; with a single one, also an entry of its array."""
        return dict.__getitem__(self, key) if isinstance(key, str) else super().__getitem__(key)

    def __missing__(self, key: object) -> NoReturn:
        whole = "; np.asarray(fit.residuals) is an array" if len(self) == 1 else ""
        raise InputError(f"no residuals of '{key}'{nearest(str(key), self)}{whole}")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if len(self) != 1:
            raise InputError(
                f"residuals of {len(self)} instruments are not one array; take one: residuals['{min(self)}']"
            )
        return np.array(next(iter(self.values())), dtype=dtype)

"""Whitening: from residuals and derivatives to the rows of `calib.core.rows.rows`, by the stated noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.units import Dimension
from calib.core.data.measurements import Measurements
from calib.core.instruments.kind import Instrument, Readings
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed
from calib.core.rows.rows import Group, Layout, Rows
from calib.core.rows.unknowns import Unknowns

ASSUMED: dict[Dimension, float] = {"length": 1e-4, "angle": 1e-4, "pixel": 0.5}
"""Noise of one component if it is neither stated nor shown by residuals [SI]; messages must say that it is assumed."""


class Whitening:
    """Whitens residuals and derivatives by the stated noise.

    Args:
        robot: Robot whose instruments state their noise.
        sigma: Noise of positions per axis that replaces the stated one [m].

    Attributes:
        groups: Groups of rows whose noise has one scale.
        is_unstated: Mask of the groups whose noise is not stated, (n_groups,).
        layout: Order of the rows.
    """

    def __init__(self, robot: Robot, data: Measurements, sigma: float | None = None) -> None:
        self._names = tuple(instrument.name for instrument in robot.instruments if instrument.name in data.readings)
        self._inverse: dict[str, FloatArray] = {}
        groups: dict[tuple[str, str, bool], Group] = {}
        numbers: dict[str, IntArray] = {}
        for name in self._names:
            instrument, readings = robot.instrument(name), data.readings[name]
            noise, covariance = stated_noise(instrument, sigma), readings.covariance
            if covariance is None:
                covariance = instrument.covariance(readings.values, noise)
            variances, part_of_row = np.diagonal(covariance, axis1=1, axis2=2), np.array(instrument.part_of_row)
            group_of_part = []
            for k, part in enumerate(instrument.parts):
                stated = readings.covariance is not None or noise.parts[k].stated
                typical = float(np.sqrt(np.median(variances[:, part_of_row == k]))) if len(variances) else 1.0
                key = (instrument.group, part.name, stated)
                groups.setdefault(key, Group(instrument.group, part, stated, typical))
                group_of_part.append(list(groups).index(key))
            absent = _absent(instrument, readings)
            numbers[name] = np.where(absent, -1, np.array(group_of_part)[part_of_row])
            self._inverse[name] = _inverse_roots(covariance, absent)
        self.groups = tuple(groups.values())
        self.is_unstated = np.array([not group.stated for group in self.groups], dtype=bool)
        self.layout = _layout(data, numbers, self.groups)

    def flatten(self, arrays: Mapping[str, FloatArray], out: FloatArray | None = None) -> FloatArray:
        """Whiten arrays by instrument, (n, n_rows) or (n, n_rows, k), by the stated covariance; NaN become 0.

        The result is (n_all_rows,) or (n_all_rows, k), in `out` if that is given, in which the arrays may stand at
        their places, `readings_in`.
        """
        rows = np.empty((self.layout.n_rows, *arrays[self._names[0]].shape[2:])) if out is None else out
        for name in self._names:
            inverse, own = self._inverse[name], self.readings_in(rows, name)
            array = arrays[name].reshape(own.shape)
            array = np.nan_to_num(array) if np.isnan(array).any() else array
            if inverse.ndim == 2:  # no correlations
                np.multiply(array, inverse[:, :, None], out=own)
            else:
                np.matmul(inverse, array, out=own)
        return rows

    def readings_in(self, rows: FloatArray, name: str) -> FloatArray:
        """Return the part of all rows, (n_all_rows,) or (n_all_rows, k), of one instrument, (n, n_rows, 1 or k)."""
        return rows[self.layout.rows_of(name)].reshape(*self._inverse[name].shape[:2], *(rows.shape[1:] or (1,)))

    def whiten(self, arrays: Mapping[str, FloatArray], groups: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Whiten arrays as `flatten` does, and divide them by the scales of the groups, (n_groups,)."""
        rows = self.flatten(arrays, out)
        if np.any(groups != 1.0):
            rows /= self.row_scale(groups).reshape(-1, *[1] * (rows.ndim - 1))
        return rows

    def unwhiten_rows(self, whitened: FloatArray, groups: FloatArray) -> dict[str, FloatArray]:
        """Undo whitening by the scales of the groups, from all rows (n_all_rows,) to readings, (n, n_rows) [SI]."""
        numbers = self.row_scale(groups) * whitened
        result = {}
        for name in self._names:
            inverse = self._inverse[name]
            own = numbers[self.layout.rows_of(name)].reshape(inverse.shape[:2])
            if inverse.ndim == 2:
                result[name] = np.divide(own, inverse, out=np.zeros_like(own), where=inverse != 0)
            else:  # a row of zeros was not read
                nothing = ~np.any(inverse, axis=2)[:, :, None] * np.eye(inverse.shape[1])
                result[name] = np.linalg.solve(inverse + nothing, own[:, :, None])[:, :, 0]
        return result

    def row_scale(self, groups: FloatArray) -> FloatArray:
        """Return the scale of each row, from those of the groups (n_groups,); 1 for rows not read, (n_rows,)."""
        number = self.layout.group
        return np.where(number >= 0, groups[number], 1.0)

    def rows(
        self, observed: Mapping[str, Observed], groups: FloatArray, unknowns: Unknowns, values: FloatArray
    ) -> Rows:
        """Return the whitened rows of what was observed at `values` of all parameters, (n_parameters,) [m or rad].

        `observed` has the rows of each instrument, and `groups` the scale of the noise of each group, (n_groups,).
        """
        residuals = self.whiten({name: observed[name].residuals for name in self._names}, groups)
        deviations = unknowns.deviations(values)
        return Rows(residuals, self.columns(observed, groups, unknowns), unknowns.prior, deviations, self.layout)

    def columns(self, observed: Mapping[str, Observed], groups: FloatArray, unknowns: Unknowns) -> FloatArray:
        """Return the whitened derivative of the rows by the scaled unknowns, (n_rows, n_free), as in `rows`."""
        columns = np.empty((self.layout.n_rows, len(unknowns)))
        arrays = {
            name: observed[name].derivative_by(unknowns.index, self.readings_in(columns, name)) for name in self._names
        }
        self.whiten(arrays, groups, columns)
        columns *= unknowns.scales
        return columns

    def joint_columns(self, observed: Mapping[str, Observed], groups: FloatArray) -> FloatArray:
        """Return the whitened derivative of the rows by the joints, (n_rows, n_actuated), as in `rows`."""
        return self.whiten({name: observed[name].joint_derivative for name in self._names}, groups)

    def start(self, residuals: Mapping[str, FloatArray] | None = None) -> FloatArray:
        """Return starting scales: 1 where noise is stated, else the size of `residuals`, (n, n_rows), or `ASSUMED`."""
        result = np.array([1.0 if group.stated else ASSUMED[group.part.dimension] for group in self.groups])
        if residuals is not None and np.any(self.is_unstated):
            flat, number = self.flatten(residuals), self.layout.group
            for g in np.flatnonzero(self.is_unstated):
                result[g] = np.sqrt(np.mean(flat[number == g] ** 2)) + 1e-9
        return result


def stated_noise(instrument: Instrument, sigma: float | None) -> Noise:
    """Return the noise of an instrument, with `sigma` as that of its positions if given [m]."""
    if sigma is None:
        return instrument.noise
    parts = [
        PartNoise.from_sigma(sigma, len(part.axes)) if part.is_position else noise
        for part, noise in zip(instrument.parts, instrument.noise.parts, strict=True)
    ]
    return Noise(tuple(parts))


def _absent(instrument: Instrument, readings: Readings) -> BoolArray:
    absent: BoolArray = np.isnan(readings.values)
    if absent.shape[1] != instrument.n_rows:
        absent = np.any(absent, axis=1, keepdims=True)
    return np.broadcast_to(absent, (len(readings), instrument.n_rows))


def _inverse_roots(covariance: FloatArray, absent: BoolArray) -> FloatArray:
    """L^-1 of C = L L^T, (n, m, m), or (n, m) where C is diagonal; 0 for rows that were not read."""
    covariance = covariance.copy()
    if absent.any():
        covariance[absent[:, :, None] | absent[:, None, :]] = 0.0
        k, row = np.nonzero(absent)
        covariance[k, row, row] = 1.0
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    width = covariance.shape[1]
    if not np.any(covariance[:, ~np.eye(width, dtype=bool)]):
        return np.where(absent, 0.0, 1.0 / np.sqrt(diagonal))
    identity = np.broadcast_to(np.eye(width), covariance.shape)
    return np.where(absent[:, :, None], 0.0, np.linalg.solve(np.linalg.cholesky(covariance), identity))


def _layout(data: Measurements, numbers: Mapping[str, IntArray], groups: tuple[Group, ...]) -> Layout:
    """The order of rows, by the group of each row of each instrument, (n, n_rows); -1: it was not read."""
    of_instruments = list(numbers.values())
    visit = np.concatenate([data.readings[name].visits for name in numbers])
    group = np.concatenate([number.ravel() for number in of_instruments])
    n_rows = np.concatenate([np.full(len(number), number.shape[1]) for number in of_instruments])
    return Layout(
        group,
        np.bincount(group[group >= 0], minlength=len(groups)),
        tuple(numbers),
        np.cumsum([0, *map(len, of_instruments)]),
        np.cumsum([0, *(number.size for number in of_instruments)]),
        np.repeat(np.arange(len(visit)), n_rows),
        visit,
        data.pose_numbers[visit],
        np.concatenate([np.sum(number >= 0, axis=1) for number in of_instruments]),
        groups,
    )

"""One system of whitened rows: what every question about measurements is asked of.

A reading of m components gives m rows. With the covariance of its noise, s_g^2 C_k (C_k as stated, s_g the scale of its
group, 1 where it is stated and found from the residuals where not), residuals r and scaled Jacobian J (columns times
the parameters' sigma) are whitened reading by reading,

    [rw, Jw] = D^(-1/2) [r, J],        D = blocks s_g^2 C_k

Rows of one visit also share what the robot itself is off there: joints that do not come back to the same place, and
what the model leaves out. With an error N(0, tau_j^2) of each joint and the derivatives h_j of the rows by the joints,

    covariance of the rows of a visit      V = D_own + sum of tau_j^2 h_j h_j^T,     D_own = blocks o_g^2 C_k

with o_g what is left to the instrument alone. Estimates are weighed by D, whatever the robot does: what is shared is
mostly what the model leaves out, and weighing by a guess at its shape made a real robot's predictions worse (UR10, full
poses: 0.467 mm in place of 0.442 on rows not used). How sure they are is judged by V (`calib.numerics.statistics`),
which holds for any weights. Visits that repeat one pose share one error: what the model leaves out there is the same
each time.

A component that was not read has a row of zeros, which says nothing; it is not counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.data.measurements import Measurements
from calib.linearisation.observed import Observed
from calib.model.robot import Robot
from calib.numerics.information import Information, information, prior_rows
from calib.numerics.shared_error import SharedError
from calib.observation.kind import Instrument, Part, Readings
from calib.observation.noise import Noise, PartNoise
from calib.units import Dimension

ASSUMED: dict[Dimension, float] = {"length": 1e-4, "angle": 1e-4, "pixel": 0.5}
"""Noise of one component where nobody states it and no residuals tell [SI]; whoever uses it must say so."""


@dataclass(frozen=True)
class Group:
    """Rows whose noise has one scale.

    Attributes:
        name: Of the instruments' group.
        part: Which rows of their readings.
        dimension: What they measure.
        stated: Whether their noise is stated.
        typical: Typical standard deviation as stated, or 1 SI unit [SI].
        usual: The largest that such instruments have [SI]; infinite where nothing is known.
    """

    name: str
    part: str
    dimension: Dimension
    stated: bool
    typical: float
    usual: float = float("inf")


@dataclass(frozen=True, eq=False)
class Scales(ReadOnlyArrays):
    """What is assumed of the noise beyond what is stated.

    Attributes:
        groups: s_g of the module docstring, (n_groups,).
        own: o_g of the module docstring, (n_groups,); s_g without an error shared by visits.
        shared: tau_j of the module docstring, (n_actuated,) [m or rad]; all 0 for none.
    """

    groups: FloatArray
    own: FloatArray
    shared: FloatArray

    @staticmethod
    def of(groups: FloatArray) -> Scales:
        """Return scales (n_groups,) without errors shared by visits."""
        return Scales(groups, groups, np.zeros(0))

    @property
    def shares(self) -> bool:
        """Whether visits share errors."""
        return bool(np.any(self.shared > 0))


@dataclass(frozen=True, eq=False)
class Layout(ReadOnlyArrays):
    """Which row is what: instrument by instrument, reading by reading.

    Attributes:
        instruments: Names of the instruments that read anything.
        start: First reading of each instrument, and the number of all, (n_instruments + 1,).
        first_row: The same for rows, (n_instruments + 1,).
        reading: Reading of each row, (n_rows,).
        visit: Visit of each reading, (n_readings,).
        pose: Pose of each reading; visits that repeat a pose share it, (n_readings,).
        width: Components that each reading really has, (n_readings,).
        group: Group of each row; -1 for a component that was not read, (n_rows,).
        groups: The groups.
    """

    instruments: tuple[str, ...]
    start: IntArray
    first_row: IntArray
    reading: IntArray
    visit: IntArray
    pose: IntArray
    width: IntArray
    group: IntArray
    groups: tuple[Group, ...]

    @property
    def n_rows(self) -> int:
        """Number of rows, those that were not read included."""
        return len(self.reading)

    @property
    def n_read(self) -> int:
        """Number of rows that were read."""
        return int(np.sum(self.width))

    @property
    def n_readings(self) -> int:
        """Number of readings."""
        return len(self.visit)

    def rows_of(self, instrument: str) -> slice:
        """Return the rows of an instrument."""
        k = self.instruments.index(instrument)
        return slice(int(self.first_row[k]), int(self.first_row[k + 1]))

    def readings_of(self, instrument: str) -> slice:
        """Return the readings of an instrument."""
        k = self.instruments.index(instrument)
        return slice(int(self.start[k]), int(self.start[k + 1]))


@dataclass(frozen=True, eq=False)
class Unknowns(ReadOnlyArrays):
    """Parameters that may change, and their scales.

    Attributes:
        names: Their names.
        index: Their places among all parameters, (n,).
        scales: Their sigma, (n,) [SI].
        nominal: Their nominal values, (n,) [SI].
        has_prior: Which of them have a prior, (n,).
        placement: Which only say where instruments and targets are, (n,).
        family: Number of the family of each, -1 for none, (n,).
        families: Their names.
    """

    names: tuple[str, ...]
    index: IntArray
    scales: FloatArray
    nominal: FloatArray
    has_prior: BoolArray
    placement: BoolArray
    family: IntArray
    families: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    @staticmethod
    def of(robot: Robot, free: BoolArray | None = None) -> Unknowns:
        """Return the parameters of a robot that are chosen, (n_parameters,): its free ones if not given."""
        chosen = np.flatnonzero(robot.free if free is None else free)
        kept = [robot.parameters[k] for k in chosen]
        families = tuple(dict.fromkeys(p.family for p in kept if p.family))
        return Unknowns(
            tuple(p.name for p in kept),
            chosen,
            np.array([p.sigma for p in kept]),
            np.array([p.nominal for p in kept]),
            np.array([p.prior for p in kept], dtype=bool),
            np.array([p.placement for p in kept], dtype=bool),
            np.array([families.index(p.family) if p.family else -1 for p in kept], dtype=np.intp),
            families,
        )

    def only(self, chosen: BoolArray) -> Unknowns:
        """Return some of them, (n,)."""
        return Unknowns(
            tuple(name for name, use in zip(self.names, chosen, strict=True) if use),
            self.index[chosen],
            self.scales[chosen],
            self.nominal[chosen],
            self.has_prior[chosen],
            self.placement[chosen],
            self.family[chosen],
            self.families,
        )

    def rescaled(self, factors: FloatArray) -> Unknowns:
        """Return them with the sigma of each family multiplied by its factor, (n_families,)."""
        factor = np.append(factors, 1.0)[self.family]  # the last for -1
        return replace(self, scales=self.scales * factor)

    @staticmethod
    def chosen_by_poses(robot: Robot) -> Unknowns:
        """Return the free parameters that a choice of poses is about: families, which priors shape, are left out."""
        every = Unknowns.of(robot)
        return every.only(every.family < 0)

    def without_priors(self) -> Unknowns:
        """Return them without their priors."""
        return replace(self, has_prior=np.zeros(len(self), dtype=bool))

    def deviations(self, values: FloatArray) -> FloatArray:
        """Return u = (p - p_nominal) / s from the values of all parameters, (n_parameters,)."""
        result: FloatArray = (values[self.index] - self.nominal) / self.scales
        return result


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened rows.

    Attributes:
        residuals: (n_rows,).
        jacobian: By the scaled free parameters, (n_rows, n_free).
        has_prior: Which of these have a prior, (n_free,).
        deviations: u = (p - p_nominal) / s of these, (n_free,).
        layout: Which row is what.
    """

    residuals: FloatArray
    jacobian: FloatArray
    has_prior: BoolArray
    deviations: FloatArray
    layout: Layout

    @cached_property
    def factor(self) -> FloatArray:
        """The triangular factor of [J r], all that a linear model needs: (n_free + 1, n_free + 1) or fewer rows."""
        both = np.hstack([self.jacobian, self.residuals[:, None]])
        return both if len(both) <= both.shape[1] else np.asarray(np.linalg.qr(both, mode="r"))

    @cached_property
    def known(self) -> Information:
        """What these rows and the priors determine."""
        return information(self.factor[:, :-1], prior_rows(self.has_prior))

    @cached_property
    def alone(self) -> Information:
        """What these rows determine without priors."""
        return information(self.factor[:, :-1])

    @property
    def cost(self) -> float:
        """Sum of the squares of residuals and priors."""
        return float(self.residuals @ self.residuals + np.sum(self.deviations[self.has_prior] ** 2))

    def weighted(self, weights: FloatArray) -> Rows:
        """Return the rows with these weights of the readings, (n_readings,)."""
        root = np.sqrt(weights)[self.layout.reading]
        return Rows(root * self.residuals, root[:, None] * self.jacobian, self.has_prior, self.deviations, self.layout)

    def whitened(self, shared: SharedError) -> Rows:
        """Return the rows whitened for errors that the rows of a visit share."""
        return replace(self, residuals=shared.whiten(self.residuals), jacobian=shared.whiten(self.jacobian))

    def at_minimum(self) -> Rows:
        """Return the rows of the linear model at its minimum."""
        pull = self.jacobian.T @ self.residuals + np.where(self.has_prior, self.deviations, 0.0)
        step = -self.known.root @ (self.known.root.T @ pull)
        return replace(self, residuals=self.residuals + self.jacobian @ step, deviations=self.deviations + step)

    def distances(self) -> FloatArray:
        """Return the length of each reading's whitened residual, (n_readings,)."""
        squares = np.bincount(self.layout.reading, self.residuals**2, self.layout.n_readings)
        result: FloatArray = np.sqrt(squares)
        return result


class Whitening:
    """Whitens what a robot and its readings give; knows the noise that is stated.

    Args:
        robot: Its instruments state their noise.
        data: The readings.
        sigma: Noise of positions per axis that replaces what is stated [m].
    """

    def __init__(self, robot: Robot, data: Measurements, sigma: float | None = None) -> None:
        self._names = tuple(one.name for one in robot.instruments if len(data.readings.get(one.name, ())))
        self._inverse: dict[str, FloatArray] = {}
        groups: dict[tuple[str, str, bool], Group] = {}
        numbers: list[IntArray] = []
        widths: list[IntArray] = []
        for name in self._names:
            one, readings = robot.instrument(name), data.readings[name]
            noise = stated_noise(one, sigma)
            covariance = _covariance(one, noise, readings)
            absent = _absent(one, readings)
            number = np.array([_group(groups, one, noise, readings, covariance, part) for part in one.parts])
            numbers.append(np.where(absent, -1, number[list(one.part_of_row)]).ravel())
            widths.append(np.sum(~absent, axis=1))
            self._inverse[name] = _inverse_roots(covariance, absent)
        self.layout = _layout(robot, data, self._names, numbers, widths, tuple(groups.values()))

    @property
    def groups(self) -> tuple[Group, ...]:
        """Groups of rows whose noise has one scale."""
        return self.layout.groups

    @cached_property
    def shares_visits(self) -> bool:
        """Whether some pose has enough rows for an error that they share to show."""
        n_rows = np.bincount(self.layout.pose, self.layout.width)
        n_readings = np.bincount(self.layout.pose)
        return bool(np.any(n_readings > 1) or np.any(n_rows > 3))

    def flatten(self, arrays: Mapping[str, FloatArray]) -> FloatArray:
        """Whiten what each instrument has, (n, n_rows) or (n, n_rows, k), by the stated covariance; NaN become 0.

        Returns:
            (n_all_rows,) or (n_all_rows, k).
        """
        parts = []
        for name in self._names:
            array = np.nan_to_num(arrays[name]) if np.isnan(arrays[name]).any() else arrays[name]
            inverse = self._inverse[name]
            if inverse.ndim == 2:  # no correlations: divide
                scaled = array * (inverse if array.ndim == 2 else inverse[:, :, None])
            elif array.ndim == 2:
                scaled = np.matmul(inverse, array[:, :, None])[:, :, 0]
            else:
                scaled = np.matmul(inverse, array)
            parts.append(scaled.reshape(-1, *array.shape[2:]))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def row_scale(self, groups: FloatArray) -> FloatArray:
        """Return the scale of each row from those of the groups, 1 for rows that were not read, (n_rows,)."""
        number = self.layout.group
        return np.where(number >= 0, groups[number], 1.0)

    def rows(
        self,
        observed: Mapping[str, Observed],
        groups: FloatArray,
        unknowns: Unknowns,
        deviations: FloatArray,
    ) -> Rows:
        """Return the whitened rows.

        Args:
            observed: Of each instrument, by name.
            groups: Scale of the noise of each group, (n_groups,).
            unknowns: The parameters that count.
            deviations: u of these, (n_free,).
        """
        divisor = self.row_scale(groups)
        residuals = self.flatten({name: observed[name].residuals for name in self._names}) / divisor
        columns = self.flatten({name: observed[name].jacobian[:, :, unknowns.index] for name in self._names})
        columns *= unknowns.scales / divisor[:, None]
        return Rows(residuals, columns, unknowns.has_prior, deviations, self.layout)

    def shared_error(self, observed: Mapping[str, Observed], groups: FloatArray, tau: FloatArray) -> SharedError:
        """Return errors of the joints that all rows of a visit share, for rows whitened by these scales.

        Args:
            observed: Of each instrument, with derivatives by the joints.
            groups: Scale of the noise of each group, (n_groups,).
            tau: Standard deviation of each joint's error, (n_actuated,) [m or rad].
        """
        columns = self.joint_columns(observed) * tau / self.row_scale(groups)[:, None]
        return SharedError(columns, self.layout.pose[self.layout.reading])

    def joint_columns(self, observed: Mapping[str, Observed]) -> FloatArray:
        """Return the derivative of the rows by the joints, whitened by what is stated, (n_rows, n_actuated)."""
        return self.flatten({name: observed[name].by_joint for name in self._names})

    def start(self, residuals: Mapping[str, FloatArray] | None = None) -> FloatArray:
        """Return scales to start from: 1 where noise is stated; else as the residuals (n, n_rows) are, or assumed."""
        result = np.array([1.0 if group.stated else ASSUMED[group.dimension] for group in self.groups])
        if residuals is not None:
            flat, number = self.flatten(residuals), self.layout.group
            for g, group in enumerate(self.groups):
                if not group.stated:
                    result[g] = np.sqrt(np.mean(flat[number == g] ** 2)) + 1e-9
        return result


def stated_noise(one: Instrument, sigma: float | None) -> Noise:
    """Return the noise of an instrument, with another one for its positions if that is given [m]."""
    if sigma is None:
        return one.noise
    parts = [
        PartNoise.of(sigma, len(part.axes)) if part.name == "position" else noise
        for part, noise in zip(one.parts, one.noise.parts, strict=True)
    ]
    return Noise(tuple(parts))


def _covariance(one: Instrument, noise: Noise, readings: Readings) -> FloatArray:
    if readings.covariance is not None:
        return readings.covariance
    widths = [len(part.axes) for part in one.parts]
    return noise.covariance(one.points(readings.values), len(readings), widths)


def _absent(one: Instrument, readings: Readings) -> BoolArray:
    """Which components were not read, (n, n_rows)."""
    nothing: BoolArray = np.isnan(readings.values)
    if not nothing.any():
        return np.zeros((len(readings), one.n_rows), dtype=bool)
    if nothing.shape[1] == one.n_rows:
        return nothing
    whole: BoolArray = np.any(nothing, axis=1, keepdims=True)
    return np.broadcast_to(whole, (len(readings), one.n_rows))


def _group(
    groups: dict[tuple[str, str, bool], Group],
    one: Instrument,
    noise: Noise,
    readings: Readings,
    covariance: FloatArray,
    part: Part,
) -> int:
    """The number of the group of a part of an instrument's rows, a new one if need be."""
    index = one.parts.index(part)
    stated = readings.covariance is not None or noise.parts[index].stated
    key = (one.group, part.name, stated)
    if key not in groups:
        rows = [k for k, number in enumerate(one.part_of_row) if number == index]
        typical = float(np.sqrt(np.median(covariance[:, rows, rows]))) if len(covariance) else 1.0
        groups[key] = Group(one.group, part.name, part.dimension, stated, typical, part.usual)
    return list(groups).index(key)


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


def _layout(
    robot: Robot,
    data: Measurements,
    names: tuple[str, ...],
    numbers: list[IntArray],
    widths: list[IntArray],
    groups: tuple[Group, ...],
) -> Layout:
    counts = np.array([len(data.readings[name]) for name in names], dtype=np.intp)
    per_reading = np.array([robot.instrument(name).n_rows for name in names], dtype=np.intp)
    visit = np.concatenate([data.readings[name].visits for name in names])
    return Layout(
        names,
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate([[0], np.cumsum(counts * per_reading)]),
        np.repeat(np.arange(int(counts.sum())), np.repeat(per_reading, counts)),
        visit,
        data.pose_numbers[visit],
        np.concatenate(widths),
        np.concatenate(numbers),
        groups,
    )

"""What a calibration promises of new readings: the least-squares problem of `calib.core.judging.acceptance`.

Symbols are those of that module: r residuals, J L what is known only so well, P base and targets, Q = |e|^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError, InputError
from calib.core.base.units import Dimension
from calib.core.data.measurements import Measurements
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import numbers_by_instrument
from calib.core.fitting.problem import Problem
from calib.core.fitting.solving import place
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.numerics.identifiability import RANK_TOLERANCE, unit_columns
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed, observe
from calib.core.rows.rows import Layout
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import Whitening

POWER = 0.9
"""Chance with which a change is to be seen."""
_OUTLIERS = 0.05  # largest part of the readings that is left out
_PARALLEL = 1.0 - 1e-6  # cosine of columns that are one
_JOINT_STEP = 1e-3  # unit in which joint zeros are looked at [rad, or characteristic lengths]


@dataclass(frozen=True, eq=False)
class Promise:
    """What a calibration says of its robot.

    Attributes:
        robot: The calibrated robot.
        covariance: Of its free parameters, (n_free, n_free) [m, rad].
        freedom: Degrees of freedom that the noise was found with.
        sigma: Noise of one component by group and part of the instruments [SI].
        shared: How many times as much as independent readings those of a pose scatter together (`Scatter.ratio`).
    """

    robot: Robot
    covariance: FloatArray
    freedom: float
    sigma: Mapping[tuple[str, str], float]
    shared: float

    @staticmethod
    def of(calibrated: Fit | Promise | HasPromise) -> Promise:
        """Return what a fit or a loaded result promises.

        Raises:
            InputError: It promises nothing, such as a robot alone, or the path of a result's folder.
        """
        if isinstance(calibrated, Promise):
            return calibrated
        if isinstance(calibrated, Fit):
            sigma = {(noise.group.name, noise.group.part.name): noise.sigma for noise in calibrated.noise}
            statistics = calibrated.statistics
            shared = 1.0 if statistics.shared is None else statistics.shared.ratio
            return Promise(calibrated.robot, calibrated.covariance.values, statistics.freedom, sigma, shared)
        if isinstance(calibrated, HasPromise):
            return calibrated.promise
        raise InputError(
            f"calibrated: expected a fit, or a result as calib.load_result(folder) loads it, not"
            f" {type(calibrated).__name__}"
        )


@runtime_checkable
class HasPromise(Protocol):
    """What knows its promise by itself, such as a loaded result."""

    @property
    def promise(self) -> Promise:
        """What its calibration promises."""


@dataclass(frozen=True)
class Change:
    """A change of one parameter or of one joint's zero, looked for in the readings.

    Attributes:
        name: The parameter, or `zero of JOINT`.
        dimension: What it measures.
        value: How far it has changed [m or rad]; NaN where nothing was read.
        std: Standard deviation of that [m or rad].
        z: Their ratio.
        visible: Smallest change that is seen with the chance `POWER` [m or rad].
        p_value: Chance of one so large among all that were looked for if nothing changed; NaN where nothing was read.
    """

    name: str
    dimension: Dimension
    value: float
    std: float
    z: float
    visible: float
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether it is more than chance among all that were looked for."""
        return self.p_value < FALSE_ALARM / 2


@dataclass(frozen=True)
class Changeable:
    """What can change.

    Attributes:
        name: The parameter, or `zero of JOINT`.
        dimension: What it measures.
        index: Its place among the free parameters, or among the actuated joints.
        is_joint: Which of these.
        scale: Unit in which it is looked at [m or rad].
    """

    name: str
    dimension: Dimension
    index: int
    is_joint: bool
    scale: float


def candidates(robot: Robot) -> list[Changeable]:
    """Return what can change: parameters of the robot's origins, and zeros of its joints."""
    free = np.flatnonzero(robot.is_free)
    parameters = [
        Changeable(p.name, p.dimension, k, False, p.sigma_si)
        for k, p in enumerate(robot.parameters[i] for i in free)
        if not p.placement and not p.family and free[k] < robot.n_origin_parameters
    ]
    mechanism = robot.mechanism
    return parameters + [
        Changeable(f"zero of {name}", mechanism.dimensions[name], j, True, _JOINT_STEP * float(scale))
        for j, (name, scale) in enumerate(zip(robot.joint_names, mechanism.joint_scale, strict=True))
    ]


@dataclass(frozen=True, eq=False)
class System:
    """The least-squares problem.

    Attributes:
        promise: What is judged.
        columns: Of the known unknowns J L and of the places P, whitened, (n_rows, k) and (n_rows, p).
        candidate_columns: Columns of the candidates, (n_rows, n_candidates).
        residuals: r, (n_rows,).
        layout: Which row is what.
        counts: Which rows were read, (n_rows,).
        errors: As of `Acceptance`.
        promised, left_open: As of `Acceptance`.
    """

    promise: Promise
    columns: tuple[FloatArray, FloatArray]
    candidate_columns: FloatArray
    residuals: FloatArray
    layout: Layout
    counts: BoolArray
    errors: ErrorSet = field(repr=False)
    promised: float
    left_open: float

    @staticmethod
    def of(promise: Promise, data: Measurements, same_setup: bool) -> System:
        """Set it up.

        Raises:
            DataError: Too few readings.
        """
        robot = promise.robot if same_setup else place(Problem.of(promise.robot, data)).robot
        configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
        observed = observe(robot, configurations, data.readings, joints=True)
        whitening, unknowns = Whitening(robot, data), Unknowns.of(robot)
        scales = whitening.start({name: block.residuals for name, block in observed.items()})
        for g, group in enumerate(whitening.groups):
            if (group.name, group.part.name) in promise.sigma:
                scales[g] = max(promise.sigma[group.name, group.part.name], 1e-30) / group.typical
        rows = whitening.rows(observed, scales, unknowns, unknowns.deviations(robot.values))
        joints = whitening.joint_columns(observed) / whitening.row_scale(scales)[:, None]
        kept = np.ones(len(unknowns), dtype=bool) if same_setup else ~unknowns.placement
        covariance = promise.covariance / np.outer(unknowns.scales, unknowns.scales)
        values, vectors = linalg.eigh(covariance[np.ix_(kept, kept)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        known = np.asarray(rows.jacobian[:, kept] @ root)
        candidate_columns = _candidate_columns(robot, np.hstack([rows.jacobian, joints]), len(unknowns))
        layout = whitening.layout
        errors = {name: block.residuals for name, block in observed.items()}
        return System(
            promise,
            (known, rows.jacobian[:, ~kept]),
            candidate_columns,
            rows.residuals,
            layout,
            layout.group >= 0,
            ErrorSet(data, robot.instruments, errors, errors, robot.singular_values(configurations)),
            *_promised(promise, robot, observed, kept, root * unknowns.scales[kept, None]),
        ).checked(data)

    @property
    def reading(self) -> IntArray:
        """Reading of each row, (n_rows,)."""
        return self.layout.reading

    @property
    def visit(self) -> IntArray:
        """Visit of each reading, (n_readings,)."""
        return self.layout.visit

    def numbers_without(self, readings: Sequence[int]) -> dict[str, IntArray]:
        """Return which readings of each instrument are not among some, (n_own,)."""
        return numbers_by_instrument(np.setdiff1d(np.arange(self.layout.n_readings), readings), self.layout)

    def checked(self, data: Measurements) -> System:
        """Return it; with nothing left to judge by, raise `DataError`."""
        if self.promise.freedom < 1:
            raise DataError(
                f"{self.promise.robot.path}: its calibration left {self.promise.freedom:.2g} degrees of freedom, too"
                " few to say how accurate it is; calibrate with more poses"
            )
        if self.freedom < 1:
            raise DataError(
                f"{data.path}: {int(np.sum(self.counts))} measured coordinates are only enough to place base and"
                " targets; measure more poses"
            )
        return self

    def without(self, readings: IntArray) -> System:
        """Return it without some readings, (n,)."""
        kept = ~np.isin(self.reading, readings)
        return System(
            self.promise,
            (self.columns[0] * kept[:, None], self.columns[1] * kept[:, None]),
            self.candidate_columns * kept[:, None],
            self.residuals * kept,
            self.layout,
            self.counts & kept,
            self.errors,
            self.promised,
            self.left_open,
        )

    @cached_property
    def _basis(self) -> tuple[FloatArray, int]:
        """Orthonormal columns that span X, and the rank of what the places add."""
        known, places = self.columns
        k = known.shape[1]
        unit = unit_columns(places)[0] if places.shape[1] else places
        spanned = np.vstack([np.hstack([known, unit]), np.hstack([np.eye(k), np.zeros((k, unit.shape[1]))])])
        left, values, _ = linalg.svd(spanned / np.maximum(np.linalg.norm(spanned, axis=0), 1e-300), full_matrices=False)
        rank = int(np.sum(values > RANK_TOLERANCE * values[0])) if len(values) else 0
        return left[:, :rank], rank - k

    def _left(self, rows: FloatArray) -> FloatArray:
        """What of [rows; 0] is orthogonal to X, (n_rows + k, ...)."""
        basis, _ = self._basis
        padded = np.concatenate([rows, np.zeros((len(basis) - len(rows), *rows.shape[1:]))])
        return np.asarray(padded - basis @ (basis.T @ padded))

    @property
    def freedom(self) -> int:
        """Degrees of freedom m."""
        return int(np.sum(self.counts)) - self.placed

    @property
    def placed(self) -> int:
        """Rank of the columns of the places beside the known unknowns."""
        return self._basis[1]

    @cached_property
    def square(self) -> float:
        """Q, the sum of squares that is chi-square with `freedom`."""
        return float(np.sum(self._left(self.residuals) ** 2))

    def worst(self) -> tuple[int, float]:
        """Return the reading that lies furthest off, and the chance of that among so many."""
        basis, left = self._basis[0], self._left(self.residuals)
        best, smallest = -1, 1.0
        order = np.flatnonzero(self.counts)
        for reading in np.unique(self.reading[order]):
            rows = order[self.reading[order] == reading]
            spread = np.eye(len(rows)) - basis[rows] @ basis[rows].T
            values, vectors = linalg.eigh(spread)
            determined = values > 1e-6
            square = float(np.sum((vectors.T @ left[rows])[determined] ** 2 / values[determined]))
            n = int(np.sum(determined))
            chance = float(scipy.special.fdtrc(n, self.promise.freedom, square / n)) if n else 1.0
            if chance < smallest:
                best, smallest = int(reading), chance
        return best, min(1.0, smallest * len(np.unique(self.reading[order])))

    def changes(self) -> tuple[Change, ...]:
        """Return candidates that the readings see, those with the largest z first."""
        left, listed = self._left(self.candidate_columns), candidates(self.promise.robot)
        size, full_size = np.linalg.norm(left, axis=0), np.linalg.norm(self.candidate_columns, axis=0)
        visible = np.flatnonzero(size > 1e-6 * np.maximum(full_size, 1e-300))
        if len(visible) == 0:
            return ()
        unit = left[:, visible] / size[visible]
        distinct: list[int] = []
        for j in range(len(visible)):
            if all(abs(unit[:, j] @ unit[:, i]) < _PARALLEL for i in distinct):
                distinct.append(j)
        z, spread = unit[: len(self.residuals)].T @ self.residuals, self.promise.shared
        needed = _noncentrality(FALSE_ALARM / 2 / len(distinct), self.promise.freedom)
        changes = [
            Change(
                listed[k].name,
                listed[k].dimension,
                float(-z[j] / size[k] * listed[k].scale),  # the residual is prediction minus read
                float(spread * listed[k].scale / size[k]),
                float(-z[j] / spread),
                float(spread * needed * listed[k].scale / size[k]),
                min(1.0, len(distinct) * 2.0 * float(scipy.special.stdtr(self.promise.freedom, -abs(z[j] / spread)))),
            )
            for j, k in enumerate(visible)
        ]
        changes.sort(key=lambda change: -six_digits(abs(change.z)))  # parallel columns stay in their order
        return tuple(changes)


def _candidate_columns(robot: Robot, columns: FloatArray, n_free: int) -> FloatArray:
    """Columns of the candidates, (n_rows, n_candidates), from those of all free parameters and joints."""
    return np.stack(
        [
            c.scale * columns[:, n_free + c.index] if c.is_joint else columns[:, c.index]  # parameters are scaled
            for c in candidates(robot)
        ],
        axis=1,
    )


def six_digits(value: float) -> float:
    """So much of a number that rounding decides about no order."""
    return float(f"{value:.6g}")


def without_outliers(system: System) -> tuple[System, list[int]]:
    """Leave out readings that lie further off than noise explains, one by one, as long as they are few."""
    left_out: list[int] = []
    most = int(_OUTLIERS * len(system.visit))
    complete = system
    while len(left_out) < most:
        reading, chance = system.worst()
        if chance >= FALSE_ALARM / 2:
            return system, left_out
        left_out.append(reading)
        system = complete.without(np.array(left_out))
    if left_out and system.worst()[1] < FALSE_ALARM / 2:
        return complete, []  # so many are no outliers
    return system, left_out


def _noncentrality(level: float, freedom: float) -> float:
    """The noncentrality with which Student's t is beyond its two-sided level with the chance `POWER`."""
    limit = -float(scipy.special.stdtrit(freedom, level / 2))
    most = 2.0 * limit + 10.0  # sqrt(chi2 / m) is below 1.65 with the chance POWER for one degree of freedom or more
    return float(scipy.optimize.brentq(lambda d: 1.0 - scipy.special.nctdtr(freedom, d, limit) - POWER, 0.0, most))


def _promised(
    promise: Promise, robot: Robot, observed: Mapping[str, Observed], kept: BoolArray, root: FloatArray
) -> tuple[float, float]:
    """Root mean square distance of measured from predicted positions as promised, and what is no noise of it [m].

    Args:
        promise: Says noise and shared errors.
        robot: The robot where the readings see it.
        observed: With derivatives by parameters.
        kept: Which of the free parameters are not placed anew, (n_free,).
        root: A root of their covariance, (n_kept, k) [m or rad].
    """
    free, slopes, square, n = np.flatnonzero(robot.is_free), [], 0.0, 0
    for name, derivatives in observed.items():
        instrument = robot.instrument(name)
        for index, part in enumerate(instrument.parts):
            if not part.is_position:
                continue
            rows = [r for r, k in enumerate(instrument.part_of_row) if k == index]
            n_readings = len(derivatives.residuals)
            n += n_readings
            slopes.append(derivatives.by(free)[:, rows].reshape(-1, len(free)))
            square += len(rows) * n_readings * promise.sigma.get((instrument.group, part.name), np.nan) ** 2
    if not n:
        return float("nan"), float("nan")
    slope = np.concatenate(slopes)
    placed = linalg.svd(unit_columns(slope[:, ~kept])[0], full_matrices=False)
    basis = placed[0][:, placed[1] > RANK_TOLERANCE]
    spread = slope[:, kept] @ root
    spread -= basis @ (basis.T @ spread)
    square *= 1.0 - basis.shape[1] / len(slope)  # what placing them takes up
    left_open = float(np.sum(spread**2))
    return float(np.sqrt((square + left_open) / n)), float(np.sqrt(left_open / n))

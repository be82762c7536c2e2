"""The least-squares problem of `calib.core.judging.acceptance`: what new readings say of a promise.

Symbols are those of that module: r residuals, J L the uncertain parameters, P base and targets, Q = |e|^2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.units import Dimension
from calib.core.data.in_memory import PosesLike
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import are_drawn_alike
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.problem import Problem
from calib.core.fitting.solving import place
from calib.core.judging.promise import Promise
from calib.core.numerics import linalg
from calib.core.numerics.chances import FALSE_ALARM, UNLIKELY
from calib.core.numerics.identifiability import RANK_TOLERANCE, unit_columns
from calib.core.numerics.losses import studentised
from calib.core.numerics.mixed_rows import whiten_scatter
from calib.core.numerics.prior import Prior
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed, observe
from calib.core.rows.rows import Rows
from calib.core.rows.simulate import simulate
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import Whitening

POWER = 0.9
"""Chance with which a change shall be seen."""
LEVEL = FALSE_ALARM / 2
"""Level of each of two tests."""
_OUTLIERS = 0.05  # largest part of the readings that is left out
_PARALLEL = 1.0 - 1e-6  # columns with a larger cosine count as equal
_SCALE_ALONE = 1e4  # t limit beyond which the normal part of Student's t is below 1e-8 of the noncentrality
_LARGEST = 0.2  # a change that shows only above this size is beyond the linear model [m or rad]
_JOINT_STEP = 1e-3  # unit of changes of joint zeros [rad, or characteristic lengths]


@dataclass(frozen=True)
class Change:
    """A change of one parameter or of one joint's zero, tested with the readings.

    Attributes:
        name: The parameter, or `zero of JOINT`.
        value: Its change [m or rad]; NaN where nothing was read.
        std: Standard deviation of `value` [m or rad].
        z: Ratio of `value` to `std`.
        visible: Smallest change that is seen with the chance `POWER` [m or rad].
        p_value: Chance of so large a change among all tests if nothing changed; NaN where nothing was read.
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
        """Whether the change is significant among all changes that were tested."""
        return self.p_value < LEVEL


@dataclass(frozen=True)
class PossibleChanges:
    """A change of a robot that new readings can show, in units of `scale` [m or rad].

    `index` counts actuated joints, then free parameters; the name is that of the parameter, or `zero of JOINT`.
    """

    name: str
    dimension: Dimension
    index: int
    scale: float


def candidates(robot: Robot) -> list[PossibleChanges]:
    """Return the possible changes: zeros of the robot's joints, and parameters of its origins.

    A zero comes first: a parameter that does the same is named after it.
    """
    free = np.flatnonzero(robot.is_free)
    parameters = [
        PossibleChanges(p.name, p.dimension, len(robot.joint_names) + k, p.sigma_si)
        for k, p in enumerate(robot.parameters[i] for i in free)
        if not p.placement and not p.family and free[k] < robot.n_origin_parameters
    ]
    mechanism = robot.mechanism
    zeros = [
        PossibleChanges(f"zero of {name}", mechanism.dimensions[name], j, _JOINT_STEP * float(scale))
        for j, (name, scale) in enumerate(zip(robot.joint_names, mechanism.joint_scale, strict=True))
    ]
    return zeros + parameters


@dataclass(frozen=True)
class ExpectedDistances:
    """Expected distances between measured and predicted positions after a calibration.

    Attributes:
        rms: Root mean square [m]; NaN without positions.
        calibration_rms: Part of `rms` from the uncertainty of the calibration, without noise of the readings [m].
        freedom: Degrees of freedom of `rms`: few where few uncertain directions of the calibration decide it.
    """

    rms: float
    calibration_rms: float
    freedom: float

    def limit(self, noise_freedom: float) -> float:
        """Return the root mean square that chance exceeds with `UNLIKELY` [m], with the noise's degrees of freedom."""
        return self.rms * float(np.sqrt(scipy.special.fdtri(self.freedom, noise_freedom, 1.0 - UNLIKELY)))


@dataclass(frozen=True, eq=False)
class System:
    """The least-squares problem, and its tests.

    Attributes:
        rows: The linear model: r by the uncertain parameters J L, which have a prior, and by the places P, of length 1.
        candidate_columns: Columns of the candidates, (n_rows, n_candidates).
        errors: Errors of the readings after placing base and targets, without outliers.
        expected: Expectation of the distances between measured and predicted positions.
        same_setup: Whether base and targets are where the calibration found them.
    """

    promise: Promise
    rows: Rows
    candidate_columns: FloatArray
    errors: ErrorSet = field(repr=False)
    expected: ExpectedDistances
    same_setup: bool

    @staticmethod
    def from_promise(promise: Promise, data: Measurements, same_setup: bool) -> System:
        """Set up the problem, or raise `DataError` if there are too few readings."""
        robot = promise.robot if same_setup else place(Problem.from_data(promise.robot, data)).robot
        known, whole = promise.uncertainty, promise.uncertainty.with_undecided_terms(robot)
        configurations = whole.assemble(data.joints, labels=data.labels, context=data.conditions)
        observed = observe(whole, configurations, data.readings, joints=True)
        errors = {name: block.residuals for name, block in observed.items()}
        whitening, unknowns = Whitening(robot, data), Unknowns.from_robot(whole)
        scales = whitening.start(errors)
        for g, group in enumerate(whitening.groups):
            if (group.name, group.part.name) in promise.sigma:
                scales[g] = max(promise.sigma[group.name, group.part.name], 1e-30) / group.typical
        rows = whitening.rows(observed, scales, unknowns, whole.values)
        joints = whitening.joint_columns(observed, scales)
        levers = known.joint_error * robot.mechanism.joint_scale * joints
        residuals, jacobian, joints = whiten_scatter(
            levers, rows.layout.pose_of_row, rows.residuals, rows.jacobian, joints
        )
        placed = np.zeros(len(unknowns), dtype=bool) if same_setup else unknowns.placement
        place_of = {name: k for k, name in enumerate(unknowns.names)}
        index = np.array([place_of[name] for name in known.lasting_names(robot)], dtype=np.intp)
        stays = np.flatnonzero(~placed[index])
        index, covariance = index[stays], known.covariance_of(robot)[np.ix_(stays, stays)]
        values, vectors = linalg.eigh(covariance / np.outer(unknowns.scales[index], unknowns.scales[index]))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        columns = np.hstack([jacobian[:, index] @ root, unit_columns(jacobian[:, placed])[0]])
        prior = Prior(np.arange(columns.shape[1]) < root.shape[1])
        by_all = np.hstack([_JOINT_STEP * robot.mechanism.joint_scale * joints, jacobian])
        error_set = ErrorSet(data, robot.instruments, errors, errors, robot.singular_values(configurations))
        spread = root * unknowns.scales[index, None]
        system = System(
            promise,
            replace(rows, residuals=residuals, jacobian=columns, prior=prior, deviations=np.zeros(columns.shape[1])),
            by_all[:, [candidate.index for candidate in candidates(robot)]],
            error_set,
            _expected_distances(promise, whole, error_set, observed, index, placed, spread),
            same_setup,
        )
        if promise.freedom < 1:
            raise DataError(
                f"{promise.robot.path}: its calibration left {promise.freedom:.2g} degrees of freedom, too few to say"
                " how accurate it is; calibrate with more poses"
            )
        if system.freedom < 1:
            raise DataError(
                f"{data.path}: {system.n_rows} measured values are only enough to place base and targets; measure more"
                " poses"
            )
        return system

    @staticmethod
    def planned(promise: Promise, poses: PosesLike, same_setup: bool) -> System:
        """Return the problem of readings at these poses, which have not been made."""
        data = simulate(promise.robot, poses, 0.0, np.random.default_rng(0))  # no noise is drawn
        return System.from_promise(promise, data, same_setup)

    def with_common_error(self) -> System:
        """Return the system where unexplained errors may be common to all readings."""
        return System.from_promise(self.promise.with_common_error(self.n_rows), self.errors.data, self.same_setup)

    def without_readings(self, readings: IntArray) -> System:
        """Return the system without some readings, (n,)."""
        weights = 1.0 * ~np.isin(np.arange(self.rows.layout.n_readings), readings)
        of_rows = weights[self.rows.layout.reading]
        layout = replace(self.rows.layout, group=np.where(of_rows > 0, self.rows.layout.group, -1))
        rows = replace(self.rows.with_weights(weights), layout=layout)
        return replace(self, rows=rows, candidate_columns=self.candidate_columns * of_rows[:, None])

    def _orthogonal_part(self, rows: FloatArray) -> FloatArray:
        """The part of [rows; 0] that is orthogonal to X, (n_rows + k, ...)."""
        root, jacobian = self.rows.posterior_information.root, self.rows.jacobian
        step = root @ (root.T @ (jacobian.T @ rows))
        return np.concatenate([rows - jacobian @ step, -self.rows.prior.times(step)])

    @property
    def n_rows(self) -> int:
        """Number of rows that count."""
        return int(np.sum(self.rows.layout.group >= 0))

    @property
    def freedom(self) -> int:
        """Degrees of freedom m."""
        return self.n_rows - self.placement_rank

    @property
    def placement_rank(self) -> int:
        """Rank of the columns of the places, in addition to the uncertain parameters."""
        return self.rows.posterior_information.root.shape[1] - int(np.sum(self.rows.prior.has))

    @cached_property
    def square(self) -> float:
        """Q, the sum of squares that is chi-square with `freedom`."""
        return float(np.sum(self._orthogonal_part(self.rows.residuals) ** 2))

    def worst(self) -> tuple[int, float]:
        """Return the reading that is furthest off, and the chance of such an error among all."""
        layout, left = self.rows.layout, self._orthogonal_part(self.rows.residuals)[: len(self.rows.residuals)]
        widths, used = np.maximum(layout.width, 1), np.ones(layout.n_readings)
        # the scale has the degrees of freedom of the promise; `studentised` halves the ones that it is given
        tests = studentised(left, self.rows.span, layout.reading, widths, used, 2.0 * self.promise.freedom, 1.0)
        reading = int(np.argmin(tests.chance))
        n_read = len(np.unique(layout.reading[layout.group >= 0]))
        return reading, min(1.0, float(tests.chance[reading]) * n_read)

    @cached_property
    def has_unlike_poses(self) -> bool:
        """Whether the poses are distributed otherwise than the used ones."""
        return len(self.promise.joints) > 0 and not are_drawn_alike(self.errors.data.joints, self.promise.joints)

    @property
    def independent(self) -> float:
        """Degrees of freedom of the ratio, reduced where readings share errors."""
        return self.freedom / self.promise.shared**2

    @property
    def p_value(self) -> float:
        """Chance of so large a sum of squares, if the robot is as calibrated."""
        return float(scipy.special.fdtrc(self.independent, self.promise.freedom, self.square / self.freedom))

    @property
    def p_drift(self) -> float:
        """Chance that the largest change is this large, if the robot is as calibrated."""
        return self.changes[0].p_value if self.changes else 1.0

    @property
    def p_rest(self) -> float:
        """Chance of so large residuals after that change."""
        if not self.changes:
            return 1.0
        rest = max(self.square - (self.promise.shared * self.changes[0].z) ** 2, 0.0) / max(self.freedom - 1, 1)
        return float(scipy.special.fdtrc(max(self.independent - 1, 1), self.promise.freedom, rest))

    @property
    def has_larger_errors(self) -> bool:
        """Whether errors are larger than chance explains; if not, they may still have the pattern of a change."""
        lengths = self.errors.errors("after", single=True)
        square = np.mean(np.nansum(lengths**2, axis=1)) if len(lengths) else np.nan  # NaN is no larger
        return self.p_value < LEVEL or bool(np.sqrt(square) > self.expected.limit(self.promise.freedom))

    @property
    def agrees(self) -> bool:
        """Whether chance explains the readings."""
        return not self.has_larger_errors and self.p_drift >= LEVEL

    @cached_property
    def changes(self) -> tuple[Change, ...]:
        """Visible candidates, the largest z first."""
        left, listed = self._orthogonal_part(self.candidate_columns), candidates(self.promise.robot)
        size, full_size = np.linalg.norm(left, axis=0), np.linalg.norm(self.candidate_columns, axis=0)
        weakest = self.promise.shared * _noncentrality(LEVEL, self.promise.freedom) / _LARGEST
        seen = size > weakest * np.array([candidate.scale for candidate in listed])
        visible = np.flatnonzero(seen & (size > 1e-6 * np.maximum(full_size, 1e-300)))
        if len(visible) == 0:
            return ()
        unit = left[:, visible] / size[visible]
        distinct: list[int] = []
        for j in range(len(visible)):
            if all(abs(unit[:, j] @ unit[:, i]) < _PARALLEL for i in distinct):
                distinct.append(j)
        z, spread = unit[: len(self.rows.residuals)].T @ self.rows.residuals, self.promise.shared
        needed = _noncentrality(LEVEL / len(distinct), self.promise.freedom)
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
        changes.sort(key=lambda change: -round(abs(change.z), 1))  # to a tenth: nearer ones in the listed order
        return tuple(changes)


def without_outliers(system: System) -> tuple[System, list[int]]:
    """Leave out readings further off than noise explains, one by one, as long as they are few."""
    left_out: list[int] = []
    complete, most = system, int(_OUTLIERS * system.rows.layout.n_readings)
    while True:
        reading, chance = system.worst()
        if chance >= LEVEL:
            return system, left_out
        if len(left_out) == most:
            return complete, []  # so many are no outliers
        left_out.append(reading)
        system = complete.without_readings(np.array(left_out))


def _noncentrality(level: float, freedom: float) -> float:
    """Noncentrality at which Student's t exceeds its two-sided level with the chance `POWER`."""
    limit = -float(scipy.special.stdtrit(freedom, level / 2))
    if limit > _SCALE_ALONE:
        return limit * float(np.sqrt(scipy.special.chdtri(freedom, 1.0 - POWER) / freedom))
    most = 2.0 * limit + 10.0  # sqrt(chi2 / m) is below 1.65 with the chance POWER for one degree of freedom or more
    return float(scipy.optimize.brentq(lambda d: 1.0 - scipy.special.nctdtr(freedom, d, limit) - POWER, 0.0, most))


def _expected_distances(
    promise: Promise,
    robot: Robot,
    errors: ErrorSet,
    observed: Mapping[str, Observed],
    uncertain: IntArray,
    placed: BoolArray,
    root: FloatArray,
) -> ExpectedDistances:
    """Return the expectation of the distances between measured and predicted positions.

    Of the free parameters, some are `uncertain` (n,), with `root` of their covariance (n, k) [m or rad], and others are
    `placed` anew, (n_free,).
    """
    free, slopes, square, by_joints, n = np.flatnonzero(robot.is_free), [], 0.0, 0.0, 0
    scatter = promise.uncertainty.joint_error * robot.mechanism.joint_scale
    for instrument, part, rows in errors.parts():
        if part.is_position:
            derivatives = observed[instrument.name]
            n_readings = len(derivatives.residuals)
            n += n_readings
            slopes.append(derivatives.derivative_by(free)[:, rows].reshape(-1, len(free)))
            square += len(rows) * n_readings * promise.sigma.get((instrument.group, part.name), np.nan) ** 2
            by_joints += float(np.sum((derivatives.joint_derivative[:, rows] * scatter) ** 2))
    if not n:
        return ExpectedDistances(float("nan"), float("nan"), float("nan"))
    slope = np.concatenate(slopes)
    basis = linalg.orth(unit_columns(slope[:, placed])[0], RANK_TOLERANCE)
    spread = slope[:, uncertain] @ root
    spread -= basis @ (basis.T @ spread)
    left = len(slope) - basis.shape[1]
    by_joints, square = (left / len(slope) * part for part in (by_joints, square + by_joints))  # less what places take
    along = spread.T @ spread
    left_open, total = float(np.trace(along)), square + float(np.trace(along))
    # variances of squares: of noise in `left` directions, of what is left open, and of both in one direction
    variance = square * (promise.shared**2 * square + 2.0 * left_open) / max(left, 1) + float(np.sum(along**2))
    expected, by_calibration = np.sqrt(np.array([total, left_open + by_joints]) / n).tolist()
    return ExpectedDistances(expected, by_calibration, total**2 / max(variance, 1e-300))

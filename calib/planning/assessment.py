"""Parameters that a set of poses determines, and their uncertainty: the content of `calib check`.

For one robot and one set of poses: rank and gap of all parameters and of the free ones, groups that move together
unseen, parameters to hold, observability, and, with priors and noise, the predicted standard deviation of every
parameter, their correlations, and the predicted position error. Families of joint terms (curves), whose priors are
estimated from data, are left out.

How many poses are needed? The accuracy for each number m of poses is predicted from the information of the given poses:
for m of them spread uniformly over their order; for the best m of them (exchange for the task index); and, beyond their
number n, for all of them measured m / n times on average. Only measurement noise counts: more poses do not reduce
errors of the model, which the residuals of a fit show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.errors import DataError, NotIdentifiableError
from calib.core.base.parameter import Parameter
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import quantity_text, sigma_in_si
from calib.core.base.words import count_noun, data_frame, html_with_title, listing
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurement_columns import rank_in_visit
from calib.core.data.measurements import Measurements, Poses
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import Elimination, Rank, eliminate, reduce_rows
from calib.core.numerics.observability import Information, information
from calib.core.robots.configurations import Configurations
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.rows.determination import Determination, determination
from calib.core.rows.observed import observe, planned_readings
from calib.core.rows.prediction import without_common_motion
from calib.core.rows.unknowns import Unknowns
from calib.planning.exchange import Spacing, exchange, uniform_start
from calib.planning.pose_sampling import sample
from calib.planning.predicted_error import TaskIndex, task_index
from calib.planning.selection_problem import TASK, build_problem, observability_of
from calib.shared.candidates import (
    WHITENED,
    assumed_sigma,
    positions_at,
    require_free,
    require_poses,
    rows_as_stated,
    rows_of_poses,
)
from calib.shared.null_space import UnseenGroup, null_groups

_SAMPLED = 100
"""Number of sampled poses if none are given."""
CORRELATION_LIMIT = 0.95
"""Larger correlations are reported: one value can replace the other."""
HARDLY = 0.5
"""A parameter is hardly improved if its standard deviation is more than this part of the prior sigma."""
_DIGITS = 9  # digits of a remainder; the rest is rounding
_COUNTS = 8  # numbers of poses up to all of them
_MOST_CHOSEN, _MOST_CANDIDATES = 400, 2000  # above these, the search for the best poses would take long
_BEYOND = (2, 4)  # multiples of the number of poses
_GROUPS = 3  # number of named groups in the printed object
_NOTHING_NEW = 1e-3  # a direction below this part of a pose's strongest one is rounding of similar repeats


@dataclass(frozen=True, eq=False, repr=False)
class Assessment(ReadOnlyArrays):
    """Parameters that a set of poses determines.

    Attributes:
        parameters: All parameters.
        free: Mask of the free parameters, (n_parameters,).
        n_poses, n_rows: Numbers of poses and of measured coordinates.
        sigma: Noise of one reading per axis [m].
        sigma_assumed: Whether the noise is an assumption.
        determination: Ranks of all and of the free parameters, from the poses alone and with priors.
        posterior_information: Uncertainty of the free parameters from poses and priors; in units of
            `determination.lengths`.
        groups: Groups of parameters whose common change no pose shows, of all parameters, from the poses alone.
        undetermined_groups: The same of the free parameters with priors.
        elimination: Parameters to hold so that the poses determine the rest.
        scaled: O1 to O5 of the free parameters, on columns scaled by sigma [m]; if no lengths are measured, in units of
            the noise of a reading.
        raw: The same on unscaled columns, in mm (or noise) per unit of the table.
        std: Predicted standard deviation of each free parameter, infinite where undetermined, (n_free,) [m, rad].
        accuracy: Predicted position error at the task poses.
        position_errors: The same at each of them, of the targets in `RobotData.reported_targets`, (n_task, n_located)
            [m].
        rms_without_common: Root mean square of the predicted position error [m], without the part that moves all
            positions as one body, such as an error of the base.
        by_count: Predicted accuracy against number of poses.
        near_singular: Poses closer to a singularity of the loops than the description's limit.
        left_out: Targets that do not count in the accuracy (`RobotData.unreported_targets`).
    """

    parameters: tuple[Parameter, ...]
    free: BoolArray
    n_poses: int
    n_rows: int
    sigma: float
    sigma_assumed: bool
    determination: Determination
    posterior_information: Information
    groups: tuple[UnseenGroup, ...]
    undetermined_groups: tuple[UnseenGroup, ...]
    elimination: Elimination
    scaled: dict[str, float]
    raw: dict[str, float]
    std: FloatArray
    accuracy: TaskIndex
    position_errors: FloatArray
    rms_without_common: float
    by_count: tuple[CountRow, ...]
    near_singular: tuple[str, ...]
    left_out: tuple[str, ...]

    def __repr__(self) -> str:
        error = f"predicted error {quantity_text(self.accuracy.rms, 'mm')} RMS"
        return (
            f"<Assessment of {self.n_poses} poses: {self.determination.free.rank} of {int(np.sum(self.free))} free"
            f" parameters determined, {error if self.accuracy.maximum else 'none of which moves a position'}>"
        )

    def __str__(self) -> str:
        left = int(np.sum(self.free)) - self.rank_free.rank
        by_priors = f"priors hold the other {left}" if left else "no prior is needed"
        held = (
            f"{count_noun(len(self.undetermined_groups), 'group')} not determined"
            if self.undetermined_groups
            else by_priors
        )
        following = (
            "hold parameters (`robot.fix`) or add poses"
            if self.undetermined_groups
            else "calib.select(robot, candidates, count=40), or calib.fit(robot, data) of measurements at these poses"
        )
        unseen = [", ".join(self.parameters[k].name for k in group.members) for group in self.groups]
        together = f"These can change together without effect: {listing(unseen, '; ', _GROUPS)}\n" if unseen else ""
        return (
            f"{repr(self)[1:-1]}; {held}\n{together}"
            "Inside: to_dataframe(), the predicted standard deviation of each parameter; by_count, the error for fewer"
            " and more poses; scaled, O1 to O5; groups, what moves together unseen\n"
            f"Next: {following}"
        )

    def _repr_html_(self) -> str:
        return html_with_title("Assessment", (repr(self)[1:-1], *self.determination.lines()), self.rows())

    def rows(self) -> list[dict[str, object]]:
        """Return one row for each free parameter with its predicted standard deviation, in the units of tables."""
        kept = zip(self.free_parameters, self.std, strict=True)
        return [{"name": p.name, "unit": p.unit, "sigma": p.sigma, "std": float(std) * p.per_si} for p, std in kept]

    def to_dataframe(self) -> Any:
        """Return `rows` as a pandas table; `InputError` without pandas."""
        return data_frame(self.rows())

    @property
    def rank_all(self) -> Rank:
        """Rank of all parameters, from the poses alone."""
        return self.determination.everything

    @property
    def rank_free(self) -> Rank:
        """Rank of the free parameters, from the poses alone."""
        return self.determination.free

    @property
    def free_parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of `std`."""
        return tuple(p for p, use in zip(self.parameters, self.free, strict=True) if use)

    def correlated_pairs(self, limit: float = CORRELATION_LIMIT) -> list[tuple[str, str, float]]:
        """Return pairs of free parameters whose correlation exceeds `limit` in size, largest first."""
        matrix = self.posterior_information.correlations()
        names = [parameter.name for parameter in self.free_parameters]
        rows, columns = np.triu_indices(len(names), k=1)
        with np.errstate(invalid="ignore"):
            above = np.flatnonzero(np.abs(matrix[rows, columns]) > limit)
        pairs = [(names[rows[k]], names[columns[k]], float(matrix[rows[k], columns[k]])) for k in above]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def hardly_known(self) -> list[tuple[str, float]]:
        """Return free parameters with more than `HARDLY` of their expected error left, and that part, largest first."""
        named = [(p.name, float(r)) for p, r in zip(self.free_parameters, self.part_left, strict=True) if r > HARDLY]
        return sorted(named, key=lambda item: -round(item[1], _DIGITS))

    @property
    def part_left(self) -> FloatArray:
        """Standard deviation over expected error of each free parameter, (n_free,); NaN for places without a prior."""
        parts = self.std / np.array([p.sigma_si for p in self.free_parameters])
        anywhere = np.array([p.placement and not p.prior for p in self.free_parameters], dtype=bool)
        return np.where(anywhere & np.isfinite(parts), np.nan, parts)


@one_blas_thread
def check(
    robot: RobotLike, poses: PosesLike | None = None, *, task: PosesLike | None = None, sigma: float | str | None = None
) -> Assessment:
    """Return the parameters that poses determine, at the robot's present values.

    Args:
        poses: Poses that are or would be measured, or joint values (n, n_actuated) [m or rad]; default: a hundred,
            spread over the joint limits. Of measurements, only joint values and numbers of readings are used.
        task: Poses whose accuracy counts, in the same form; default: `poses`.
        sigma: Noise of one position reading per axis [m], or text such as `0.04 mm`; default: the description's.

    Raises:
        InputError: `robot` is not a robot.
        DataError: No poses, or fewer measured coordinates than free parameters without a prior.
        UnreachablePoseError: A pose cannot be assembled.
    """
    robot, sigma = as_robot(robot), sigma_in_si(sigma)
    require_free(robot)
    poses = sample(robot, _SAMPLED) if poses is None else as_poses(robot, poses)
    require_poses(poses)
    task = None if task is None else as_poses(robot, task)
    outside_families = np.array([not p.family for p in robot.parameters])
    parameters, free = tuple(p for p in robot.parameters if not p.family), robot.is_free[outside_families]
    noise, assumed = assumed_sigma(robot, sigma)
    configurations = robot.assemble(poses.joints, labels=poses.labels, context=poses.conditions)
    everything = Unknowns.from_robot(robot, outside_families)
    columns, rows, width = _columns(robot, poses, configurations, sigma, everything)
    _require_rows(robot, poses, width)
    determined = determination(reduce_rows(columns / everything.scales), parameters, free)
    unknowns = Unknowns.chosen_by_poses(robot)
    lengths = determined.lengths * everything.scales  # of columns scaled by sigma: divisors of rows and priors
    priors = unknowns.prior.rows / lengths[free]
    unit = columns[:, free] / lengths[free]
    known = information(unit, priors)
    order = robot.parameters.places(robot.description.elimination_order)
    elimination, held = eliminate(determined.columns, order), tuple(map(int, np.flatnonzero(~free)))
    where = configurations
    if task is not None:
        where = robot.assemble(task.joints, labels=task.labels, context=task.conditions)
    positions, task_rows = positions_at(robot, where)
    task_rows = task_rows / lengths[free]
    errors = known.position_errors(task_rows)
    without_common = known.position_errors(without_common_motion(positions[:, robot.reported_targets], task_rows))
    kept = [p for p, use in zip(parameters, free, strict=True) if use]
    scaled, raw = observability_of(noise * columns[:, free], kept, poses.n_poses, lengths=noise != WHITENED)
    near = np.flatnonzero(robot.singular_values(configurations) < robot.description.singularity_limit)
    return Assessment(
        parameters=parameters,
        free=free,
        n_poses=poses.n_poses,
        n_rows=len(columns),
        sigma=noise,
        sigma_assumed=assumed,
        determination=determined,
        posterior_information=known,
        groups=null_groups(determined.columns, held or elimination.dropped, lengths),
        undetermined_groups=null_groups(determined.free_columns, lengths=lengths[free]),
        elimination=elimination,
        scaled=scaled,
        raw=raw,
        std=known.standard_deviations() / determined.lengths[free],
        accuracy=task_index(errors),
        position_errors=errors,
        rms_without_common=float(np.sqrt(np.mean(without_common**2))),
        by_count=accuracy_by_count(rows[..., free] / lengths[free], priors, task_rows),
        near_singular=tuple(poses.labels[k] for k in near),
        left_out=tuple(robot.unreported_targets),
    )


def _columns(
    robot: Robot, poses: Poses, configurations: Configurations, sigma: float | None, everything: Unknowns
) -> tuple[FloatArray, FloatArray, int]:
    """Whitened rows of all readings, those of each pose, and the number of rows of a visit."""
    if not isinstance(poses, Measurements):
        pose_rows = rows_of_poses(robot, configurations, sigma, everything, planned_readings(robot, poses))
        flat = pose_rows.rows[pose_rows.read]
        return flat, pose_rows.rows, -(-len(flat) // len(poses))
    whitened = rows_as_stated(robot, poses, observe(robot, configurations, poses.readings), everything, sigma)
    layout = whitened.layout
    flat = whitened.jacobian[layout.group >= 0]
    pose = layout.pose[layout.reading]  # rows pose by pose, padded with zeros
    _, block, counts = np.unique(pose, return_inverse=True, return_counts=True)
    packed = np.zeros((len(counts), int(counts.max()), whitened.jacobian.shape[1]))
    packed[block, rank_in_visit(pose)] = whitened.jacobian
    return flat, packed, -(-len(flat) // len(poses))


def _require_rows(robot: Robot, poses: Poses, per_pose: int) -> None:
    """Raise `DataError` if there are fewer rows than free parameters without a prior."""
    needed = sum(use and not p.prior for p, use in zip(robot.parameters, robot.is_free, strict=True))
    if per_pose * len(poses) < needed:
        raise DataError(
            f"{poses.path}: {len(poses)} poses give {per_pose * len(poses)} measured values for {needed} free"
            f" parameters without a prior; give at least {-(-needed // per_pose)} poses (several times that for a"
            " useful result)"
        )


@dataclass(frozen=True)
class CountRow:
    """Predicted accuracy with one number of poses.

    Attributes:
        count: Number of poses.
        uniform: Accuracy with so many of the given poses, spread uniformly; None beyond their number.
        chosen: Accuracy with the best of the given poses; beyond their number, with all measured several times. None if
            the search would take long.
    """

    count: int
    uniform: TaskIndex | None
    chosen: TaskIndex | None


def accuracy_by_count(rows: FloatArray, priors: FloatArray, task_rows: FloatArray) -> tuple[CountRow, ...]:
    """Predict the accuracy for several numbers of poses.

    Args:
        rows: Whitened rows of each pose, (n_poses, n_rows_per_pose, n_parameters).
        priors: Prior rows, (n_priors, n_parameters).
        task_rows: Scaled derivative of positions at the poses whose accuracy counts, (n_task, 3 n_targets,
            n_parameters) [m].

    Returns:
        A row for each number that determines as much as all poses do.
    """
    n = len(rows)
    candidates = uniform_start(np.arange(n), min(n, _MOST_CANDIDATES))
    problem = build_problem(rows[candidates], None, priors, 0, task_rows)
    if problem.pose_information.rank.rank == 0:  # no number of poses determines anything
        return ()
    rank_left = problem.pose_information.rank.rank - int(linalg.matrix_rank(problem.before, hermitian=True))
    strengths = linalg.singular_values(rows[candidates])
    of_a_pose = max(1, int(np.max(np.sum(strengths > _NOTHING_NEW * strengths[:, :1], axis=1))))  # directions, at most
    least = max(1, -(-rank_left // of_a_pose))
    counts = np.unique(np.round(np.geomspace(min(least + 1, n), n, _COUNTS))).astype(int).tolist()
    space = Spacing.free(np.ones(len(candidates), dtype=bool))
    table = []
    for count in counts:
        uniform = _accuracy(rows[uniform_start(np.arange(n), count)], priors, task_rows)
        chosen = uniform if count == n else None
        if count < n and count <= _MOST_CHOSEN:
            start = uniform_start(np.arange(len(candidates)), count)
            try:
                best = candidates[exchange(problem, TASK, start, space).chosen]
            except NotIdentifiableError:  # too few to determine as much as all poses do
                continue
            chosen = _accuracy(rows[best], priors, task_rows)
        table.append(CountRow(count, uniform, chosen))
    several = [CountRow(times * n, None, _accuracy(np.sqrt(times) * rows, priors, task_rows)) for times in _BEYOND]
    return (*table, *several)


def _accuracy(rows: FloatArray, priors: FloatArray, task_rows: FloatArray) -> TaskIndex:
    return task_index(information(rows, priors).position_errors(task_rows))

"""What a set of poses determines, and how well: everything that `calib check` tells.

Matrices from the floors below are put together for one robot and one set of poses: rank and gap of all parameters and
of the free ones, groups that move together unseen, which parameters to hold, observability, and, with priors and
noise, the predicted standard deviation of every parameter, their correlations, and the predicted position error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.data.measurements import Measurements, Poses
from calib.errors import DataError
from calib.linearisation.candidates import assemble_known
from calib.linearisation.determination import Determination, determination
from calib.linearisation.information import Information, information, measurement_sigma, prior_rows, require_free
from calib.linearisation.jacobian import linearise
from calib.model.mechanism import BoolArray, FloatArray
from calib.model.parameters import Parameter, index_of
from calib.model.robot import Robot
from calib.numerics.elimination import Elimination, eliminate
from calib.numerics.identifiability import Rank
from calib.numerics.null_space import Group, null_groups
from calib.numerics.observability import TaskIndex, observability_of, task_index
from calib.pose_choice.pose_count import CountRow, accuracy_by_count
from calib.read_only import ReadOnlyArrays
from calib.threads import one_blas_thread

CORRELATION_LIMIT = 0.95
"""Correlations above this are reported: the two values trade against each other."""
HARDLY = 0.5
"""A parameter whose standard deviation stays above this part of its prior sigma is hardly better known than before."""


@dataclass(frozen=True, eq=False)
class Assessment(ReadOnlyArrays):
    """What a set of poses determines.

    Attributes:
        parameters: All parameters.
        free: Which are not held, (n_parameters,).
        n_poses, n_rows: Poses, and measured coordinates.
        sigma: Noise of one reading per axis that was used [m].
        sigma_assumed: Whether nobody stated it.
        determination: Ranks of all and of the free parameters, from the poses alone and with priors.
        known: How well poses and priors determine the free ones; in units of `determination.lengths`.
        groups: Parameters that move together unseen, of all parameters, from the poses alone.
        open_groups: The same of the free ones, priors included: what stays undetermined.
        elimination: Parameters to hold so that the poses determine the rest.
        scaled, raw: O1 to O5 of the free parameters, on columns scaled by sigma [m], and in mm per unit of table.
        std: Predicted standard deviation of each free parameter, infinite where undetermined, (n_free,) [m, rad].
        accuracy: Predicted position error at the task poses.
        position_errors: The same at each of them, (n_task, n_targets) [m].
        by_count: Predicted accuracy against number of poses.
        near_singular: Poses closer to a singularity of the loops than the description's limit.
    """

    parameters: tuple[Parameter, ...]
    free: BoolArray
    n_poses: int
    n_rows: int
    sigma: float
    sigma_assumed: bool
    determination: Determination
    known: Information
    groups: tuple[Group, ...]
    open_groups: tuple[Group, ...]
    elimination: Elimination
    scaled: dict[str, float]
    raw: dict[str, float]
    std: FloatArray
    accuracy: TaskIndex
    position_errors: FloatArray
    by_count: tuple[CountRow, ...]
    near_singular: tuple[str, ...]

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

    def correlated(self, limit: float = CORRELATION_LIMIT) -> list[tuple[str, str, float]]:
        """Return pairs of free parameters whose correlation exceeds `limit` in size, largest first."""
        matrix = self.known.correlations()
        names = [parameter.name for parameter in self.free_parameters]
        rows, columns = np.triu_indices(len(names), k=1)
        with np.errstate(invalid="ignore"):
            above = np.flatnonzero(np.abs(matrix[rows, columns]) > limit)
        pairs = [(names[rows[k]], names[columns[k]], float(matrix[rows[k], columns[k]])) for k in above]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def hardly_known(self, part: float = HARDLY) -> list[tuple[str, float]]:
        """Return free parameters with more than `part` of their sigma left, and std / sigma, largest first."""
        ratios = self.std / np.array([parameter.sigma for parameter in self.free_parameters])
        found = [(p.name, float(r)) for p, r in zip(self.free_parameters, ratios, strict=True) if r > part]
        return sorted(found, key=lambda item: -item[1])


@one_blas_thread
def assess(robot: Robot, poses: Poses, *, task: Poses | None = None, sigma: float | None = None) -> Assessment:
    """Say what poses determine, at the robot's present values.

    Args:
        robot: The robot.
        poses: Poses that are or would be measured; of measurements, only joint values and number of readings are used.
        task: Poses whose accuracy counts; the same if not given.
        sigma: Noise of one reading per axis [m]; the description's if not given.

    Raises:
        DataError: Fewer measured coordinates than free parameters that no prior holds.
        UnreachablePoseError: A pose cannot be assembled.
    """
    require_free(robot)
    parameters, free = robot.parameters, robot.free
    noise, assumed = measurement_sigma(robot, sigma)
    configurations = robot.assemble(poses.joints, labels=poses.labels)
    jacobian = linearise(robot, configurations).jacobian
    _require_rows(robot, poses, jacobian.shape[1])
    weight = np.sqrt(poses.counts if isinstance(poses, Measurements) else np.ones(len(poses)))
    weighted = jacobian * weight[:, None, None, None]
    found = determination(weighted.reshape(-1, len(parameters)), parameters, free)
    kept = [p for p, use in zip(parameters, free, strict=True) if use]
    scales = np.array([p.sigma for p in parameters])
    lengths = found.lengths * scales  # of the columns scaled by sigma, in which rows, priors and groups are told
    rows = (weighted * scales)[..., free].reshape(len(poses), -1, len(kept))
    priors = prior_rows(parameters, free, noise) / lengths[free]
    unit = rows / lengths[free]
    known = information(unit, priors)
    elimination = eliminate(found.columns, _order(robot))
    task_rows = unit / weight[:, None, None] if task is None else assemble_known(robot, task).rows / lengths[free]
    errors = known.position_errors(task_rows, noise)
    scaled, raw = observability_of(rows, kept)
    near = np.flatnonzero(robot.singular_values(configurations) < robot.description.singularity_limit)
    return Assessment(
        parameters=parameters,
        free=free,
        n_poses=len(poses),
        n_rows=jacobian[..., 0].size,
        sigma=noise,
        sigma_assumed=assumed,
        determination=found,
        known=known,
        groups=null_groups(found.columns, _spoken_for(robot, elimination), lengths),
        open_groups=null_groups(found.open_columns, lengths=lengths[free]),
        elimination=elimination,
        scaled=scaled,
        raw=raw,
        std=known.standard_deviations(noise) / found.lengths[free],
        accuracy=task_index(errors),
        position_errors=errors,
        by_count=accuracy_by_count(unit, priors, task_rows, noise),
        near_singular=tuple(poses.labels[k] for k in near),
    )


def _require_rows(robot: Robot, poses: Poses, n_targets: int) -> None:
    """Raise where the poses cannot determine the free parameters, whatever they are."""
    needed = sum(use and not p.prior for p, use in zip(robot.parameters, robot.free, strict=True))
    per_pose = 3 * n_targets
    if per_pose * len(poses) < needed:
        raise DataError(
            f"{poses.path}: {len(poses)} poses give {per_pose * len(poses)} coordinates for {needed} free parameters"
            f" without a prior; give at least {-(-needed // per_pose)} poses (several times that for a useful result)"
        )


def _order(robot: Robot) -> list[int]:
    return [index_of(robot.parameters, name) for name in robot.description.elimination_order]


def _spoken_for(robot: Robot, elimination: Elimination) -> tuple[int, ...]:
    """Parameters to tell groups by: the held ones if there are any, else those that the elimination drops."""
    held = tuple(int(k) for k in np.flatnonzero(~robot.free))
    return held or elimination.dropped

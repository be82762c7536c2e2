"""Candidate poses: assembled, checked, turned into whitened rows, in parts, so that many fit in memory.

The robot is linearised at its present values. `sigma` is the noise of positions per axis in place of the stated one
[m], or None; noise that nobody states is assumed (`calib.core.rows.whitening.ASSUMED`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError, InputError, UnreachablePoseError
from calib.core.base.memory import zeros_with_room
from calib.core.data.in_memory import as_poses
from calib.core.data.measurement_columns import rank_in_visit
from calib.core.data.measurements import Measurements, Poses, measurements
from calib.core.instruments.kind import Readings
from calib.core.instruments.position import Position
from calib.core.numerics.identifiability import reduce_rows
from calib.core.robots.configurations import Configurations, near_singularity, solve_configurations
from calib.core.robots.jacobian import linearise
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.loops import why_open
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed, observe, planned_readings, predict_readings
from calib.core.rows.rows import Rows
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import ASSUMED, Whitening, stated_noise

_PART = 8192
_SAME = 1e-9
"""Joint values that differ by less are the same pose [m, rad]."""
_MEASURED_AGAIN = 1e-4
"""A candidate nearer than this to a measured pose is that pose [m, rad]."""
WHITENED = 1.0
"""Unit of rows if no instrument measures a length; otherwise the noise of a length is the unit."""
_SHOWN = 10


@dataclass(frozen=True, eq=False)
class PoseRows:
    """Rows of planned measurements at poses, and Jacobians of the positions there.

    Attributes:
        rows: Whitened rows of all that the instruments are to read at each pose, instrument by instrument, (n,
            n_rows_per_pose, n_parameters); 0 where an instrument reads less at one pose than at others.
        read: Mask of the rows that are read, (n, n_rows_per_pose).
        blocks: Rows of each instrument, by name.
        positions: Targets at the robot's present values, (n, n_targets, 3) [m].
        position_rows: Derivative of the targets in `RobotData.reported_targets` by the scaled parameters,
            (n, 3 n_located, n_parameters) [m]; for candidates reduced to R, (at most n_parameters, n_parameters) [m]
            (`calib.core.numerics.identifiability.reduce_rows`).
        usable: Mask of the poses that can be assembled far enough from singularities, (n,); rows are 0 and positions
            NaN at the others.
        skipped: Label of each pose that is not usable, and the reason.
    """

    rows: FloatArray
    read: BoolArray
    blocks: Mapping[str, slice]
    positions: FloatArray
    position_rows: FloatArray
    usable: BoolArray
    skipped: tuple[str, ...] = ()


def require_free(robot: Robot) -> None:
    """Raise `InputError` if all parameters are held."""
    if not np.any(robot.is_free):
        raise InputError(f"{robot.path}: held: names every parameter, so there is nothing to identify; free some")


def require_poses(poses: Poses) -> None:
    """Raise `DataError` if there are no poses."""
    if not len(poses):
        raise DataError(f"{poses.path}: there are no poses; give at least one")


def assumed_sigma(robot: Robot, sigma: float | None) -> tuple[float, bool]:
    """Return the noise of one measured position per axis [m] and whether some noise is only assumed.

    Without instruments that measure positions it is the noise of other lengths, such as distances; without these
    `WHITENED`. If `sigma` is not a positive number, it is a `DataError`.
    """
    if sigma is not None and not (np.isfinite(sigma) and sigma > 0):
        raise DataError(f"sigma {sigma:g} m: must be a positive number")
    parts = [
        (part, noise)
        for instrument in robot.instruments
        for part, noise in zip(instrument.parts, stated_noise(instrument, sigma).parts, strict=True)
    ]
    assumed = any(not noise.stated for _, noise in parts)
    lengths = [each for each in parts if each[0].dimension == "length"]
    if not lengths:
        return WHITENED, assumed
    part, noise = min(lengths, key=lambda length: not length[0].is_position)
    typical = np.sqrt(np.median(np.diag(noise.covariance(np.full((1, 3), 1.0), 1, len(part.axes))[0])))
    return float(typical) if noise.stated else ASSUMED[part.dimension], assumed


def rows_of_poses(
    robot: Robot,
    configurations: Configurations,
    sigma: float | None,
    unknowns: Unknowns | None = None,
    looks: Mapping[str, Readings] | None = None,
    blocks: Mapping[str, slice] | None = None,
) -> PoseRows:
    """Return whitened rows of planned readings at assembled poses.

    Args:
        unknowns: The parameters of the columns; the free ones if not given.
        looks: Planned readings of each instrument, from `calib.core.rows.observed.planned_readings`; all that it can in
            the first setup, if not given.
        blocks: Places for the rows of each instrument; as needed, if not given.
    """
    chosen = Unknowns.chosen_by_poses(robot) if unknowns is None else unknowns
    n = len(configurations.actuated)
    poses = as_poses(robot, configurations.actuated[:, : len(robot.joint_names)])
    looks = planned_readings(robot, poses) if looks is None else looks
    places = blocks_of(robot, looks) if blocks is None else blocks
    readings = predict_readings(robot, configurations, looks)
    data = measurements(poses, readings)
    observed = observe(robot, configurations, readings)
    positions, by_parameter = _positions(robot, configurations, data, observed)
    position_rows = (by_parameter[:, robot.reported_targets][..., chosen.index] * chosen.scales).reshape(
        n, -1, len(chosen)
    )
    width = max((place.stop for place in places.values()), default=0)
    rows, read = np.zeros((n, width, len(chosen))), np.zeros((n, width), dtype=bool)
    if data.n_readings:
        whitened = rows_as_stated(robot, data, observed, chosen, sigma)
        for name in whitened.layout.instruments:
            visits, n_rows = readings[name].visits, robot.instrument(name).n_rows
            at = places[name].start + n_rows * rank_in_visit(visits)[:, None] + np.arange(n_rows)
            part = whitened.jacobian[whitened.layout.rows_of(name)]
            rows[visits[:, None], at] = part.reshape(len(visits), n_rows, len(chosen))
            read[visits[:, None], at] = True
    return PoseRows(rows, read, places, positions, position_rows, np.ones(n, dtype=bool))


def rows_as_stated(
    robot: Robot, data: Measurements, observed: Mapping[str, Observed], unknowns: Unknowns, sigma: float | None
) -> Rows:
    """Return the rows of readings, whitened by their stated or assumed noise."""
    whitening = Whitening(robot, data, sigma)
    return whitening.rows(observed, whitening.start(), unknowns, robot.values)


def blocks_of(robot: Robot, looks: Mapping[str, Readings]) -> dict[str, slice]:
    """Return the places of each instrument's rows among the rows of a pose, with room for its most readings."""
    result, start = dict[str, slice](), 0
    for instrument in robot.instruments:
        most = int(np.max(np.bincount(looks[instrument.name].visits), initial=0))
        result[instrument.name] = slice(start, start + most * instrument.n_rows)
        start += most * instrument.n_rows
    return result


def _positions(
    robot: Robot, configurations: Configurations, data: Measurements, observed: dict[str, Observed]
) -> tuple[FloatArray, FloatArray]:
    """Positions of targets and their derivative, from instruments that measure exactly these if there are any."""
    n = len(configurations.actuated)
    position_instruments = {
        instrument.target: instrument.name
        for instrument in robot.instruments
        if isinstance(instrument, Position)
        and instrument.name in data.readings
        and np.array_equal(data.readings[instrument.name].visits, np.arange(n))
    }
    if set(position_instruments) == set(robot.target_names):
        names = [position_instruments[target] for target in robot.target_names]
        positions = np.stack([data.readings[name].values for name in names], axis=1)
        return positions, np.stack([observed[name].jacobian for name in names], axis=1)
    linear = linearise(robot, configurations)
    return linear.positions, linear.jacobian


def reachable_configurations(robot: Robot, poses: Poses) -> tuple[IntArray, Configurations]:
    """Return the indices of the poses at which the loops close, ascending, (k,), and the robot there."""
    columns = term_columns(robot, poses.joints, poses.conditions)
    closed = robot.close(poses.joints, columns=columns)
    reached = np.flatnonzero(closed.ok)
    phi = tuple(column[reached] for column in columns)
    return reached, solve_configurations(robot, poses.joints[reached], closed.select(reached), phi)


def build_candidates(
    robot: Robot, poses: Poses, sigma: float | None = None, *, skip_unreachable: bool = False
) -> PoseRows:
    """Assemble candidates and compute their rows.

    Raises:
        DataError: There are no poses, or one is given twice.
        UnreachablePoseError: Poses cannot be assembled or are next to a singularity of the loops, and are not to be
            skipped.
    """
    require_poses(poses)
    _require_different(poses)
    n, n_targets, unknowns = len(poses), len(robot.target_names), Unknowns.chosen_by_poses(robot)
    blocks = blocks_of(robot, planned_readings(robot, poses))
    per_pose = max(block.stop for block in blocks.values())
    rows = zeros_with_room((n, per_pose, len(unknowns)), f"rows of {n} candidates")
    read = np.zeros((n, per_pose), dtype=bool)
    positions = zeros_with_room((n, n_targets, 3), f"positions of {n} candidates")
    position_rows: FloatArray = np.zeros((0, len(unknowns)))
    usable, reasons = np.zeros(n, dtype=bool), list[str]()
    for start in range(0, n, _PART):
        some = poses.subset(np.arange(start, min(start + _PART, n)))
        reached, configurations = reachable_configurations(robot, some)
        distance = np.full(len(some), np.nan)
        distance[reached] = robot.singular_values(configurations)
        far = np.flatnonzero(distance[reached] >= robot.description.singularity_limit)
        good = reached[far]
        looks = planned_readings(robot, some.subset(good))
        part = rows_of_poses(robot, configurations.select(far), sigma, unknowns, looks, blocks)
        positions[start : start + len(some)] = np.nan
        rows[start + good], read[start + good], positions[start + good] = part.rows, part.read, part.positions
        position_rows = reduce_rows(np.vstack([position_rows, part.position_rows.reshape(-1, len(unknowns))]))
        usable[start + good] = True
        if len(good) < len(some):
            reasons += _reasons(robot, some, distance, len(reasons))
    if reasons and not skip_unreachable:
        more = f"; and {len(reasons) - _SHOWN} more" if len(reasons) > _SHOWN else ""
        raise UnreachablePoseError(
            f"{'; '.join(reasons[:_SHOWN])}{more}; remove these poses, or leave them out with --skip-unreachable"
        )
    rows.flags.writeable = False  # holders need no copy
    return PoseRows(rows, read, blocks, positions, position_rows, usable, tuple(reasons))


def rows_of_measured(robot: Robot, poses: Poses, sigma: float | None) -> FloatArray:
    """Return whitened rows: of measurements those that were read, of poses alone all that the instruments can read.

    They are (n_rows, n_parameters). A pose that cannot be assembled is an `UnreachablePoseError`.
    """
    configurations = robot.assemble(poses.joints, labels=poses.labels, context=poses.conditions)
    if isinstance(poses, Measurements):
        observed, unknowns = observe(robot, configurations, poses.readings), Unknowns.chosen_by_poses(robot)
        return rows_as_stated(robot, poses, observed, unknowns, sigma).jacobian
    part = rows_of_poses(robot, configurations, sigma, looks=planned_readings(robot, poses))
    return part.rows[part.read]


def positions_at(robot: Robot, configurations: Configurations) -> tuple[FloatArray, FloatArray]:
    """Return positions of the targets, and the rows of the reported targets, at a robot's present values.

    Returns:
        (n, n_targets, 3) [m]; (n, 3 n_located, n_parameters) [m].
    """
    unknowns, linear = Unknowns.chosen_by_poses(robot), linearise(robot, configurations)
    located = linear.jacobian[:, robot.reported_targets][..., unknowns.index] * unknowns.scales
    return linear.positions, located.reshape(len(linear.positions), -1, len(unknowns))


def near_measured(candidates: FloatArray, measured: FloatArray) -> BoolArray:
    """Return a mask (n,) of the candidates (n, n_actuated) that are measured poses (k, n_actuated)."""
    gaps, _ = scipy.spatial.cKDTree(measured).query(candidates, p=np.inf)
    return np.asarray(gaps < _MEASURED_AGAIN)


def _require_different(poses: Poses) -> None:
    columns = [*poses.joints.T, *(() if poses.approach is None else poses.approach.T), *poses.context.values()]
    rounded = np.round(np.nan_to_num(np.stack(columns)) / _SAME)
    weights = np.random.default_rng(0).random(len(rounded))
    sums = sum(weight * column for weight, column in zip(weights, rounded, strict=True))  # equal where all columns are
    _, number, count = np.unique(sums, return_inverse=True, return_counts=True)
    some = np.flatnonzero(count[number] > 1)
    rounded = rounded[:, some]
    order = np.lexsort(rounded)
    again = 1 + np.flatnonzero(np.all(np.diff(rounded[:, order]) == 0, axis=0))  # places in this order
    if len(again):
        place = again[np.argmin(order[again])]
        more = f" (and {len(again) - 1} more)" if len(again) > 1 else ""
        later, first = poses.labels[some[order[place]]], poses.labels[some[order[place - 1]]]
        raise DataError(
            f"{later}{more}: the same joint values as {first},"
            " under the same conditions; each candidate can be chosen once, so give it once"
        )


def _reasons(robot: Robot, poses: Poses, distance: FloatArray, already: int) -> list[str]:
    """Why poses cannot be used, by their distance to a singularity, (n,); NaN where the loops are open."""
    limit, reasons = robot.description.singularity_limit, list[str]()
    for k in np.flatnonzero(~(distance >= limit)).tolist():
        if np.isfinite(distance[k]):
            reasons.append(near_singularity(poses.labels[k], distance[k], limit))
            continue
        why = ""
        if already + len(reasons) < _SHOWN:  # each needs a search: not for thousands
            joints = robot.mechanism.without_tilts(poses.joints[k : k + 1])[0]
            why = f" ({why_open(robot.mechanism, robot.mode, joints)})"
        reasons.append(f"{poses.labels[k]}: cannot be assembled{why}")
    return reasons

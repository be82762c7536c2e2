"""Candidate poses: assembled, checked, turned into whitened rows, a part at a time so that many fit in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from calib.arrays import BoolArray, FloatArray
from calib.data.in_memory import measurements
from calib.data.measurements import Measurements, Poses
from calib.errors import DataError, InputError, UnreachablePoseError
from calib.linearisation.jacobian import linearise
from calib.linearisation.observed import Observed, observe, predicted_readings
from calib.linearisation.unknowns import Unknowns
from calib.linearisation.whitening import ASSUMED, Whitening, stated_noise
from calib.model.loops import why_open
from calib.model.robot import Configurations, Robot, near_singularity
from calib.observation.position import Position

_PART = 8192
_SAME = 1e-9
"""Joint values that differ by less are the same pose [m, rad]."""
_MEASURED_AGAIN = 1e-4
"""A candidate within this of a measured pose is that pose [m, rad]."""
_SHOWN = 10


@dataclass(frozen=True, eq=False)
class PoseRows:
    """What measuring at poses would say, and how positions move there.

    Attributes:
        rows: Whitened rows of all that the instruments can read at each pose, (n, n_rows_per_pose, n_parameters).
        positions: Targets at the robot's present values, (n, n_targets, 3) [m].
        position_rows: Derivative of these by the scaled parameters, (n, 3 n_targets, n_parameters) [m].
    """

    rows: FloatArray
    positions: FloatArray
    position_rows: FloatArray


def require_free(robot: Robot) -> None:
    """Raise unless some parameter is free.

    Raises:
        InputError: All are held.
    """
    if not np.any(robot.is_free):
        raise InputError(f"{robot.path}: held: names every parameter, so there is nothing to identify; free some")


def assumed_sigma(robot: Robot, sigma: float | None) -> tuple[float, bool]:
    """Return the noise of one measured position per axis [m] and whether some noise is only assumed.

    Without instruments that measure positions: that of other lengths, such as distances; without these: 1, the unit of
    whitened rows.

    Args:
        robot: Its instruments may state their noise.
        sigma: The noise of positions, if the caller knows it [m].

    Raises:
        DataError: It is not a positive number.
    """
    if sigma is not None and not (np.isfinite(sigma) and sigma > 0):
        raise DataError(f"sigma {sigma:g} m: must be a positive number")
    assumed = any(not part.stated for one in robot.instruments for part in stated_noise(one, sigma).parts)
    lengths = [
        (part, noise)
        for one in robot.instruments
        for part, noise in zip(one.parts, stated_noise(one, sigma).parts, strict=True)
        if part.dimension == "length"
    ]
    for part, noise in sorted(lengths, key=lambda found: found[0].name != "position"):
        typical = np.sqrt(np.median(np.diag(noise.covariance(np.full((1, 3), 1.0), 1, len(part.axes))[0])))
        return float(typical) if noise.stated else ASSUMED[part.dimension], assumed
    return 1.0, assumed


def rows_of_poses(
    robot: Robot, configurations: Configurations, sigma: float | None, unknowns: Unknowns | None = None
) -> PoseRows:
    """Return whitened rows of all that the instruments can read at assembled poses.

    Noise that nobody states is assumed (`calib.linearisation.whitening.ASSUMED`).

    Args:
        robot: The robot, linearised at its present values.
        configurations: The poses.
        sigma: Noise of positions per axis in place of what is stated [m], or None.
        unknowns: The parameters of the columns; the free ones if not given.
    """
    chosen = Unknowns.chosen_by_poses(robot) if unknowns is None else unknowns
    n = len(configurations.actuated)
    readings = predicted_readings(robot, configurations)
    names = tuple(str(k) for k in range(n))
    data = measurements(Poses(configurations.actuated, names, names, "", ()), readings)
    observed = observe(robot, configurations, readings)
    positions, by_parameter = _positions(robot, configurations, data, observed)
    position_rows = (by_parameter[..., chosen.index] * chosen.scales).reshape(n, -1, len(chosen))
    if n == 0:
        width = sum(len(one.looks()[0]) * one.n_rows for one in robot.instruments)
        return PoseRows(np.zeros((0, width, len(chosen))), positions, position_rows)
    whitening = Whitening(robot, data, sigma)
    found = whitening.rows(observed, whitening.start(), chosen, chosen.deviations(robot.values))
    layout = whitening.layout
    parts = [found.jacobian[layout.rows_of(name)].reshape(n, -1, len(chosen)) for name in layout.instruments]
    rows = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
    return PoseRows(rows, positions, position_rows)


def _positions(
    robot: Robot, configurations: Configurations, data: Measurements, observed: dict[str, Observed]
) -> tuple[FloatArray, FloatArray]:
    """Positions of targets and their derivative, from instruments that measure just these where there are."""
    seen = {one.target: one.name for one in robot.instruments if isinstance(one, Position)}
    if set(seen) == set(robot.target_names):
        names = [seen[target] for target in robot.target_names]
        positions = np.stack([data.readings[name].values for name in names], axis=1)
        return positions, np.stack([observed[name].jacobian for name in names], axis=1)
    linear = linearise(robot, configurations)
    return linear.positions, linear.jacobian


@dataclass(frozen=True, eq=False)
class Candidates:
    """Poses that may be measured.

    Attributes:
        joints: (n, n_actuated) [m or rad].
        found: Rows and positions of all; rows 0 and positions NaN where not usable.
        usable: Which can be assembled far enough from singularities, (n,).
        skipped: What to call each pose that is not usable, and why.
    """

    joints: FloatArray
    found: PoseRows
    usable: BoolArray
    skipped: tuple[str, ...]


def build_candidates(
    robot: Robot, poses: Poses, sigma: float | None = None, *, skip_unreachable: bool = False
) -> Candidates:
    """Assemble candidates and take their rows.

    Args:
        robot: The robot, linearised at its present values.
        poses: The candidates.
        sigma: Noise of positions per axis in place of what is stated [m], or None.
        skip_unreachable: Leave poses out that cannot be assembled or are next to a singularity of the loops.

    Raises:
        DataError: A pose is given twice.
        UnreachablePoseError: There are such poses, and they are not to be skipped.
    """
    _require_different(poses)
    n, n_targets, unknowns = len(poses), len(robot.target_names), Unknowns.chosen_by_poses(robot)
    per_pose = sum(len(one.looks()[0]) * one.n_rows for one in robot.instruments)
    rows = np.zeros((n, per_pose, len(unknowns)))
    positions, position_rows = np.full((n, n_targets, 3), np.nan), np.zeros((n, 3 * n_targets, len(unknowns)))
    usable, reasons = np.zeros(n, dtype=bool), list[str]()
    for start in range(0, n, _PART):
        q = poses.joints[start : min(start + _PART, n)]
        closed = robot.close(q)
        good = np.flatnonzero(closed.ok)
        distance = np.zeros(len(q))
        distance[good] = robot.singular_values(robot.configurations(q[good], closed.at(good)))
        good = np.flatnonzero(distance >= robot.description.singularity_limit)
        configurations = robot.configurations(q[good], closed.at(good))
        part = rows_of_poses(robot, configurations, sigma, unknowns)
        rows[start + good], positions[start + good] = part.rows, part.positions
        position_rows[start + good] = part.position_rows
        usable[start + good] = True
        if len(good) < len(q):
            labels = poses.labels[start : start + len(q)]
            reasons += _reasons(robot, q, closed.ok, distance, labels, len(reasons))
    if reasons and not skip_unreachable:
        raise UnreachablePoseError(_listed(reasons) + "; remove these poses, or leave them out with --skip-unreachable")
    return Candidates(poses.joints, PoseRows(rows, positions, position_rows), usable, tuple(reasons))


def rows_of_measured(robot: Robot, poses: Poses, sigma: float | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return whitened rows of poses that are measured, positions of the targets there, and their rows.

    Of measurements: of what was really read. Of poses alone: of all that the instruments can read.

    Args:
        robot: The robot, linearised at its present values.
        poses: The poses.
        sigma: Noise of positions per axis in place of what is stated [m], or None.

    Returns:
        (n_rows, n_parameters); (n, n_targets, 3) [m]; (n, 3 n_targets, n_parameters) [m].

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    configurations = robot.assemble(poses.joints, labels=poses.labels)
    if not isinstance(poses, Measurements):
        part = rows_of_poses(robot, configurations, sigma)
        return part.rows.reshape(-1, part.rows.shape[2]), part.positions, part.position_rows
    unknowns = Unknowns.chosen_by_poses(robot)
    whitening = Whitening(robot, poses, sigma)
    observed = observe(robot, configurations, poses.readings)
    found = whitening.rows(observed, whitening.start(), unknowns, unknowns.deviations(robot.values))
    linear = linearise(robot, configurations)
    position_rows = (linear.jacobian[..., unknowns.index] * unknowns.scales).reshape(len(poses), -1, len(unknowns))
    return found.jacobian, linear.positions, position_rows


def near_measured(candidates: FloatArray, measured: FloatArray) -> BoolArray:
    """Return which candidates (n, n_actuated) are poses that were measured already, (n,)."""
    gaps, _ = cKDTree(measured).query(candidates, p=np.inf)
    result: BoolArray = gaps < _MEASURED_AGAIN
    return result


def _require_different(poses: Poses) -> None:
    rounded = np.round(poses.joints / _SAME).astype(np.int64)
    _, first, inverse = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[inverse.ravel()] != np.arange(len(poses)))
    if len(again):
        k = int(again[0])
        more = f" (and {len(again) - 1} more)" if len(again) > 1 else ""
        raise DataError(
            f"{poses.labels[k]}{more}: the same joint values as {poses.labels[first[inverse.ravel()[k]]]};"
            " each candidate can be chosen once, so give it once"
        )


def _reasons(
    robot: Robot, q: FloatArray, ok: BoolArray, distance: FloatArray, labels: Sequence[str], already: int
) -> list[str]:
    limit = robot.description.singularity_limit
    found: list[str] = []
    for k in (int(number) for number in np.flatnonzero(distance < limit)):
        if ok[k]:
            found.append(near_singularity(labels[k], distance[k], limit))
            continue
        shown = already + len(found) < _SHOWN  # a search each: not for thousands
        why = f" ({why_open(robot.mechanism, robot.mode, q[k])})" if shown else ""
        found.append(f"{labels[k]}: cannot be assembled{why}")
    return found


def _listed(reasons: Sequence[str]) -> str:
    more = f"; and {len(reasons) - _SHOWN} more" if len(reasons) > _SHOWN else ""
    return "; ".join(reasons[:_SHOWN]) + more

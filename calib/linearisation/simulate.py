"""Simulated measurements: what the instruments of a robot with known parameters read, plus normal noise.

A touch has no reading that noise could be added to: the robot itself stands where it touches, and what it misses by is
in its joints. So the joint values of a pose at which something is touched are found: those near the given ones at which
every gap is the miss that was drawn, by damped Gauss-Newton steps of the actuated joints through the loops,

    minimise  |gap - miss + d(gap)/dq dq|^2 + damping |dq|^2

with less damping after a step that came nearer, more after one that did not, and within the joint limits. Like all
searches from one start it may end elsewhere than at contact; then the pose is named, and nothing is returned.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.data.arrays import as_poses, measurements
from calib.data.measurements import Measurements, Poses, directions_of_motion
from calib.errors import DataError, UnreachablePoseError
from calib.joint_terms.term import Context
from calib.linearisation.observed import looks_at, observe, predicted_readings, unsaid_touches
from calib.linearisation.whitening import stated_noise
from calib.model.robot import Configurations, Robot
from calib.observation.kind import Instrument, Readings
from calib.units import millimetres

_LONGEST_STEP = 0.2  # of a joint at once [rad, or characteristic lengths]
_STEPS = 200
_MET = 1e-10  # miss that is none [m]
_FIRST_DAMPING, _LARGEST_DAMPING, _SMALLEST_DAMPING = 1e-3, 1e12, 1e-15


def simulate(
    robot: Robot,
    poses: Poses | ArrayLike,
    sigma: float | None,
    rng: np.random.Generator,
    *,
    joint_sigma: float = 0.0,
) -> Measurements:
    """Return simulated measurements of a robot at its current parameter values.

    Instruments read what the poses say (`calib.data.plan_files.read_plan`), or all that they can. Where something is
    touched, the joint values are changed so that it is. Noise that nobody states is none.

    Args:
        robot: The robot that plays the truth.
        poses: Where to measure: poses, or joint values alone, (n, n_actuated) [m or rad].
        sigma: Standard deviation of the noise of positions per axis [m]; 0 for no noise of anything; None for what the
            description states.
        rng: Source of the noise.
        joint_sigma: Standard deviation of what the joints are off at each visit, in their commands unseen [rad, or
            characteristic lengths].

    Raises:
        DataError: Sigma is not a number >= 0, or nobody says what is touched at a pose.
        UnreachablePoseError: A pose cannot be assembled, or no contact was found near it.
    """
    if sigma is not None and not (np.isfinite(sigma) and sigma >= 0):
        raise DataError(f"sigma {sigma:g} m: must be a number, zero or positive")
    where = as_poses(robot, poses)
    looks = looks_at(robot, where)
    off = np.zeros_like(where.joints)
    if joint_sigma:
        off = joint_sigma * robot.mechanism.joint_scale * rng.standard_normal(where.joints.shape)
    touches = _touches(robot, where, looks, sigma, rng)
    commands = _at_contact(robot, where, off, touches) if touches else where.joints
    configurations = _assembled(robot, where, commands, off)  # says which pose cannot be
    readings = dict[str, Readings]()
    for name, found in predicted_readings(robot, configurations, looks).items():
        one = robot.instrument(name)
        if name not in touches:
            readings[name] = _noisy(one, found, sigma, rng)
        elif len(found):
            zeros = np.zeros((len(found), one.n_rows))
            readings[name] = Readings(found.visits, found.pairs, zeros, None, found.details)
    noise = "noise as the description states it" if sigma is None else _said(sigma)
    said = (f"simulated measurements of {robot.name}", noise)
    data = measurements(where, readings)
    return Measurements(
        commands,
        data.labels,
        data.names,
        data.path,
        data.ignored,
        data.readings,
        comments=said,
        context=data.context,
        setups=data.setups,
    )


def unstated_noise(robot: Robot, sigma: float | None) -> list[str]:
    """Return the instruments of whose noise neither the description nor `sigma` says anything."""
    return [one.name for one in robot.instruments if not all(part.stated for part in stated_noise(one, sigma).parts)]


def _said(sigma: float) -> str:
    return f"normal noise, sigma {millimetres(sigma):g} mm per axis"


def _touches(
    robot: Robot, where: Poses, looks: Mapping[str, Readings], sigma: float | None, rng: np.random.Generator
) -> dict[str, Readings]:
    """What is touched at which visit, and by how much each touch misses."""
    unsaid = next(iter(unsaid_touches(robot, where)), None)
    if unsaid is not None:
        raise DataError(
            f"{where.path}: nothing says what instrument '{unsaid.name}' touches at which pose; add a column"
            f" '{unsaid.text_columns()[0]}' that names it, empty where nothing is touched"
        )
    result = {}
    for one in (one for one in robot.instruments if not one.columns()):
        found = looks[one.name]
        exact = Readings(found.visits, found.pairs, np.zeros((len(found), one.n_rows)), None, found.details)
        result[one.name] = _noisy(one, exact, sigma, rng)
    return result


def _at_contact(robot: Robot, where: Poses, off: FloatArray, touches: Mapping[str, Readings]) -> FloatArray:
    """Commands near those given at which every gap is what `touches` say, (n, n_actuated); see the module docstring."""
    lower, upper = _limits(robot, where)
    scale, follows = robot.mechanism.joint_scale, _follows(where, touches)
    commands, damping = where.joints, np.full(len(where), _FIRST_DAMPING)
    for _ in range(_STEPS):
        gaps, slopes = _gaps(robot, _assembled(robot, where, commands, off), touches)
        miss = np.linalg.norm(gaps, axis=1)
        if np.all(miss < _MET):
            return commands
        if np.all(damping[miss >= _MET] > _LARGEST_DAMPING):
            break
        step = _damped_step(gaps, slopes * scale, damping, np.zeros(commands.shape, dtype=bool))
        held = ((commands <= lower) & (step < 0)) | ((commands >= upper) & (step > 0))
        step = _damped_step(gaps, slopes * scale, damping, held)
        trial = np.clip(commands + step * scale, lower, upper)
        context = Context.of(directions_of_motion(trial), where.context)
        closes = robot.close(trial + off, columns=robot.term_columns(trial + off, context)).ok
        trial = np.where(closes[:, None], trial, commands)
        there, _ = _gaps(robot, _assembled(robot, where, trial, off), touches)
        better = np.linalg.norm(there, axis=1) < miss
        damping = np.where(better, np.maximum(damping / 10, _SMALLEST_DAMPING), damping * 8)
        commands = np.where(better[:, None], trial, commands)[follows]
    worst, more = int(np.argmax(miss)), int(np.sum(miss >= _MET)) - 1
    raise UnreachablePoseError(
        f"{where.labels[worst]}{f' and {more} more' if more else ''}: no joint values near these touch what they"
        f" should; the best that were found miss by {millimetres(miss[worst]):.3g} mm; start nearer to contact"
    )


def _damped_step(gaps: FloatArray, slopes: FloatArray, damping: FloatArray, held: BoolArray) -> FloatArray:
    """The step of the module docstring of joints that no limit holds, no longer than is allowed, (n, n_actuated)."""
    free = np.where(held[:, None, :], 0.0, slopes)
    n_joints = slopes.shape[2]
    size = np.einsum("nij,nij->n", slopes, slopes) / n_joints + 1e-300
    normal = free.transpose(0, 2, 1) @ free + (damping * size)[:, None, None] * np.eye(n_joints)
    step: FloatArray = -np.linalg.solve(normal, free.transpose(0, 2, 1) @ gaps[:, :, None])[:, :, 0]
    longest = np.max(np.abs(step), axis=1, keepdims=True)
    return step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))


def _limits(robot: Robot, where: Poses) -> tuple[FloatArray, FloatArray]:
    """Where the joints may go, (n, n_actuated) each: within the URDF's limits, or where they stand already."""
    limits = {joint.name: (joint.lower, joint.upper) for joint in robot.urdf.joints}
    lower, upper = np.array([limits[name] for name in robot.joint_names]).T
    return np.minimum(lower, where.joints), np.maximum(upper, where.joints)


def _follows(where: Poses, touches: Mapping[str, Readings]) -> IntArray:
    """Whose joint values each visit takes: its own; or, touching nothing, those of a touch that repeats its pose."""
    touching = np.unique(np.concatenate([found.visits for found in touches.values()]))
    numbers, result = where.pose_numbers, np.arange(len(where))
    first = dict(zip(numbers[touching[::-1]].tolist(), touching[::-1].tolist(), strict=True))
    for k in np.setdiff1d(result, touching):
        result[k] = first.get(int(numbers[k]), k)
    return result


def _gaps(
    robot: Robot, configurations: Configurations, touches: Mapping[str, Readings]
) -> tuple[FloatArray, FloatArray]:
    """Gaps beyond what is missed by, (n, n_gaps) [m], 0 where fewer, and their derivative by the actuated joints."""
    observed = observe(robot, configurations, touches, joints=True)
    n, n_joints = configurations.actuated.shape
    width = sum(robot.instrument(name).n_rows for name in touches)
    gaps, slopes, start = np.zeros((n, width)), np.zeros((n, width, n_joints)), 0
    for name, found in touches.items():
        columns = slice(start, start + robot.instrument(name).n_rows)
        gaps[found.visits, columns] = observed[name].residuals
        slopes[found.visits, columns] = observed[name].by_joint
        start = columns.stop
    return gaps, slopes


def _assembled(robot: Robot, where: Poses, commands: FloatArray, off: FloatArray) -> Configurations:
    """The robot at commands (n, n_actuated) that it does not quite follow."""
    context = Context.of(directions_of_motion(commands), where.context)
    return robot.assemble(commands + off, labels=where.labels, context=context)


def _noisy(one: Instrument, every: Readings, sigma: float | None, rng: np.random.Generator) -> Readings:
    """Readings with noise, without those of what cannot be seen."""
    seen = np.flatnonzero(~np.isnan(every.values).all(axis=1))
    found = Readings(every.visits[seen], every.pairs[seen], every.values[seen], None, every.details[seen])
    change = np.zeros((len(found), one.n_rows))
    if sigma != 0:
        noise = stated_noise(one, sigma)
        widths = [len(part.axes) for part in one.parts]
        covariance = noise.covariance(one.points(found.values), len(found), widths)
        normal = rng.standard_normal(change.shape)
        change = _rows_with_noise(one, sigma) * _times_root(covariance, normal)
    return Readings(found.visits, found.pairs, one.moved(found.values, change), None, found.details)


def _rows_with_noise(one: Instrument, sigma: float | None) -> FloatArray:
    """1.0 for rows whose noise is known, else 0.0."""
    stated = [part.stated for part in stated_noise(one, sigma).parts]
    return np.array([float(stated[k]) for k in one.part_of_row])


def _times_root(covariance: FloatArray, normal: FloatArray) -> FloatArray:
    result: FloatArray = np.matmul(np.linalg.cholesky(covariance), normal[:, :, None])[:, :, 0]
    return result

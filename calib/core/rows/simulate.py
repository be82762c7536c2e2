"""Simulated measurements: the readings of a robot's instruments at known parameters, plus normal noise.

A touch has no reading that noise could be added to: its error is in the joints of the robot. So the joint values of a
touching pose are found near the given ones, such that every gap equals a drawn miss, by damped Gauss-Newton steps of
the actuated joints through the loops,

    minimise  |gap - miss + d(gap)/dq dq|^2 + damping |dq|^2

with less damping after a step that came nearer, more after one that did not, and within the joint limits. Like all
searches from one start it may end away from contact; then an error names the pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, random_numbers
from calib.core.base.errors import DataError, UnreachablePoseError
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import quantity_text, sigma_in_si
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurements import Measurements, Poses, directions_of_motion, measurements, readings_of_visits
from calib.core.instruments.kind import Instrument, Readings
from calib.core.numerics import linalg
from calib.core.robots.configurations import Configurations, solve_configurations
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.observed import observe, planned_readings, predict_readings, touches_without_target
from calib.core.rows.whitening import stated_noise

_LONGEST_STEP = 0.2  # step of a joint [rad, or characteristic lengths]
_ROUNDS, _STEPS = 3, 100
_LEAST_GAIN, _NEARLY = 1e-3, 1e-6  # a step of less gain ends a search that is further from contact [m]
MET = 1e-10
"""The robot is in contact if the distance is less [m]."""
_FIRST_DAMPING, _LARGEST_DAMPING, _SMALLEST_DAMPING = 1e-3, 1e12, 1e-15


@one_blas_thread
def simulate(
    robot: RobotLike,
    poses: PosesLike,
    sigma: float | str | None = None,
    seed: int | np.random.Generator = 0,
    *,
    joint_sigma: float = 0.0,
) -> Measurements:
    """Return simulated measurements of a robot at its current parameter values.

    Instruments read what is planned (`calib.core.data.plan_files.read_plan`); without a plan, all that they can. At a
    touch, the joint values are changed until the robot touches. Unstated noise is zero.

    Args:
        robot: The true robot.
        poses: Poses to measure: poses, or joint values alone, (n, n_actuated) [m or rad].
        sigma: Standard deviation of the noise of positions per axis [m]; 0 for no noise at all; None for the stated
            noise.
        seed: Seed of the noise, or a generator of random numbers.
        joint_sigma: Standard deviation of joint errors at each visit that the joint values do not show [rad, or
            characteristic lengths].

    Raises:
        InputError: `robot` is not a robot.
        DataError: Sigma is not a number >= 0, or a pose does not say what is touched.
        UnreachablePoseError: A pose cannot be assembled, or no contact was found near it.
    """
    robot, sigma = as_robot(robot), sigma_in_si(sigma)
    if sigma is not None and not (np.isfinite(sigma) and sigma >= 0):
        raise DataError(f"sigma {sigma:g} m: must be zero or a positive number")
    rng = random_numbers(seed)
    poses = as_poses(robot, poses)
    looks = planned_readings(robot, poses)
    off = np.zeros_like(poses.joints)
    if joint_sigma:
        off = joint_sigma * robot.mechanism.joint_scale * rng.standard_normal(poses.joints.shape)
    touches = _touches(robot, poses, looks, sigma, rng)
    commands = poses.joints
    if touches:
        _assemble(robot, poses, commands, off)
        commands, misses = touching_configurations(robot, poses, touches, off)
        _require_contact(poses, misses)
    configurations = _assemble(robot, poses, commands, off)  # an error names the pose that fails
    readings = dict[str, Readings]()
    for name, predicted in predict_readings(robot, configurations, looks).items():
        if name not in touches:
            readings[name] = _noisy(robot.instrument(name), predicted, sigma, rng)
        elif len(predicted):
            readings[name] = replace(touches[name], values=np.zeros_like(touches[name].values))
    comments = (f"simulated measurements of {robot.name}", _noise_in_words(robot, sigma))
    return replace(measurements(poses, readings), joints=commands, comments=comments, planned={})


def noisy_readings(
    robot: Robot, exact: Mapping[str, Readings], sigma: float | None, rng: np.random.Generator
) -> dict[str, Readings]:
    """Return readings `exact` with the normal noise that the robot's instruments state, or `sigma` (see `simulate`).

    Those that see nothing are left out. Noise of gaps is the distance by which touches miss.
    """
    return {name: _noisy(robot.instrument(name), readings, sigma, rng) for name, readings in exact.items()}


def unstated_noise(robot: Robot, sigma: float | None) -> list[str]:
    """Return the instruments whose noise neither the description nor `sigma` states."""
    return [
        instrument.name
        for instrument in robot.instruments
        if not all(part.stated for part in stated_noise(instrument, sigma).parts)
    ]


def _noise_in_words(robot: Robot, sigma: float | None) -> str:
    if sigma is None:
        return "noise as the description states it"
    words = f"normal noise, sigma {quantity_text(sigma, 'mm', 'g')} per axis"
    if sigma == 0 or all(part.is_position for instrument in robot.instruments for part in instrument.parts):
        return words
    return f"{words} of positions, other noise as the description states it"


def _touches(
    robot: Robot, poses: Poses, looks: Mapping[str, Readings], sigma: float | None, rng: np.random.Generator
) -> dict[str, Readings]:
    """Touched things by visit, and the gap that each touch leaves."""
    without_target = next(iter(touches_without_target(robot, poses)), None)
    if without_target is not None:
        raise DataError(
            f"{poses.path}: no column says what instrument '{without_target.name}' touches; add a column"
            f" '{without_target.text_columns()[0]}' that names it at each pose (empty: it touches nothing there)"
        )
    exact = {
        instrument.name: replace(
            looks[instrument.name], values=np.zeros((len(looks[instrument.name]), instrument.n_rows))
        )
        for instrument in robot.instruments
        if instrument.touches
    }
    return noisy_readings(robot, exact, sigma, rng)


def touching_configurations(
    robot: Robot, poses: Poses, touches: Mapping[str, Readings], off: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Move the robot to contact; see the module docstring.

    Args:
        poses: Poses to start from; poses without a touch stay, or follow a touch that repeats the same pose.
        touches: Planned touches of each touching instrument, with the distance of each miss.
        off: Errors of the joints in addition to their commands, (n, n_actuated) [m or rad]; zero if not given.

    Returns:
        Commands, (n, n_actuated) [m or rad]; distance of each from contact, (n,) [m], less than `MET` where it touches.
    """
    errors = np.zeros_like(poses.joints) if off is None else off
    lower, upper = robot.urdf.limits(robot.joint_names)
    lower, upper = np.minimum(lower, poses.joints), np.maximum(upper, poses.joints)
    scale, commands, follows = robot.mechanism.joint_scale, poses.joints.copy(), _follows(poses, touches)
    everyone, given_up = np.arange(len(poses)), np.zeros(len(poses), dtype=bool)
    for _ in range(_ROUNDS):  # because a moved visit can change the direction of approach to the next one
        gaps, slopes = _gaps(robot, poses, commands, errors, touches, everyone)
        miss, damping = np.linalg.norm(gaps, axis=1), np.full(len(poses), _FIRST_DAMPING)
        active = np.flatnonzero((miss >= MET) & ~given_up)
        if len(active) == 0:
            break
        for _ in range(_STEPS):
            system = gaps[active], slopes[active] * scale, damping[active]
            step = _damped_step(*system, np.zeros((len(active), len(scale)), dtype=bool))
            at = commands[active]
            held = ((at <= lower[active]) & (step < 0)) | ((at >= upper[active]) & (step > 0))
            trial = commands.copy()
            trial[active] = np.clip(at + _damped_step(*system, held) * scale, lower[active], upper[active])
            trial_gaps, trial_slopes = _gaps(robot, poses, trial, errors, touches, active)
            left = np.linalg.norm(trial_gaps, axis=1)
            better = left < miss[active]
            gained = active[better]
            stuck = better & (left > _NEARLY) & (left > (1 - _LEAST_GAIN) * miss[active])
            commands[gained] = trial[gained]
            gaps[gained], slopes[gained], miss[gained] = trial_gaps[better], trial_slopes[better], left[better]
            damping[active] = np.where(better, np.maximum(damping[active] / 10, _SMALLEST_DAMPING), damping[active] * 8)
            active = active[~stuck & (miss[active] >= MET) & (damping[active] < _LARGEST_DAMPING)]
            if len(active) == 0:
                break
        given_up |= miss >= MET
        commands = commands[follows]
    return commands, np.linalg.norm(_gaps(robot, poses, commands, errors, touches, everyone)[0], axis=1)


def _require_contact(poses: Poses, misses: FloatArray) -> None:
    worst, more = int(np.argmax(misses)), int(np.sum(misses >= MET)) - 1
    if misses[worst] >= MET:
        raise UnreachablePoseError(
            f"{poses.labels[worst]}{f' and {more} more' if more else ''}: no contact was found near these joint"
            f" values; the nearest misses it by {quantity_text(misses[worst], 'mm')}; start nearer to contact"
        )


def _damped_step(gaps: FloatArray, slopes: FloatArray, damping: FloatArray, held: BoolArray) -> FloatArray:
    """The step of the module docstring for joints that no limit holds, limited in length, (n, n_actuated)."""
    free = np.where(held[:, None, :], 0.0, slopes)
    size = np.einsum("nij,nij->n", slopes, slopes) / slopes.shape[2] + 1e-300
    # Singular values, not J^T J: with little damping, its rounding errors would move joints that change no gap.
    left, values, right = linalg.svd(free, full_matrices=False)
    gradient = np.matmul(left.transpose(0, 2, 1), gaps[:, :, None])[:, :, 0]
    along = gradient * values / (values**2 + (damping * size)[:, None])
    step: FloatArray = -np.matmul(along[:, None, :], right)[:, 0]
    longest = np.max(np.abs(step), axis=1, keepdims=True)
    return step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))


def _follows(poses: Poses, touches: Mapping[str, Readings]) -> IntArray:
    """The visit whose joint values each visit takes: itself, or without a touch, a touching visit of the same pose."""
    touching = np.unique(np.concatenate([readings.visits for readings in touches.values()]))
    numbers, result = poses.pose_numbers, np.arange(len(poses))
    first = dict(zip(numbers[touching[::-1]].tolist(), touching[::-1].tolist(), strict=True))
    for k in np.setdiff1d(result, touching):
        result[k] = first.get(int(numbers[k]), k)
    return result


def _gaps(
    robot: Robot, poses: Poses, commands: FloatArray, off: FloatArray, touches: Mapping[str, Readings], index: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Gaps of some visits beyond the drawn miss, (n, n_gaps) [m], and by the actuated joints, (n, n_gaps, n_actuated).

    They are 0 where an instrument has fewer, and infinite where the robot cannot be assembled.
    """
    context = _context(poses, commands)
    columns = tuple(part[index] for part in term_columns(robot, commands + off, context))
    q = (commands + off)[index]
    closed = robot.close(q, columns=columns)
    ok = np.flatnonzero(closed.ok)
    configurations = solve_configurations(robot, q[ok], closed.select(ok), tuple(part[ok] for part in columns))
    looks = {name: readings_of_visits(readings, index[ok]) for name, readings in touches.items()}
    observed = observe(robot, configurations, looks, joints=True)
    width = sum(robot.instrument(name).n_rows for name in touches)
    gaps, slopes, start = np.zeros((len(index), width)), np.zeros((len(index), width, q.shape[1])), 0
    gaps[~closed.ok] = np.inf
    for name, readings in looks.items():
        rows = slice(start, start + robot.instrument(name).n_rows)
        gaps[ok[readings.visits], rows] = observed[name].residuals
        slopes[ok[readings.visits], rows] = observed[name].joint_derivative
        start = rows.stop
    return gaps, slopes


def _context(poses: Poses, commands: FloatArray) -> Context:
    """Conditions of commands (n, n_actuated); their order gives the side of approach if the poses do not."""
    approach = directions_of_motion(commands) if poses.approach is None else poses.approach
    return Context.from_conditions(approach, poses.context, poses.setups)


def _assemble(robot: Robot, poses: Poses, commands: FloatArray, off: FloatArray) -> Configurations:
    context = _context(poses, commands)
    return robot.assemble(commands + off, labels=poses.labels, context=context)


def _noisy(instrument: Instrument, exact: Readings, sigma: float | None, rng: np.random.Generator) -> Readings:
    seen = np.flatnonzero(~np.isnan(exact.values).all(axis=1))
    visible = exact if len(seen) == len(exact) else exact.subset(seen)
    change = np.zeros((len(visible), instrument.n_rows))
    if sigma != 0:
        noise = stated_noise(instrument, sigma)
        covariance = instrument.covariance(visible.values, noise)
        normal = rng.standard_normal(change.shape)
        stated = np.array([float(noise.parts[k].stated) for k in instrument.part_of_row])
        change = stated * np.matmul(np.linalg.cholesky(covariance), normal[:, :, None])[:, :, 0]
    return Readings(
        visible.visits, visible.pairs, instrument.with_errors(visible.values, change), None, visible.details
    )

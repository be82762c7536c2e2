"""Random poses of a robot, spread over its joint limits (`Robot.sample`).

Touches determine less than positions: at one socket, the size of the robot stays open, because the ball is always in
the same place. So each pose of a robot that touches is brought to one of the described places, in turn, if the search
from there succeeds.

A camera sees its board from few poses. If only cameras read, poses are tried until enough see something
(`calib.core.instruments.pixel` defines when). If a kind of instrument defines places from which it can read
(`FrameInstrument.sights`), poses are first brought there.

If the robot file has shapes, or the description has obstacles, only free poses are returned
(`calib.shared.pose_check`): more are drawn with the same seed until enough are free.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import BoolArray, FloatArray, random_numbers
from calib.core.base.errors import DataError
from calib.core.base.memory import require_memory
from calib.core.base.words import count_noun, listing
from calib.core.data.measurements import Poses, readings_of_visits
from calib.core.instruments.kind import Comparison, FrameInstrument, Instrument, Readings, View
from calib.core.instruments.pose import Pose
from calib.core.instruments.rotations import rotation_vectors
from calib.core.robots.described_instruments import MEASUREMENT_FRAME
from calib.core.robots.joint_sampling import TRIES, Ranges
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.rows.observed import planned_readings, predict_readings
from calib.core.rows.simulate import MET, touching_configurations
from calib.shared.candidates import reachable_configurations
from calib.shared.pose_check import PoseCheck, blocking_sentence, check_poses

_TRIED_OF_EACH, _LEAST_TRIED, _MOST_TRIED = 200, 5_000, 40_000  # poses to try: for each needed one, and limits of all
_AT_ONCE = 1_000
_BROUGHT_OF_EACH = 10  # poses to try for each needed pose if the instrument defines from where it can read
_FEW_SEE = 0.5  # a remark names a camera that sees something at a smaller part of the poses
_MOST_DRAWN = 64  # drawn poses for each free pose
_NUMBERS_OF_EACH = 120  # memory of a pose in numbers of 8 bytes; 700 to 850 bytes were measured


def sample(
    robot: RobotLike,
    count: int,
    seed: int | np.random.Generator = 0,
    *,
    within: Poses | Ranges | ArrayLike | None = None,
) -> Poses:
    """Return `count` poses of the robot, named by their number; in contact if an instrument touches.

    If too few poses reach contact with the described places, poses are not in contact and name no touched target
    (`calib.core.rows.observed.touches_without_target`). If a camera sees something at too few poses, the other poses
    see nothing (`visible_poses`).

    Args:
        robot: The robot at its present values.
        seed: Seed or generator of the joint values.
        within: Ranges inside the joint limits, by name [SI]; or poses, or joint values (n, n_actuated) [m or rad],
            that span the ranges.

    Raises:
        InputError: The count or the seed is negative, a range is invalid, or the poses do not fit into memory.
        DataError: Too few poses exist, even near home, or too few are free; or a sliding joint has no limits.
    """
    return free_sample(as_robot(robot), count, random_numbers(seed), within)[0]


def free_sample(
    robot: Robot, count: int, generator: np.random.Generator, within: Poses | Ranges | ArrayLike | None = None
) -> tuple[Poses, PoseCheck, Poses]:
    """Return free poses, the check of all drawn poses, and the first drawn poses, free or not; see `sample`."""
    state, total = generator.bit_generator.state, count
    while True:
        generator.bit_generator.state = state  # draw the same poses again, and more
        drawn = _draw_poses(robot, total, generator, within)
        check = check_poses(robot, drawn.joints)
        free = np.flatnonzero(check.is_free)[:count]
        if len(free) == count:
            if len(free) == len(drawn):
                return drawn, check, drawn
            looked_at = PoseCheck(check.hits[: int(free[-1]) + 1], check.remarks)
            named = _poses(robot, drawn.joints[free])
            kept = replace(drawn.subset(free), names=named.names, labels=named.labels)
            return kept, looked_at, drawn.subset(np.arange(count))
        if total >= _MOST_DRAWN * count:
            blocked = blocking_sentence(Counter(filter(None, check.hits)), len(check.hits))
            raise DataError(
                f"{robot.path}: only {count_noun(len(free), 'pose')} of {count} found that are free: {blocked}"
            )
        total = min(_MOST_DRAWN * count, max(2 * total, int(1.2 * total * count / max(len(free), 1))))


def _draw_poses(
    robot: Robot, count: int, generator: np.random.Generator, within: Poses | Ranges | ArrayLike | None
) -> Poses:
    """Poses as in `sample`, free or not."""
    touches = [instrument for instrument in robot.instruments if instrument.touches]
    spanned = within.joints if isinstance(within, Poses) else within
    total = TRIES * count if touches and count > 0 else count
    require_memory(_NUMBERS_OF_EACH * max(total, 0), f"sampling {count_noun(count, 'pose')}", "sample fewer")
    tried = _poses(robot, robot.sample(total, generator, within=spanned))
    if all(instrument.may_see_nothing for instrument in robot.instruments):
        return _seeing(robot, tried, generator, spanned)
    if not touches:
        return tried
    looks = [
        (instrument, pair, detail) for instrument in touches for pair, detail in zip(*instrument.looks(), strict=True)
    ]
    touched = {}
    for instrument in touches:
        visits = np.array([k for k in range(len(tried)) if looks[k % len(looks)][0] is instrument], dtype=np.intp)
        pairs, details = (np.array([looks[k % len(looks)][part] for k in visits]) for part in (1, 2))
        touched[instrument.name] = Readings(visits, pairs, np.zeros((len(visits), instrument.n_rows)), None, details)
    commands, misses = touching_configurations(robot, tried, touched)
    met = np.flatnonzero(misses < MET)
    if len(met) < count:
        return _poses(robot, tried.joints[:count])
    kept = {name: readings_of_visits(readings, met[:count]) for name, readings in touched.items()}
    planned = {name: replace(readings, values=np.zeros((len(readings), 0))) for name, readings in kept.items()}
    return replace(_poses(robot, commands[met[:count]]), planned=planned)


def visible_poses(robot: Robot, poses: Poses) -> dict[str, BoolArray]:
    """Return masks of the poses at which each instrument that may see nothing would read something, (n,), by name.

    At poses that cannot be assembled, nothing is read.
    """
    names = [instrument.name for instrument in robot.instruments if instrument.may_see_nothing]
    result = {name: np.zeros(len(poses), dtype=bool) for name in names}
    for start in range(0, len(poses) if result else 0, _AT_ONCE):
        part = poses.subset(np.arange(start, min(start + _AT_ONCE, len(poses))))
        good, configurations = reachable_configurations(robot, part)
        looks = planned_readings(robot, part.subset(good))
        for name, readings in predict_readings(robot, configurations, {name: looks[name] for name in result}).items():
            seen = np.isfinite(readings.values).any(axis=1)
            result[name][start + good[readings.visits[seen]]] = True
    return result


def little_seen(robot: Robot, poses: Poses) -> str | None:
    """Return a remark on instruments that see something at few of the poses; None if there are none."""
    few = [
        f"{name} at {int(np.sum(seen))} of {len(poses)}"
        for name, seen in visible_poses(robot, poses).items()
        if np.mean(seen) < _FEW_SEE
    ]
    if not few:
        return None
    return (
        f"few of these poses see what is to be measured: {listing(few)}; check `xyz` and `rpy` of the camera and of"
        " what it sees, `image` and `focus`, or keep to poses near those that see it (--within)"
    )


def _seeing(robot: Robot, first: Poses, generator: np.random.Generator, within: Ranges | ArrayLike | None) -> Poses:
    """As many poses as `first`; poses that see something replace the others, as far as they are found."""
    count = len(first)
    tries, at_once = int(np.clip(_TRIED_OF_EACH * count, _LEAST_TRIED, _MOST_TRIED)), _AT_ONCE
    seeing, tried = np.zeros((0, first.joints.shape[1])), _brought_into_sight(robot, first, generator)
    if tried is not first.joints:  # most of them see something, and the inverse kinematics takes longer than trying
        tries, at_once = _BROUGHT_OF_EACH * count, count
    while True:
        sees = np.any(list(visible_poses(robot, _poses(robot, tried)).values()), axis=0)
        seeing, tries = np.vstack([seeing, tried[sees]]), tries - len(tried)
        if len(seeing) >= count or tries <= 0:
            break
        more = _poses(robot, robot.sample(min(at_once, tries), generator, within=within))
        tried = _brought_into_sight(robot, more, generator)
    blind = first.joints[~np.any(list(visible_poses(robot, first).values()), axis=0)]
    return _poses(robot, np.vstack([seeing, blind])[:count])


@dataclass(frozen=True)
class _MutualPose(Pose):
    """A substitute for an instrument: it measures the pose between the instrument's two frames."""

    frames: tuple[tuple[str, str], ...] = ()

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return the frames of the other instrument."""
        return self.frames

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Compare the stated components of readings, without unknowns."""
        is_stated = np.isfinite(readings.values)
        exact = super().compare(view, unknowns, replace(readings, values=np.where(is_stated, readings.values, 0.0)))
        none = np.zeros((len(readings), 6, len(unknowns)))
        return Comparison(
            np.where(is_stated, exact.residuals, 0.0), np.where(is_stated[:, :, None], exact.by_twist, 0.0), none
        )


def _brought_into_sight(robot: Robot, first: Poses, generator: np.random.Generator) -> FloatArray:
    """Joint values (n, n_actuated) near those of `first`, moved to where instruments can read if they define where.

    Several such instruments share the poses evenly.
    """
    seeing = [
        (own, sights)
        for own in robot.instruments
        if isinstance(own, FrameInstrument) and (sights := own.sights(len(first), generator)) is not None
    ]
    stand_ins, wanted = dict[str, Instrument](), dict[str, Readings]()
    for k, (own, sights) in enumerate(seeing):
        frames, visits = own.pairs(MEASUREMENT_FRAME), np.arange(k, len(first), len(seeing))
        stand_ins[own.name] = _MutualPose(own.name, own.target, frames=frames, noise=own.noise, unknowns=own.unknowns)
        turned = np.isfinite(sights.rotation).all(axis=(1, 2))
        goals = np.hstack([sights.translation, np.full((len(first), 3), np.nan)])
        goals[turned, 3:] = rotation_vectors(sights.rotation[turned])
        pairs = generator.integers(len(frames), size=len(first))
        wanted[own.name] = Readings(visits, pairs[visits], goals[visits], None, np.zeros((len(visits), 0)))
    instruments = tuple(stand_ins.get(own.name, own) for own in robot.instruments)
    return (
        touching_configurations(replace(robot, instruments=instruments), first, wanted)[0] if wanted else first.joints
    )


def _poses(robot: Robot, joints: FloatArray) -> Poses:
    names = tuple(str(k + 1) for k in range(len(joints)))
    return Poses(joints, tuple(f"sampled pose {name}" for name in names), names, "sampled poses", (), robot=robot)

"""A robot aligned with another: base and tools are moved until the two agree best at the same joint values.

Where the place of the measurement frame, or of a tool on its link, is unknown, readings cannot tell an error that moves
all positions as one body, or the tool on its link, from that place. So a nominal robot is compared with a calibrated
one without such common motion. Let x be the positions of its targets over a set of poses, b and w a shift and a turn of
all of them about their centroid c, t a shift of a tool on its link (and u a turn of it, where that is unknown too), and
L the robot's characteristic length. The motion m = (b, L w, t, L u) of the nominal robot makes

    mean over poses and targets of  |x_calibrated - x(m)|^2  (+ L^2 |turn between them|^2 where u is unknown)

smallest. Motions that hardly move its positions are left out, such as the base moved one way and the tool the other way
on a platform that never turns: m = V z, with V the right singular vectors of the derivative A of x by m (a root mean
square over poses and targets) whose singular values are above 0.03.

For a small change d of the parameters of the calibrated robot, with J the derivative of its positions by them, z
follows by z = (A V)^+ J d, so that at other poses (A', J') its positions move by (J' - A' V (A V)^+ J) d without common
motion. A is computed from the nominal robot, and so known.

When it fails. The fewer the poses, the more uncertain the motion; the uncertainty counts that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.instruments.rotations import rotation_vectors
from calib.core.numerics import linalg
from calib.core.numerics.rigid import cross_matrices
from calib.core.robots.configurations import Configurations
from calib.core.robots.jacobian import relative_poses
from calib.core.robots.mechanism import RelativeFrame
from calib.core.robots.robot import Robot

_HARDLY_MOVES = 0.03  # a motion is left out if positions move less per unit of it [m per m]
_ROUNDS = 50
_CONVERGED = 1e-12  # motion left [m]


@dataclass(frozen=True)
class UnknownPlaces:
    """Unknown components of base and tools.

    Attributes:
        base: Whether the measurement frame is unknown.
        counts: Indices of the targets that are to agree, among all.
        points: Indices of these targets whose position on their link is unknown.
        frames: Indices of these targets whose orientation on their link is unknown.
    """

    base: bool
    counts: tuple[int, ...]
    points: tuple[int, ...]
    frames: tuple[int, ...]

    @staticmethod
    def from_robot(robot: Robot) -> UnknownPlaces:
        """Return the unknown components of base and tools, by the description.

        The measurement frame is known where some instrument looks from a known place outside the base at something that
        motors move (or the other way round).
        """
        mechanism, names = robot.mechanism, ("", *robot.mechanism.origin_names)
        free = zip(robot.parameters, robot.is_free, strict=True)
        unknown = [tuple(p.name.rpartition(".")[::2]) for p, is_free in free if p.placement and is_free]
        looked = [
            pair
            for instrument in robot.instruments
            if any(part.dimension != "angle" for part in instrument.parts)
            for pair in robot.pairs[instrument.name]
        ]
        moved = mechanism.support @ np.any(mechanism.select_moving, axis=1) > 0

        def holds(pair: RelativeFrame) -> bool:
            standing = names[pair.a if moved[pair.b] else pair.b]
            return bool(moved[pair.a] != moved[pair.b]) and standing not in {origin for origin, _ in unknown}

        seen = {place for pair in looked for place in (pair.a, pair.b)}
        tools = {
            t: mechanism.targets[t] for t in robot.reported_targets if mechanism.targets[t] in mechanism.moved_targets
        }
        counts = [t for t, target in tools.items() if target.b in seen] or list(tools)

        def with_unknown(components: tuple[str, ...]) -> tuple[int, ...]:
            origins = {origin for origin, component in unknown if component in components}
            return tuple(t for t in counts if names[tools[t].b] in origins)

        points, frames = with_unknown(("x", "y", "z")), with_unknown(("rx", "ry", "rz"))
        return UnknownPlaces(not any(map(holds, looked)), tuple(counts), points, frames)

    @property
    def n_motions(self) -> int:
        """Number of components of m."""
        return 6 * self.base + 3 * len(self.points) + 3 * len(self.frames)

    @property
    def tools(self) -> list[tuple[int, slice, bool]]:
        """Each motion of a tool: its target, its components of m, and whether it turns."""
        motions = [*((t, False) for t in self.points), *((t, True) for t in self.frames)]
        first = 6 * self.base
        return [(t, slice(first + 3 * k, first + 3 * k + 3), turns) for k, (t, turns) in enumerate(motions)]


@dataclass(frozen=True, eq=False)
class CommonMotion(ReadOnlyArrays):
    """A robot aligned with another one; symbols as in the module docstring.

    Attributes:
        robot: The robot, with base and tools moved.
        joints: The poses, (n, n_actuated) [m or rad].
        centre: c, (3,) [m].
        basis: V, (n_motions, k); no columns where nothing was moved.
    """

    robot: Robot
    loose: UnknownPlaces
    joints: FloatArray
    centre: FloatArray
    basis: FloatArray

    @staticmethod
    def from_robots(robot: Robot, onto: Robot, loose: UnknownPlaces, joints: FloatArray) -> CommonMotion:
        """Align a robot with another at poses that both can assemble, (n, n_actuated) [m or rad].

        Its `loose` places are moved, starting from their values in the other robot.
        """
        motion = CommonMotion(robot, loose, joints, np.zeros(3), np.zeros((loose.n_motions, 0)))
        if not (len(joints) and loose.counts and loose.n_motions):
            return motion
        placements = {name: onto.mechanism.placement(name) for name in motion._origins()}
        robot = replace(robot, mechanism=robot.mechanism.with_placements(placements))
        positions, rotations = target_poses(onto, onto.assemble(joints))
        centre = positions[:, loose.counts].mean(axis=(0, 1))
        motion = replace(motion, robot=robot, centre=centre, basis=np.eye(loose.n_motions))
        configurations = robot.assemble(joints)  # no place of base or tool is part of a loop
        rows = motion._fitted_rows(motion.columns(*target_poses(robot, configurations)))
        _, values, right = linalg.svd(rows / np.sqrt(len(joints) * len(loose.counts)), full_matrices=False)
        motion = replace(motion, basis=right[values > _HARDLY_MOVES].T)
        for _ in range(_ROUNDS):
            x, turned = target_poses(motion.robot, configurations)
            turns = rotation_vectors((rotations @ turned.swapaxes(2, 3)).reshape(-1, 3, 3)).reshape(x.shape)
            off = np.concatenate([positions - x, turns], axis=2)[..., None]
            step = motion._best_motion(motion.columns(x, turned), off)[:, 0]
            motion = replace(motion, robot=motion._move_robot(motion.basis @ step))
            if np.max(np.abs(step), initial=0.0) < _CONVERGED:
                break
        return motion

    @cached_property
    def _slope(self) -> FloatArray:
        """A V at the poses, (n, n_targets, 6, k)."""
        return self.columns(*target_poses(self.robot, self.robot.assemble(self.joints)))

    def following(self, jacobian: FloatArray) -> FloatArray:
        """Return dz/d(parameters of `onto`), (k, n_parameters), from J with turns (n, n_targets, 6, n_parameters)."""
        return self._best_motion(self._slope, jacobian)

    def columns(self, positions: FloatArray, rotations: FloatArray) -> FloatArray:
        """Return A V, the motion of targets with z, (n, n_targets, 6, k), at their positions (n, n_targets, 3) [m]."""
        (n, n_targets, _), length, loose = positions.shape, self.robot.mechanism.length, self.loose
        columns = np.zeros((n, n_targets, 6, loose.n_motions))
        if loose.base:
            columns[:, :, :3, :3] = np.eye(3)
            arms = (positions - self.centre).reshape(-1, 3)
            columns[:, :, :3, 3:6] = -cross_matrices(arms).reshape(n, n_targets, 3, 3) / length
            columns[:, :, 3:, 3:6] = np.eye(3) / length
        for t, place, turns in loose.tools:
            columns[:, t, slice(3, 6) if turns else slice(3), place] = rotations[:, t] / (length if turns else 1.0)
        return columns @ self.basis

    def _best_motion(self, columns: FloatArray, changes: FloatArray) -> FloatArray:
        """The z whose motion comes nearest to changes (n, n_targets, 6, m), (k, m)."""
        return np.asarray(linalg.lstsq(self._fitted_rows(columns), self._fitted_rows(changes), rcond=None))

    def _fitted_rows(self, columns: FloatArray) -> FloatArray:
        parts = [columns[:, self.loose.counts, :3], self.robot.mechanism.length * columns[:, self.loose.frames, 3:]]
        return np.concatenate([part.reshape(-1, columns.shape[3]) for part in parts])

    def _move_robot(self, motion: FloatArray) -> Robot:
        mechanism, loose, length = self.robot.mechanism, self.loose, self.robot.mechanism.length
        moves = dict.fromkeys(self._origins(), pin.SE3.Identity())
        if loose.base:
            turn = pin.exp3(motion[3:6] / length)
            shift = self.centre + motion[:3] - turn @ self.centre
            moves[self._base] = pin.SE3(turn, shift).inverse()  # the origin is the frame seen from the robot
        for t, place, turns in loose.tools:
            turn, shift = (pin.exp3(motion[place] / length), np.zeros(3)) if turns else (np.eye(3), motion[place])
            moves[self._tool(t)] = moves[self._tool(t)] * pin.SE3(turn, shift)
        placed = {name: mechanism.placement(name) * move for name, move in moves.items()}
        return replace(self.robot, mechanism=mechanism.with_placements(placed))

    def _origins(self) -> list[str]:
        tools = sorted({*self.loose.points, *self.loose.frames})
        return [*([self._base] if self.loose.base else []), *map(self._tool, tools)]

    @property
    def _base(self) -> str:
        return self.robot.mechanism.origin_names[self.robot.mechanism.targets[0].a - 1]

    def _tool(self, t: int) -> str:
        return self.robot.mechanism.origin_names[self.robot.mechanism.targets[t].b - 1]


def target_poses(robot: Robot, configurations: Configurations) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, n_targets, 3) [m] and rotations (n, n_targets, 3, 3) of the targets."""
    mechanism = robot.mechanism
    poses = relative_poses(mechanism, configurations, mechanism.targets).swapaxes(0, 1)
    return poses[..., :3, 3], poses[..., :3, :3]

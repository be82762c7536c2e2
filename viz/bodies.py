"""The motion of the drawn robot: every link's pose at every joint value, of the calibrated robot and of a ghost.

The page computes poses itself, from joint values, so that 5000 poses cost kilobytes. It needs the tree of joints
and two robots: `solid` (calibrated) and `ghost` (nominal), with loops solved by `calib` at every pose.

Real differences between the two are invisible, so the ghost is exaggerated like a deformed structure in a plot of
finite elements: every point of the robot is displaced by `factor` times its own displacement from solid to ghost,

    M(factor) = M_solid + factor (M_ghost - M_solid)        for the 4x4 matrices of each link.

A point that two links share in both robots is shared at every factor, because the map is linear in the points: the
loops stay closed, exactly. (Scaling parameters instead would meet singular poses; rotating links rigidly would tear
joints.) At large factors links look stretched or sheared; factor 1 is the true nominal robot, 0 the calibrated one.

If the measurement frame is unknown, its pose trades against small errors of all links and can move far. The ghost then
stands on the solid robot's base (`root`), so that only the robots are compared.

Shapes have the lengths of the nominal URDF, but calibrated links have other lengths. So shapes are stretched to the
calibrated joint origins: M = T S, where the affine S moves each child's nominal origin to its calibrated place and
keeps the link's own. This is exact for up to three children in general position; else least squares leave a part of the
errors (under 0.4 mm on a robot with errors of 2 mm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib import Robot
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.numerics import linalg
from calib.core.robots.mechanism import Mechanism

_FLATTEST = 0.05  # a link is not stretched along a direction in which its joint origins spread less


@dataclass(frozen=True, eq=False)
class PosedRobot:
    """A robot in all shown poses.

    Attributes:
        placements: Pose of each joint in its parent link, (n_joints, 4, 4) [m].
        stretches: S of each body, (n_joints + 1, 4, 4); body 0 is the root link.
        values: Joint values in each pose, (n_poses, n_moving) [m or rad].
        root: Pose of the root link in the measurement frame, (4, 4) [m]; None: from the robot's base.
    """

    placements: FloatArray
    stretches: FloatArray
    values: FloatArray
    root: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Bodies:
    """The tree of joints. Body i + 1 is moved by joint i; body 0 is the root link.

    Attributes:
        names: Link name of each body, (n_joints + 1,); in brackets if it is no link of the URDF (measurement frame,
            targets).
        parents: Parent body of each joint, (n_joints,).
        sliding: Whether each joint is prismatic.
        axes: Unit axis of each joint, zero for a fixed joint, (n_joints, 3).
        columns: Column of `PosedRobot.values` that moves each joint, -1 for a fixed joint, (n_joints,).
        base: Body of the measurement frame.
    """

    names: tuple[str, ...]
    parents: IntArray
    sliding: tuple[bool, ...]
    axes: FloatArray
    columns: IntArray
    base: int

    @property
    def moving(self) -> IntArray:
        """Indices of moving joints in the order of the columns, (n_moving,)."""
        return np.flatnonzero(self.columns >= 0)

    def poses(self, robot: PosedRobot, pose: int | slice | IntArray) -> FloatArray:
        """Return T of each body in the measurement frame, (..., n_joints + 1, 4, 4) [m], for one or several poses."""
        values = robot.values[pose]
        T = np.tile(np.eye(4), (*values.shape[:-1], len(self.names), 1, 1))
        for i, parent in enumerate(self.parents):
            motion = np.tile(np.eye(4), (*values.shape[:-1], 1, 1))
            if self.columns[i] >= 0:
                along = np.multiply.outer(values[..., self.columns[i]], self.axes[i])
                if self.sliding[i]:
                    motion[..., :3, 3] = along
                else:
                    motion[..., :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(along).as_matrix()
            T[..., i + 1, :, :] = T[..., parent, :, :] @ robot.placements[i] @ motion
        root = np.linalg.inv(T[..., [self.base], :, :]) if robot.root is None else robot.root
        return np.asarray(root @ T)

    def matrices(self, robot: PosedRobot, pose: int | slice | IntArray) -> FloatArray:
        """Return M = T S of each body, (..., n_joints + 1, 4, 4) [m], as `poses` does."""
        return np.asarray(self.poses(robot, pose) @ robot.stretches)


def links_of_bodies(robot: Robot) -> dict[int, str]:
    """Return the link of each body, by the body's index; bodies that are no link of the URDF have none."""
    links: dict[int, str] = {}
    for name, index in robot.mechanism.frames.items():
        if name in robot.urdf.links:
            links.setdefault(index, name)
    return links


def bodies_of(robot: Robot) -> Bodies:
    """Return the tree of a robot's mechanism."""
    mechanism, links = robot.mechanism, links_of_bodies(robot)
    joints = {joint.name: joint for joint in robot.urdf.joints}
    moves = np.any(mechanism.select_actuated != 0, axis=1) | np.any(mechanism.select_passive != 0, axis=1)
    moves |= mechanism.constant != 0
    columns = np.where(moves, np.cumsum(moves) - 1, -1)
    axes = np.where(moves[:, None], mechanism.axes[:, :3] + mechanism.axes[:, 3:], 0.0)
    sliding = [name in joints and joints[name].type == "prismatic" for name in mechanism.origin_names]
    names = tuple(links.get(i, f"({mechanism.origin_names[i - 1]})") for i in range(mechanism.n_joints + 1))
    parents = np.array(mechanism.model.parents[1 : mechanism.n_joints + 1], dtype=np.intp)
    return Bodies(names, parents, tuple(sliding), axes, columns, mechanism.targets[0].a)


def posed_robot(robot: Robot, bodies: Bodies, joints: FloatArray) -> PosedRobot:
    """Return a robot at actuated joints (n, n_actuated) [m or rad], loops solved.

    Raises:
        UnreachablePoseError: A loop cannot be closed.
    """
    configurations = robot.assemble(joints)
    mechanism = robot.mechanism
    values = mechanism.all_joints(configurations.actuated, configurations.passive)[:, bodies.moving]
    placements = _placements(mechanism)
    return PosedRobot(placements, _stretches(robot, bodies, placements), values)


def _placements(mechanism: Mechanism) -> FloatArray:
    return np.array([mechanism.model.jointPlacements[i + 1].homogeneous for i in range(mechanism.n_joints)]).reshape(
        -1, 4, 4
    )


def _stretches(robot: Robot, bodies: Bodies, placements: FloatArray) -> FloatArray:
    """S of the module docstring, fitted to each body's own origin and its children's origins in the URDF."""
    stretches = np.tile(np.eye(4), (len(bodies.names), 1, 1))
    nominal = _placements(robot.nominal)
    in_urdf = np.array([name in {joint.name for joint in robot.urdf.joints} for name in robot.mechanism.origin_names])
    for body in range(len(bodies.names)):
        children = np.flatnonzero((bodies.parents == body) & in_urdf)
        points = nominal[children, :3, 3]
        moved = placements[children, :3, 3] - points
        size = float(np.max(np.linalg.norm(points, axis=1), initial=0.0))
        if size == 0.0 or not np.any(moved):
            continue
        positions = np.vstack([np.append(points / size, np.ones((len(points), 1)), axis=1), [0.0, 0.0, 0.0, 1.0]])
        displacements = np.vstack([moved, np.zeros(3)])
        solution = linalg.pinv(positions, rcond=_FLATTEST) @ displacements
        stretches[body, :3, :3] += solution[:3].T / size
        stretches[body, :3, 3] = solution[3]
    return stretches

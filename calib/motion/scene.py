"""The scene: all shapes of a robot and its surroundings, the pairs to check, and their distances.

coal computes distances with Pinocchio's `GeometryModel`. The clearance of a pair is subtracted: below zero, it
collides.

How much nearer can a pair come while joints move? Joint j, between the links of shapes a and b, turns one of them about
its axis. No point of this shape is farther from the axis than

    R_j = sum of the lengths of the following origins (and of slides) + radius of the shape about its link

so the distance changes by at most sum_j R_j |dq_j|, with R_j = 1 for a sliding joint. This bound holds for any path
between two configurations on which each joint j moves by at most |dq_j|.
`calib.motion.planner` proves moves free by it.

Reference: schwarzer2005.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.robots.configurations import distances, solve_configurations
from calib.core.robots.robot import Robot
from calib.motion.shapes import Body, Solid, bodies_of, is_inside

Pairs = tuple[tuple[int, int], ...]
_EXACT = 1e-6  # error of distances [m]
_ROUGH = 0.005
"""Triangles are measured only if the distance of their hulls minus the clearance is less than this [m]."""

_ROUND = 1e-9  # rounding of joint limits [m or rad]


@dataclass(frozen=True, eq=False)
class CollisionScene:
    """Shapes, and the pairs of shapes whose distances are computed.

    Attributes:
        pairs: Indices of the two shapes of each pair.
        remarks: Notes on the shapes of links, and on unchecked pairs.
        without_clearance: Pairs that keep no clearance.
    """

    robot: Robot
    bodies: tuple[Body, ...]
    pairs: Pairs
    remarks: tuple[str, ...] = ()
    without_clearance: frozenset[tuple[int, int]] = frozenset()

    def select_pairs(self, chosen: BoolArray) -> CollisionScene:
        """Return the scene with the chosen pairs, (n_pairs,)."""
        return replace(self, pairs=tuple(pair for pair, keep in zip(self.pairs, chosen, strict=True) if keep))

    def with_remarks(self, *remarks: str) -> CollisionScene:
        """Return the scene with further remarks."""
        return replace(self, remarks=self.remarks + remarks)

    @property
    def has_described(self) -> BoolArray:
        """Mask of the pairs with a shape of the description, (n_pairs,)."""
        return np.array([any(self.bodies[k].is_described for k in pair) for pair in self.pairs], dtype=bool)

    def name(self, pair: int) -> str:
        """Return the name of a pair."""
        a, b = (self.bodies[k].name for k in self.pairs[pair])
        return f"{a} - {b}"

    @cached_property
    def workspace(self) -> tuple[Any, Any, Any]:
        """Pinocchio's model of the shapes, its data, and the data of the robot's model."""
        geometry = pin.GeometryModel()
        for k, body in enumerate(self.bodies):
            geometry.addGeometryObject(pin.GeometryObject(f"{k}", body.joint, body.placement, body.solid.hull))
        for a, b in self.pairs:
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        data = pin.GeometryData(geometry)
        for request, rough in zip(data.distanceRequests, self._is_rough, strict=True):
            request.enable_signed_distance = not rough  # penetration depth is irrelevant for hulls of meshes
        return geometry, data, self.robot.mechanism.model.createData()

    @cached_property
    def margins(self) -> FloatArray:
        """Clearance of each pair less the error of distances, so that a gap as wide as it is free, (n_pairs,) [m]."""
        kept = [max(self.bodies[a].clearance, self.bodies[b].clearance) for a, b in self.pairs]
        return np.where([pair in self.without_clearance for pair in self.pairs], 0.0, np.maximum(kept, _EXACT) - _EXACT)

    @cached_property
    def _is_rough(self) -> BoolArray:
        """Whether a shape of each pair is only approximated by its hull, (n_pairs,)."""
        return np.array([any(self.bodies[k].solid.mesh is not None for k in pair) for pair in self.pairs], dtype=bool)

    def configurations(self, q: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return all joints (n, n_joints) [m or rad] at commands q (n, n_actuated), and the mask of closed loops (n,).

        Loops near a singularity count as open.
        """
        mechanism = self.robot.mechanism
        if not mechanism.loops and not self.robot.terms:
            return mechanism.all_joints(mechanism.without_tilts(q), np.zeros((len(q), 0))), np.ones(len(q), dtype=bool)
        closed = self.robot.close(q)
        ok = np.array(closed.ok)
        if mechanism.loops and np.any(ok):
            good = np.flatnonzero(ok)
            near = distances(self.robot, solve_configurations(self.robot, q[good], closed.select(good)))
            ok[good[near < self.robot.description.singularity_limit]] = False
        configurations = solve_configurations(self.robot, q, closed)
        return mechanism.all_joints(configurations.actuated, np.where(ok[:, None], configurations.passive, 0.0)), ok

    def distances(
        self, joints: FloatArray, counted_pairs: BoolArray | None = None, *, thorough: bool = True
    ) -> FloatArray:
        """Return the distance of each pair minus its clearance, (n, n_pairs) [m].

        For meshes more than a few millimetres apart it is the distance of their hulls, a lower bound.

        Args:
            joints: Configurations, (n, n_joints) [m or rad].
            counted_pairs: Mask of pairs in each configuration, (n, n_pairs); others are infinitely far. None: all.
            thorough: Whether to find a mesh inside another mesh; no path from outside leads there without contact.
        """
        geometry, data, workspace = self.workspace
        result = np.full((len(joints), len(self.pairs)), np.inf)
        for k, q in enumerate(joints):
            pairs = None if counted_pairs is None else np.flatnonzero(counted_pairs[k])
            if pairs is None or 2 * len(pairs) > len(self.pairs):
                pin.computeDistances(self.robot.mechanism.model, workspace, geometry, data, q)
                result[k] = [each.min_distance for each in data.distanceResults]
            else:
                pin.updateGeometryPlacements(self.robot.mechanism.model, workspace, geometry, data, q)
                for pair in pairs.tolist():
                    result[k, pair] = pin.computeDistance(geometry, data, pair).min_distance
            result[k] -= self.margins
            for pair in np.flatnonzero(self._is_rough & (result[k] <= _ROUGH)).tolist():
                result[k, pair] = self._exact(pair, result[k, pair], data.oMg, thorough)
        return result if counted_pairs is None else np.where(counted_pairs, result, np.inf)

    def _exact(self, pair: int, of_hulls: float, placed: Any, thorough: bool) -> float:
        """Distance of the triangles of a pair minus its clearance [m]."""
        a, b = self.pairs[pair]
        one, other = self.bodies[a].solid, self.bodies[b].solid
        if any(isinstance(solid.hull, coal.Halfspace) for solid in (one, other)):
            return of_hulls  # a plane touches a hull at a point of its shape
        shapes = [solid.hull if solid.mesh is None else solid.mesh for solid in (one, other)]
        T = [coal.Transform3s(placed[k].rotation, placed[k].translation) for k in (a, b)]
        margin = float(self.margins[pair])
        apart = coal.distance(shapes[0], T[0], shapes[1], T[1], coal.DistanceRequest(), coal.DistanceResult())
        if thorough and apart > 0 and of_hulls < -margin:
            for outer, inner, to_outer in (
                (one, other, placed[a].actInv(placed[b])),
                (other, one, placed[b].actInv(placed[a])),
            ):
                if len(outer.corners) and is_inside(to_outer.act(_point_inside(inner)), outer.corners):
                    return -margin
        return float(apart) - margin

    def reach(self, slides: FloatArray) -> FloatArray:
        """Return R of the module docstring, (n_pairs, n_joints) [m, or 1].

        `slides` are the largest values of prismatic joints, (n_joints,) [m]; other entries are unused.
        """
        mechanism, pairs = self.robot.mechanism, np.array(self.pairs, dtype=np.intp).reshape(-1, 2)
        support, is_slide = mechanism.support, np.linalg.norm(mechanism.axes[:, :3], axis=1) > 0.5
        lengths = np.linalg.norm(mechanism.placements[:, 9:], axis=1) + np.where(is_slide, slides, 0.0)
        follows = support[1:] - np.eye(support.shape[1])  # [k, j]: joint j moves joint k
        joints, radii = (np.array([getattr(body, key) for body in self.bodies]) for key in ("joint", "radius"))
        arms = support[joints] * ((support[joints] * lengths) @ follows + radii[:, None])
        sides = support[joints[pairs]]  # (n_pairs, 2, n_joints)
        moved = np.where(sides[:, 0] != sides[:, 1], arms[pairs[:, 0]] + arms[pairs[:, 1]], 0.0)
        return np.where(is_slide & (moved != 0), 1.0, moved)

    def hits(self, q: FloatArray) -> tuple[str, ...]:
        """Return the name of the pair with the deepest collision at commands q (n, n_actuated), (n,); "" for none."""
        joints, ok = self.configurations(q)
        found = np.full(len(q), "", dtype=object)
        found[~ok] = "loops that do not close"
        if self.pairs and np.any(ok):
            apart = self.distances(joints[ok])
            worst = np.argmin(apart, axis=1)
            touches = apart[np.arange(len(worst)), worst] <= 0
            found[ok] = [self.name(int(pair)) if bad else "" for pair, bad in zip(worst, touches, strict=True)]
        return tuple(found)


def _point_inside(solid: Solid) -> FloatArray:
    """A point of a shape, in its axes, (3,) [m]."""
    if len(solid.corners):
        return solid.corners[0, 0]
    return np.array(solid.hull.points(0)) if hasattr(solid.hull, "points") else np.zeros(3)


def exceeds_limits(robot: Robot, q: FloatArray) -> BoolArray:
    """Return the mask of commands (..., n_actuated) [m or rad] that are outside the joint limits."""
    low, high = robot.joint_limits.T
    return (q < low - _ROUND) | (q > high + _ROUND)


def moving_between(robot: Robot, a: IntArray, b: IntArray) -> IntArray:
    """Return the number of moving joints between the frames a and b (n,), (n,)."""
    mechanism = robot.mechanism
    moves = np.any(mechanism.select_moving != 0, axis=1)
    return np.sum((mechanism.support[a] != mechanism.support[b]) & moves, axis=1)


def all_shapes(robot: Robot) -> CollisionScene:
    """Return all shapes of a robot, with every pair of shapes that can move relative to each other."""
    bodies, remarks = bodies_of(robot)
    frames = np.array([body.joint for body in bodies], dtype=np.intp)
    a, b = np.triu_indices(len(bodies), 1)
    apart = moving_between(robot, frames[a], frames[b]) > 0
    return CollisionScene(robot, bodies, tuple(zip(a[apart].tolist(), b[apart].tolist(), strict=True)), remarks)

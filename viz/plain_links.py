"""Links without shapes of their own, drawn plainly: bodies from joint to joint, and joints by their kind.

A link has anchors: the joint that moves it, the joints that it carries, and the points of loop closures. Its body is a
capsule between two anchors and the hull around more, so that a leg reaches from its base joint to its platform joint;
of the link that stands, capsules around the anchors. Widths follow from the robot's own distances.

A prismatic joint is a sleeve, and its link reaches back into it, by the joint's value at home. A place where several
axes meet is drawn as one joint: two make a universal joint, three a ball, as does a loop closure in three directions.

Passive joints that slide and turn at one place, such as six between base and platform, are no mechanism: loops hold
their links. Neither they nor the links between them are drawn.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
import scipy

from calib import Robot
from calib.core.base.arrays import FloatArray
from calib.core.numerics import linalg
from viz.bodies import links_of_bodies
from viz.shapes import DARK, GREY, Colour, Shape, rod, rotation_onto_z, translation

_RADIUS = 0.05  # of the root mean square of distances between two anchors
_THIN = 0.6  # factor on the radius of bodies that passive joints move, such as rods
_SAME = 1e-3  # of the robot's length: anchors that are closer coincide
_TURNING = ("revolute", "continuous")
_BALL = np.array([way for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_BALL /= np.linalg.norm(_BALL, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class PlainLinks:
    """Plain shapes of a robot's links."""

    robot: Robot

    def shapes(self, link: str) -> list[Shape]:
        """Return the plain shapes of a link: its body, the joint that moves it, and the loop closures on it."""
        if link in self._floating:
            return []
        return [*self.body(link), *self._joint(link), *self._closures(link)]

    def body(self, link: str) -> list[Shape]:
        """Return the body of a link between its anchors; empty for a single anchor."""
        anchors = self._anchors(link)
        moved_by = self._moving_joints.get(link)
        passive = moved_by is not None and moved_by.name in self.robot.mechanism.passive
        radius = self._radius * (_THIN if passive else 1.0)
        if len(anchors) < 2:
            return []
        if len(anchors) == 2:
            return _capsule(f"{link}/body", link, anchors[0], anchors[1], radius)
        if moved_by is None:  # a frame: what moves and is measured within it is seen
            from_middle = anchors - anchors.mean(axis=0)
            along, across = (from_middle @ linalg.svd(from_middle)[2][:2].T).T
            ring = anchors[np.argsort(np.arctan2(across, along), kind="stable")]
            sides = zip(ring, np.roll(ring, -1, axis=0), strict=True)
            return [part for k, ends in enumerate(sides) for part in _capsule(f"{link}/side{k}", link, *ends, radius)]
        points = (anchors[:, None] + radius * _BALL).reshape(-1, 3)
        hull = scipy.spatial.ConvexHull(points)
        a, b, c = points[hull.simplices].transpose(1, 0, 2)
        inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
        faces = np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
        return [Shape(f"{link}/body", link, "mesh", vertices=points, faces=faces)]

    @cached_property
    def _moving_joints(self) -> dict[str, Any]:
        """The joint that moves each link, by the link's name."""
        return {joint.child: joint for joint in self.robot.urdf.joints}

    @cached_property
    def _carries(self) -> dict[str, list[Any]]:
        """The joints that each link carries, by the link's name."""
        carried: dict[str, list[Any]] = {}
        for joint in self.robot.urdf.joints:
            carried.setdefault(joint.parent, []).append(joint)
        return carried

    @cached_property
    def _home(self) -> dict[str, float]:
        mechanism = self.robot.mechanism
        configurations = self.robot.assemble(self.robot.home[None, :])
        values = mechanism.all_joints(configurations.actuated, configurations.passive)[0]
        return dict(zip(mechanism.origin_names, values.tolist(), strict=True))

    @cached_property
    def _floating(self) -> frozenset[str]:
        """Links between passive joints that slide and turn at one place."""
        return frozenset(
            joint.parent for run in map(self._run, self._moving_joints) if self._floats(run) for joint in run[1:]
        )

    def _run(self, link: str) -> list[Any]:
        """The joints at one place that move a link, from base to tip; the link's own joint is the last."""
        run: list[Any] = []
        while link in self._moving_joints and self._moving_joints[link].type != "fixed":
            joint = self._moving_joints[link]
            run.insert(0, joint)
            if np.linalg.norm(joint.xyz) > self._largest_difference or len(self._carries[joint.parent]) > 1:
                break
            link = joint.parent
        return run

    def _floats(self, run: list[Any]) -> bool:
        """Whether joints at one place let a link slide and turn freely."""
        sliding = [joint for joint in run if joint.type == "prismatic"]
        return len(sliding) > 1 and all(joint.name in self.robot.mechanism.passive for joint in run)

    @property
    def _largest_difference(self) -> float:
        return _SAME * float(self.robot.mechanism.length)

    @cached_property
    def _closing_links(self) -> dict[str, list[str]]:
        """Loop closures by link: `ball`, or `drum` if the link still turns about one axis."""
        links, closed = links_of_bodies(self.robot), dict[str, list[str]]()
        for loop in self.robot.mechanism.loops:
            kind = "" if loop.full_pose else "ball" if len(loop.rows) == 3 else "drum"
            for index in (loop.a, loop.b):
                if index in links:
                    closed.setdefault(links[index], []).append(kind if index == loop.a else "")
        return closed

    def _anchors(self, link: str) -> FloatArray:
        """Points at which joints and loops hold a link, in its frame, (n, 3) [m]."""
        points: list[FloatArray] = []
        run = self._run(link)
        if link in self._moving_joints and (link in self._closing_links or not self._floats(run)):
            points.append(np.zeros(3))
        for joint in self._carries.get(link, []):
            if self._floats(self._longest_run(joint)):
                continue
            points.append(np.array(joint.xyz, dtype=float))
            if joint.type == "prismatic":  # the sleeve
                points.append(points[-1] + 0.5 * self._prismatic_offset(joint, in_parent=True))
        if link in self._moving_joints and self._moving_joints[link].type == "prismatic" and points:
            points.append(-self._prismatic_offset(self._moving_joints[link], in_parent=False))
        if link not in self._moving_joints and len(points) < 2:  # an arm stands on its root link's origin
            points.append(np.zeros(3))
        kept: list[FloatArray] = []
        for point in points:
            if all(np.linalg.norm(point - other) > self._largest_difference for other in kept):
                kept.append(point)
        return np.array(kept).reshape(-1, 3)

    def _prismatic_offset(self, joint: Any, *, in_parent: bool) -> FloatArray:
        """Displacement of a prismatic joint at home, (3,) [m], in the frame of its parent or of its own link."""
        way = self._home.get(joint.name, 0.0) * np.array(joint.axis, dtype=float)
        return np.asarray(pin.rpy.rpyToMatrix(*joint.rpy) @ way if in_parent else way)

    def _longest_run(self, joint: Any) -> list[Any]:
        """The moving joints at the place of a joint, also those after it."""
        link = joint.child
        while len(self._carries.get(link, [])) == 1:
            following = self._carries[link][0]
            if following.type == "fixed" or np.linalg.norm(following.xyz) > self._largest_difference:
                break
            link = following.child
        return self._run(link)

    @cached_property
    def _radius(self) -> float:
        """Radius of bodies, from the distances between neighbouring joints [m]: long links count more than a wrist."""
        length = float(self.robot.mechanism.length)
        gaps = [float(np.linalg.norm(joint.xyz)) for joint in self.robot.urdf.joints]
        gaps += [abs(self._home.get(joint.name, 0.0)) for joint in self.robot.urdf.joints if joint.type == "prismatic"]
        known = [gap for gap in gaps if gap > 10 * self._largest_difference]
        return _RADIUS * float(np.sqrt(np.mean(np.square(known)))) if known else _RADIUS * length

    def _joint(self, link: str) -> list[Shape]:
        """The joint that moves a link, and an end if nothing follows."""
        radius, run = self._radius, self._run(link)
        if not run:
            end = link in self._moving_joints and link not in self._carries and link not in self._closing_links
            return [Shape(f"{link}/end", link, "box", (1.6 * radius,) * 3, colour=DARK)] if end else []
        joint = run[-1]
        if self._floats(run):
            return []
        along = np.eye(4)
        along[:3, :3] = rotation_onto_z(np.array(joint.axis, dtype=float))
        if joint.type == "prismatic":
            along[:3, 3] = -self._prismatic_offset(joint, in_parent=False) * 0.5
            box = (2.4 * radius, 2.4 * radius, 3.2 * radius)
            return [Shape(f"{link}/sleeve", link, "box", box, along, DARK)]
        turning = [other for other in self._longest_run(run[0]) if other.type in _TURNING]
        if len(turning) > 2:
            return [Shape(f"{link}/ball", link, "sphere", (1.6 * radius,), colour=DARK)]
        size = (1.5 * radius, 3.0 * radius) if len(turning) < 2 else (0.9 * radius, 3.6 * radius)
        return [Shape(f"{link}/drum", link, "cylinder", size, along, DARK)]

    def _closures(self, link: str) -> list[Shape]:
        shapes = []
        for number, kind in enumerate(self._closing_links.get(link, [])):
            name, radius = f"{link}/closure{number}", self._radius
            if kind == "ball":
                shapes.append(Shape(name, link, "sphere", (1.6 * radius,), colour=DARK))
            elif kind == "drum":
                shapes.append(Shape(name, link, "cylinder", (1.5 * radius, 3.0 * radius), colour=DARK))
        return shapes

    def gaps(self, link: str, drawn: list[Shape]) -> list[Shape]:
        """Return capsules to those joints of a link that its own primitive shapes do not reach."""
        shapes = []
        boxes = [shape.corners() for shape in drawn]
        for number, joint in enumerate(self._carries.get(link, [])):
            point = np.array(joint.xyz, dtype=float)
            reached = [np.all(box.min(axis=0) <= point) and np.all(point <= box.max(axis=0)) for box in boxes]
            if joint.type != "fixed" and not any(reached) and np.linalg.norm(point) > self._largest_difference:
                shapes += _capsule(f"{link}/gap{number}", link, np.zeros(3), point, self._radius, drawn[0].colour)
        return shapes


def _capsule(
    name: str, link: str, start: FloatArray, end: FloatArray, radius: float, colour: Colour = GREY
) -> list[Shape]:
    balls = [
        Shape(f"{name}-end{k}", link, "sphere", (radius,), translation(at), colour) for k, at in enumerate((start, end))
    ]
    return [rod(name, link, start, end, radius, colour), *balls]

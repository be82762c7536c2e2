"""Lines of sight: whether an instrument sees its target, past the robot and its surroundings.

A line runs between the two frames of an instrument: camera and points of a board, socket and ball of a ballbar. A
tracker's line starts at the description's `sight`. It has the width of a beam, and ends short of both ends, which are
inside shapes. A shape that hides a line at nearly all poses is at the end of the line; it does not count, and is named
in a remark.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.instruments.kind import FrameInstrument
from calib.core.instruments.pixel import Pixel
from calib.core.robots.described_instruments import MEASUREMENT_FRAME
from calib.core.robots.robot import Robot
from calib.motion.scene import CollisionScene
from calib.motion.surroundings import AcceptanceSection

_SHORT = 0.025  # distance from its ends that a line leaves out [m]
_BEAM = 0.01  # width of a line [m]
_ALWAYS = 0.95  # a line always ends in a shape if it does at this part of the poses
_THINNEST = 1e-6


@dataclass(frozen=True, eq=False)
class SightLine:
    """A line of sight.

    Attributes:
        name: The target, with the instrument if that has a name of its own, such as `board by camera`.
        ends: Joint indices of the two frames.
        points: The ends in these frames, (2, 3) [m].
        width: [m].
        target: Name of the shape at the end of the line, which does not hide itself.
        acceptance: Directions in which the target is visible from the first end, or None.
    """

    name: str
    ends: tuple[int, int]
    points: FloatArray
    width: float
    target: str
    acceptance: AcceptanceSection | None


@dataclass(frozen=True, eq=False)
class Sight:
    """All lines of sight in a scene; `ignored`: lines and shapes that hide them at nearly all poses, by names."""

    scene: CollisionScene
    lines: tuple[SightLine, ...]
    ignored: frozenset[tuple[str, str]] = frozenset()

    def hidden_targets(self, joints: FloatArray) -> list[str]:
        """Return the shape that hides a target in each configuration (n, n_joints) [m or rad], "" for none."""
        return [next(self._hiding_shapes(q), "") for q in joints]

    def _hiding_shapes(self, q: FloatArray) -> Iterator[str]:
        """Shapes that hide a target in a configuration, line by line."""
        for line, ends, turned in self._lines_in_root(q):
            if turned:
                yield f"{line.name} turned away"
            for body in self.shapes_hiding(line, ends):
                yield f"{body} in sight of {line.name}"

    def _lines_in_root(self, q: FloatArray) -> Iterator[tuple[SightLine, FloatArray, bool]]:
        """Lines with their ends in the root link, (2, 3) [m], and whether the target is turned away."""
        model, (geometry, data, workspace) = self.scene.robot.mechanism.model, self.scene.workspace
        pin.forwardKinematics(model, workspace, q)
        pin.updateGeometryPlacements(model, workspace, geometry, data)
        for line in self.lines:
            frames = [workspace.oMi[k] for k in line.ends]
            ends = np.array([frame.act(point) for frame, point in zip(frames, line.points, strict=True)])
            turned = False
            if line.acceptance is not None:
                axis, back = frames[1].rotation @ np.array(line.acceptance.axis), ends[0] - ends[1]
                cosine = axis @ back / max(np.linalg.norm(axis) * np.linalg.norm(back), _THINNEST)
                turned = bool(cosine < np.cos(line.acceptance.angle))
            yield line, ends, turned

    def shapes_hiding(self, line: SightLine, ends: FloatArray) -> Iterator[str]:
        """Yield the shapes that hide a line between two points (2, 3) [m], in the workspace's present configuration."""
        along = ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        free = length - 2 * _SHORT - line.width
        if free <= 0:
            return
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
        beam, place = coal.Capsule(line.width / 2, free), coal.Transform3s(turn, ends.mean(axis=0))
        data = self.scene.workspace[1]
        for k, body in enumerate(self.scene.bodies):
            if body.name == line.target or (line.name, body.name) in self.ignored:
                continue
            T = coal.Transform3s(data.oMg[k].rotation, data.oMg[k].translation)
            if all(
                _touches(shape, T, beam, place) for shape in (body.solid.hull, body.solid.mesh) if shape is not None
            ):
                yield body.name

    def without_ends(self, joints: FloatArray) -> Sight:
        """Return the lines without shapes that hide them in nearly all configurations (n, n_joints), with remarks."""
        count = Counter[tuple[str, str]]()
        for q in joints:
            lines = list(self._lines_in_root(q))  # several of a board have its name
            count.update({(line.name, body) for line, ends, _ in lines for body in self.shapes_hiding(line, ends)})
        ends_in = frozenset(key for key, n in count.items() if n >= _ALWAYS * len(joints))
        remarks = [
            f"{body} nearly always hides {line}, so it is not checked for that line" for line, body in sorted(ends_in)
        ]
        return Sight(self.scene.with_remarks(*remarks), self.lines, ends_in)


def _touches(shape: Any, T: Any, beam: Any, place: Any) -> bool:
    return float(coal.distance(shape, T, beam, place, coal.DistanceRequest(), coal.DistanceResult())) <= 0


def sight_lines(robot: Robot) -> Iterator[SightLine]:
    """Yield the lines of sight of a robot's instruments."""
    mechanism, description = robot.mechanism, robot.description
    stand = description.sight
    for instrument in robot.instruments:
        if not isinstance(instrument, FrameInstrument) or instrument.touches:
            continue
        target = description.targets[instrument.target]
        for a, b in instrument.pairs(MEASUREMENT_FRAME):
            source, width = np.zeros(3), _BEAM
            start = mechanism.places[a]
            if a == MEASUREMENT_FRAME and not instrument.parts[0].is_distance:
                if stand is None:
                    continue
                start = 0 if stand.frame is None else mechanism.joint(stand.frame)
                source, width = np.array(stand.xyz), stand.width
            for point in _points_seen(instrument):
                ends = np.array([source, point])
                name = b if instrument.name == b else f"{b} by {instrument.name}"
                yield SightLine(name, (start, mechanism.places[b]), ends, width, b, target.acceptance)


def _points_seen(instrument: FrameInstrument) -> FloatArray:
    """Points in the target's frame that must be visible: the outermost of a board or body, (n, 3) [m]."""
    if not isinstance(instrument, Pixel):
        return np.zeros((1, 3))
    points = np.array(list(instrument.points_of_body.values()))
    across = points[:, :2] @ np.array([[1.0, 1.0], [1.0, -1.0]])
    return points[np.unique([*across.argmin(axis=0), *across.argmax(axis=0)])]

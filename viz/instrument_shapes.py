"""What a robot is measured with, as shapes: sockets, planes and spheres that it touches, wires, cameras and boards.

They are drawn where the shown robot has them, on the bodies that carry them. Symbols without a size of their own are as
large as suits the robot. Wires lead from their fixed end to the target at some of the poses.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np

from calib import Robot
from calib.base.arrays import FloatArray
from calib.instruments.distance import Distance
from calib.instruments.kind import Instrument
from calib.instruments.pixel import Pixel
from calib.instruments.touch import Touch
from viz.bodies import Bodies, PosedRobot
from viz.shapes import DARK, Colour, Shape, mesh, primitive, rotation_onto_z

_BRASS: Colour = (0.80, 0.58, 0.20, 1.0)
_CLEAR: Colour = (0.80, 0.58, 0.20, 0.4)  # what touches and is touched: errors are drawn inside
_GLASS: Colour = (0.35, 0.60, 0.85, 0.45)
_PAPER: Colour = (0.97, 0.97, 0.95, 1.0)
_WIRES = 12  # that are drawn of each instrument
_POINTS = 400  # of a board that are drawn


def instrument_shapes(robot: Robot) -> tuple[Shape, ...]:
    """Return what touches, measures distances or takes pictures, and what they look at, on the bodies of a robot."""
    shapes = [shape for one in robot.instruments for shape in _shapes_of(one, robot.mechanism.length)]
    return tuple({shape.name: shape for shape in shapes}.values())  # targets that several look at, once


def wires(robot: Robot, bodies: Bodies, solid: PosedRobot) -> tuple[Shape, ...]:
    """Return lines from fixed ends to targets at some of the poses, in the measurement frame."""
    shapes = []
    poses = np.unique(np.linspace(0, len(solid.values) - 1, _WIRES).astype(int))
    placed = [bodies.poses(solid, int(pose)) for pose in poses]
    for one in robot.instruments:
        if isinstance(one, Distance):
            start = bodies.base if one.end is None else bodies.names.index(_body(one.end.name))
            end = bodies.names.index(_body(one.target))
            for pose, T in zip(poses, placed, strict=True):
                name = f"{one.name}/wire{pose}"
                shapes += _rod(name, None, T[start, :3, 3], T[end, :3, 3], 0.001 * robot.mechanism.length, _GLASS)
    return tuple(shapes)


def _body(place: str) -> str:
    """The body of a place that is no link."""
    return f"({place})"


@functools.singledispatch
def _shapes_of(one: Instrument, size: float) -> list[Shape]:
    """Shapes of an instrument beside a robot of this size [m]; none of what is no more than its target."""
    return []


@_shapes_of.register
def _(one: Touch, size: float) -> list[Shape]:
    ball = one.ball or 0.006 * size
    shapes = [_ball(one.target, ball)]
    inside = np.array(one.points_of_artefact or [(0.0, 0.0, 0.0)] * len(one.touched))
    for k, (name, point) in enumerate(zip(one.touched, inside, strict=True)):
        body = _body(one.own[0 if one.points_of_artefact else k].name)
        T, label = _at(point), f"{one.name}/{name}"
        if one.surface == "socket":
            shapes.append(primitive(label, body, "sphere", (1.3 * ball,), T, _CLEAR))
        elif one.surface == "plane":
            shapes.append(primitive(label, body, "box", (0.25 * size, 0.25 * size, 0.002 * size), T, _GLASS))
        else:
            radius = one.radii[0 if one.points_of_artefact else k].value or 0.01
            shapes.append(primitive(label, body, "sphere", (radius,), T, _CLEAR))
    if one.points_of_artefact:
        for k, (start, end) in enumerate(itertools.pairwise(inside)):
            shapes += _rod(f"{one.name}/bar{k}", _body(one.own[0].name), start, end, 0.002 * size, DARK)
    return shapes


@_shapes_of.register
def _(one: Distance, size: float) -> list[Shape]:
    shapes = [_ball(one.target, 0.008 * size)]
    if one.end is not None:
        shapes.append(primitive(f"{one.name}/end", _body(one.end.name), "sphere", (0.01 * size,), np.eye(4), _BRASS))
    return shapes


@_shapes_of.register
def _(one: Pixel, size: float) -> list[Shape]:
    body, depth, thin = _body(one.place.name), 0.2 * size, 0.003 * size
    fx, fy, cx, cy = one.intrinsics[:4]
    width, height = one.image or (2 * cx, 2 * cy)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=float)
    rim = depth * np.column_stack([(corners[:, 0] - cx) / fx, (corners[:, 1] - cy) / fy, np.ones(4)])
    edges = [(np.zeros(3), corner) for corner in rim] + list(zip(rim, np.roll(rim, -1, axis=0), strict=True))
    shapes = [primitive(f"{one.name}/camera", body, "box", (0.05 * size,) * 3, _at([0, 0, -0.025 * size]), DARK)]
    for k, (start, end) in enumerate(edges):
        shapes += _rod(f"{one.name}/edge{k}", body, start, end, thin, _BRASS)
    return [*shapes, *_seen(one, size)]


def _seen(one: Pixel, size: float) -> list[Shape]:
    """The board that a camera sees, with a dark patch at each point; or points alone, as balls."""
    points, body = np.array(list(one.points_of_body.values())), _body(one.target)
    if one.board is None:
        return [
            primitive(f"{one.target}/{name}", body, "sphere", (0.01 * size,), _at(point), _BRASS)
            for name, point in list(one.points_of_body.items())[:_POINTS]
        ]
    side = one.board.smallest
    low, high = points.min(axis=0) - side, points.max(axis=0) + side
    thick = 0.05 * side
    middle = [*(low + high)[:2] / 2, thick]  # z points into the paper
    plate = primitive(f"{one.target}/board", body, "box", (*(high - low)[:2], thick), _at(middle), _PAPER)
    patch = 0.25 * side * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    corners = (points[:_POINTS, None] + patch + [0.0, 0.0, -thick]).reshape(-1, 3)
    first, quad = 4 * np.arange(len(corners) // 4)[:, None], np.array([[0, 1, 2], [0, 2, 3]])
    faces = np.concatenate([first + quad[0], first + quad[1]])
    return [plate, mesh(f"{one.target}/points", body, corners, faces, DARK)]


def _ball(target: str, radius: float) -> Shape:
    return primitive(f"{target}/ball", _body(target), "sphere", (radius,), np.eye(4), _CLEAR)


def _at(point: object) -> FloatArray:
    T = np.eye(4)
    T[:3, 3] = np.asarray(point, dtype=float)
    return T


def _rod(name: str, body: str | None, start: FloatArray, end: FloatArray, radius: float, colour: Colour) -> list[Shape]:
    """A thin cylinder between two points; none where they are one."""
    length = float(np.linalg.norm(end - start))
    if length <= 1e-9:
        return []
    T = _at((start + end) / 2)
    T[:3, :3] = rotation_onto_z((end - start) / length)
    return [primitive(name, body, "cylinder", (radius, length), T, colour)]

"""Instruments as shapes: sockets, planes and spheres that the robot touches, wires, cameras and boards.

They are drawn at their places on the shown robot. The size of symbols without a size of their own follows the robot's.
Wires lead from their fixed end to the target at some of the poses.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np

from calib import Robot
from calib.core.base.arrays import FloatArray, evenly_spread
from calib.core.instruments.kind import FrameInstrument, Instrument
from calib.core.instruments.pixel import Pixel
from calib.core.instruments.touch import Touch
from viz.bodies import Bodies, PosedRobot
from viz.shapes import DARK, Colour, Shape, rod, translation

_BRASS: Colour = (0.80, 0.58, 0.20, 1.0)
_CLEAR: Colour = (0.80, 0.58, 0.20, 0.4)  # for touching and touched shapes: errors are drawn inside them
_GLASS: Colour = (0.35, 0.60, 0.85, 0.45)
_PAPER: Colour = (0.97, 0.97, 0.95, 1.0)
_WIRE: Colour = (*_GLASS[:3], 0.8)
_WIRES = 12  # drawn wires per instrument
_POINTS = 400  # drawn points of a board


def instrument_shapes(robot: Robot) -> tuple[Shape, ...]:
    """Return the shapes of instruments that touch, measure distances or see, and of their targets, on bodies."""
    shapes = [shape for instrument in robot.instruments for shape in _shapes_of(instrument, robot.mechanism.length)]
    return tuple({shape.name: shape for shape in shapes}.values())  # shared targets once


def wires(robot: Robot, bodies: Bodies, solid: PosedRobot) -> tuple[Shape, ...]:
    """Return lines from fixed ends to targets at some of the poses, in the measurement frame."""
    shapes = []
    placed = bodies.poses(solid, evenly_spread(len(solid.values), _WIRES))
    for instrument in robot.instruments:
        pairs = robot.pairs[instrument.name] if _tells_distances(instrument) else ()
        of_first_setup = pairs[: len(pairs) // max(1, len(robot.description.setups))]
        for k, (pair, T) in enumerate(itertools.product(of_first_setup, placed)):
            rod = T[pair.a, :3, 3], T[pair.b, :3, 3], 0.001 * robot.mechanism.length
            shapes += _rod(f"{instrument.name}/wire{k}", None, *rod, _WIRE)
    return (*shapes, *_lines_of_sight(robot, placed))


def _lines_of_sight(robot: Robot, placed: FloatArray) -> list[Shape]:
    """Lines from the description's `sight` to targets, in poses of all bodies (n, n_bodies, 4, 4)."""
    stand = robot.description.sight
    if stand is None:
        return []
    joint, shapes = 0 if stand.frame is None else robot.mechanism.joint(stand.frame), []
    for k, (target, T) in enumerate(itertools.product(robot.mechanism.targets, placed)):
        start = T[joint, :3, :3] @ np.array(stand.xyz) + T[joint, :3, 3]
        shapes += _rod(f"sight{k}", None, start, T[target.b, :3, 3], 0.001 * robot.mechanism.length, _WIRE)
    return shapes


def _tells_distances(instrument: Instrument) -> bool:
    return any(part.is_distance for part in instrument.parts)


def _body(place: str) -> str:
    """Name of the body of a place; brackets keep it apart from links."""
    return f"({place})"


@functools.singledispatch
def _shapes_of(instrument: Instrument, size: float) -> list[Shape]:
    """Shapes of an instrument of a robot of this size [m]; empty if only its target is drawn."""
    return []


@_shapes_of.register
def _(instrument: FrameInstrument, size: float) -> list[Shape]:
    balls = [_ball(instrument.target, 0.008 * size)] if _tells_distances(instrument) else []
    places = [
        Shape(f"{instrument.name}/{place.name}", _body(place.name), "sphere", (0.01 * size,), colour=_BRASS)
        for place in instrument.places()
    ]
    return balls + places


@_shapes_of.register
def _(touch: Touch, size: float) -> list[Shape]:
    ball = touch.ball or 0.006 * size
    shapes = [_ball(touch.target, ball)]
    inside = np.array(touch.points_of_artefact or [(0.0, 0.0, 0.0)] * len(touch.touched))
    for k, (name, point) in enumerate(zip(touch.touched, inside, strict=True)):
        body = _body(touch.own[0 if touch.points_of_artefact else k].name)
        T, label = translation(point), f"{touch.name}/{name}"
        if touch.surface == "socket":
            shapes.append(Shape(label, body, "sphere", (1.3 * ball,), T, _CLEAR))
        elif touch.surface == "plane":
            shapes.append(Shape(label, body, "box", (0.25 * size, 0.25 * size, 0.002 * size), T, _GLASS))
        else:
            radius = touch.radii[0 if touch.points_of_artefact else k].value or 0.01
            shapes.append(Shape(label, body, "sphere", (radius,), T, _CLEAR))
    if touch.points_of_artefact:
        for k, (start, end) in enumerate(itertools.pairwise(inside)):
            shapes += _rod(f"{touch.name}/bar{k}", _body(touch.own[0].name), start, end, 0.002 * size, DARK)
    return shapes


@_shapes_of.register
def _(camera: Pixel, size: float) -> list[Shape]:
    body, depth, thin = _body(camera.place.name), 0.2 * size, 0.003 * size
    fx, fy, cx, cy = camera.intrinsics[:4]
    width, height = camera.image or (2 * cx, 2 * cy)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=float)
    rim = depth * np.column_stack([(corners[:, 0] - cx) / fx, (corners[:, 1] - cy) / fy, np.ones(4)])
    edges = [(np.zeros(3), corner) for corner in rim] + list(zip(rim, np.roll(rim, -1, axis=0), strict=True))
    shapes = [Shape(f"{camera.name}/camera", body, "box", (0.05 * size,) * 3, translation([0, 0, -0.025 * size]), DARK)]
    for k, (start, end) in enumerate(edges):
        shapes += _rod(f"{camera.name}/edge{k}", body, start, end, thin, _BRASS)
    return [*shapes, *_seen_shapes(camera, size)]


def _seen_shapes(camera: Pixel, size: float) -> list[Shape]:
    """The board that a camera sees, with a dark patch at each point; or points alone, as balls."""
    points, body = np.array(list(camera.points_of_body.values())), _body(camera.target)
    if camera.board is None:
        return [
            Shape(f"{camera.target}/{name}", body, "sphere", (0.01 * size,), translation(point), _BRASS)
            for name, point in list(camera.points_of_body.items())[:_POINTS]
        ]
    side = camera.board.smallest
    low, high = points.min(axis=0) - side, points.max(axis=0) + side
    thick = 0.05 * side
    middle = [*(low + high)[:2] / 2, thick]  # z points into the paper
    plate = Shape(f"{camera.target}/board", body, "box", (*(high - low)[:2], thick), translation(middle), _PAPER)
    patch = 0.25 * side * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    corners = (points[:_POINTS, None] + patch + [0.0, 0.0, -thick]).reshape(-1, 3)
    first, quad = 4 * np.arange(len(corners) // 4)[:, None], np.array([[0, 1, 2], [0, 2, 3]])
    faces = np.concatenate([first + quad[0], first + quad[1]])
    return [plate, Shape(f"{camera.target}/points", body, "mesh", vertices=corners, faces=faces, colour=DARK)]


def _ball(target: str, radius: float) -> Shape:
    return Shape(f"{target}/ball", _body(target), "sphere", (radius,), colour=_CLEAR)


def _rod(name: str, body: str | None, start: FloatArray, end: FloatArray, radius: float, colour: Colour) -> list[Shape]:
    """A thin cylinder between two points; none if they coincide."""
    apart = np.linalg.norm(end - start) > 1e-9
    return [rod(name, body, start, end, radius, colour)] if apart else []

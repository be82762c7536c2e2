"""First values of the places of touched things, from the readings of one instrument and the poses of the robot's links.

Sockets s_j and the ball t on its link are linear in R_k t + t_k = s_j. The distance of t from its believed place has a
small weight, so that t does not move far where its link hardly turns. Rotations that carry points onto points are found
by least squares. Where one component of the rotation vector w must stay zero, e_k . w = 0, w is perpendicular to e_k;
the rotation of this kind that carries u to v has the axis e_k x (u - v).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.sections import ANGLE_COMPONENTS, LENGTH_COMPONENTS, OwnLength
from calib.core.instruments.kind import Guess, Scene
from calib.core.instruments.touch_sections import Surface
from calib.core.numerics import linalg
from calib.core.numerics.rigid import best_transform, centre, centre_of_sphere

_TURNS = {"rx", "ry"}
_STAY = 0.03  # weight of a distance from the believed place, over that of an equal error of a touch
_FLAT = 1e-3  # width over length below which points lie on one line


class Touching(Protocol):
    """Interface of an instrument that touches: see `calib.core.instruments.touch.Touch`."""

    @property
    def surface(self) -> Surface:
        """Kind of the touched surfaces."""

    @property
    def named(self) -> tuple[str, ...]:
        """Names of what it touches."""

    @property
    def points_of_artefact(self) -> tuple[tuple[float, float, float], ...]:
        """Points of the artefact [m]; empty where each touched thing has a place of its own."""

    @property
    def ball(self) -> float:
        """Radius of the ball [m]."""

    @property
    def radii(self) -> tuple[OwnLength, ...]:
        """Radii of the spheres."""

    def radius_unknown(self, which: IntArray) -> IntArray:
        """Return the index of the unknown that is the radius of each sphere (n,), (n,); -1 for a known radius."""


def first_touches(touch: Touching, scene: Scene) -> Guess:
    """Return first values of the places that an instrument touches, and of its target.

    Args:
        touch: The instrument.
        scene: Readings, places, and poses of the links.
    """
    if touch.surface == "socket":
        return _sockets(touch, scene)
    return _planes(touch, scene) if touch.surface == "plane" else _spheres(touch, scene)


def _touched_things(scene: Scene) -> tuple[list[tuple[str, int]], IntArray]:
    """Touched things, each once, as (place, detail), and the index of the thing that each reading touched, (n,)."""
    which = scene.readings.details[:, 0].astype(np.intp)
    keys: dict[tuple[str, int], int] = {}
    pairs = zip(scene.readings.pairs.tolist(), which.tolist(), strict=True)
    numbers = [keys.setdefault((scene.pairs[pair][0], detail), len(keys)) for pair, detail in pairs]
    return list(keys), np.array(numbers, dtype=np.intp)


def _sockets(touch: Touching, scene: Scene) -> Guess:
    keys, number = _touched_things(scene)
    targets = list(dict.fromkeys(b for _, b in scene.pairs))
    target = np.array([targets.index(b) for _, b in scene.pairs], dtype=np.intp)[scene.readings.pairs]
    inside = _homogeneous_places(touch)
    believed = np.array([(scene.places[a] @ inside[detail])[:3] for a, detail in keys])
    open_ = _open(scene, [a for a, _ in keys])
    if touch.points_of_artefact:
        open_ = np.array([[bool(scene.unknown[a])] * 3 for a, _ in keys])
    balls = Points(np.array([scene.places[b][:3, 3] for b in targets]), _open(scene, targets))
    positions, ball_positions = sockets_and_targets(scene.links, number, target, Points(believed, open_), balls)
    places = _moved_places(scene, targets, ball_positions)
    if touch.points_of_artefact:
        return Guess(places | _artefacts(touch, scene, keys, positions))
    return Guess(places | _moved_places(scene, [a for a, _ in keys], positions))


def _planes(touch: Touching, scene: Scene) -> Guess:
    keys, number = _touched_things(scene)
    balls, places = _balls(scene), {}
    for k, (a, _) in enumerate(keys):
        lengths = [axis for axis, name in enumerate(LENGTH_COMPONENTS) if name in scene.unknown[a]]
        turns = set(scene.unknown[a]) >= _TURNS
        if lengths or turns:
            along = lengths[0] if lengths else None
            places[a] = plane_through(balls[number == k], scene.places[a], touch.ball, along, turns=turns)
    return Guess(places)


def _spheres(touch: Touching, scene: Scene) -> Guess:
    keys, number = _touched_things(scene)
    balls, unknowns, inside = _balls(scene), scene.unknowns.copy(), _homogeneous_places(touch)
    centres: dict[tuple[str, int], FloatArray] = {}
    radii: dict[int, list[float]] = {}
    for k, (a, detail) in enumerate(keys):
        chosen = balls[number == k]
        size = touch.radii[0 if touch.points_of_artefact else detail]
        known = not size.unknown or size.sigma is not None
        if not scene.unknown[a] or len(chosen) < (3 if known else 4):
            continue
        near = (scene.places[a] @ inside[detail])[:3]
        if known:
            centres[a, detail] = centre(chosen, np.full(len(chosen), size.value + touch.ball), near)
            continue
        centres[a, detail], length = centre_of_sphere(chosen, near)
        if length > touch.ball:
            radii.setdefault(int(touch.radius_unknown(np.array([detail]))[0]), []).append(length - touch.ball)
    for index, estimates in radii.items():
        unknowns[index] = np.mean(estimates)
    fitted, positions = list(centres), np.array(list(centres.values())).reshape(-1, 3)
    if touch.points_of_artefact:
        return Guess(_artefacts(touch, scene, fitted, positions), unknowns)
    return Guess(_moved_places(scene, [a for a, _ in fitted], positions), unknowns)


def _artefacts(
    touch: Touching, scene: Scene, keys: list[tuple[str, int]], positions: FloatArray
) -> dict[str, FloatArray]:
    """Poses of the artefact, in every setup, from positions of its points, (m, 3) [m]."""
    inside, places = _homogeneous_places(touch)[:, :3], {}
    for a in dict.fromkeys(name for name, _ in keys):
        if scene.unknown[a]:
            index = [k for k, (name, _) in enumerate(keys) if name == a]
            turns = [k for k, name in enumerate(ANGLE_COMPONENTS) if name not in scene.unknown[a]]
            points = inside[[keys[k][1] for k in index]]
            fixed_component = turns[0] if len(turns) == 1 else None
            places[a] = posed_artefact(points, positions[index], scene.places[a], fixed_component)
    return places


def _homogeneous_places(touch: Touching) -> FloatArray:
    """Position of each touched thing in its place, in homogeneous coordinates, (m, 4) [m]."""
    points = np.array(touch.points_of_artefact or [(0.0, 0.0, 0.0)] * len(touch.named))
    return np.column_stack([points, np.ones(len(points))])


def _balls(scene: Scene) -> FloatArray:
    """Believed centre of the ball at each reading, in the link of the touched thing, (n, 3) [m]."""
    centres = np.array([scene.places[b][:, 3] for _, b in scene.pairs])[scene.readings.pairs]
    return np.einsum("nij,nj->ni", scene.links, centres)[:, :3]


def _moved_places(scene: Scene, names: list[str], positions: FloatArray) -> dict[str, FloatArray]:
    """Poses of places, moved to these positions, (m, 3) [m]."""
    places = {}
    for name, position in zip(names, positions, strict=True):
        places[name] = scene.places[name].copy()
        places[name][:3, 3] = position
    return places


def _open(scene: Scene, names: list[str]) -> BoolArray:
    """Mask of the unknown coordinates of places, (m, 3)."""
    return np.array([[axis in scene.unknown[name] for axis in LENGTH_COMPONENTS] for name in names], dtype=bool)


@dataclass(frozen=True, eq=False)
class Points:
    """Points of links.

    Attributes:
        xyz: Their known or believed coordinates, (m, 3) [m].
        unknown: Mask of the unknown coordinates, (m, 3).
    """

    xyz: FloatArray
    unknown: BoolArray


def sockets_and_targets(
    links: FloatArray, socket: IntArray, target: IntArray, sockets: Points, targets: Points
) -> tuple[FloatArray, FloatArray]:
    """Return where sockets and targets are, (m, 3) each [m].

    Args:
        links: Link of the target seen from the link of the socket at each touch, (n, 4, 4) [m].
        socket, target: Index of the socket and of the target at each touch, (n,).
        sockets, targets: Their believed positions.
    """
    n_targets, n_sockets = int(targets.unknown.sum()), int(sockets.unknown.sum())
    target_column = np.cumsum(targets.unknown.ravel()).reshape(-1, 3) - 1
    socket_column = n_targets + np.cumsum(sockets.unknown.ravel()).reshape(-1, 3) - 1
    rotation = links[:, :3, :3]
    gap = np.einsum("nij,nj->ni", rotation, targets.xyz[target]) + links[:, :3, 3] - sockets.xyz[socket]
    rows = np.zeros((len(links), 3, n_targets + n_sockets))
    for axis in range(3):
        k = np.flatnonzero(targets.unknown[target, axis])
        rows[k, :, target_column[target[k], axis]] = rotation[k, :, axis]
        k = np.flatnonzero(sockets.unknown[socket, axis])
        rows[k, axis, socket_column[socket[k], axis]] = -1.0
    stay = _STAY * np.eye(n_targets, n_targets + n_sockets)
    both = np.vstack([rows.reshape(-1, n_targets + n_sockets), stay])
    change = linalg.lstsq(both, np.append(-gap.ravel(), np.zeros(n_targets)))
    found_sockets, found_targets = sockets.xyz.copy(), targets.xyz.copy()
    found_targets[targets.unknown] += change[:n_targets]
    found_sockets[sockets.unknown] += change[n_targets:]
    return found_sockets, found_targets


def posed_artefact(points: FloatArray, seen: FloatArray, now: FloatArray, fixed_component: int | None) -> FloatArray:
    """Return the pose of an artefact, (4, 4) [m], from the positions of its points.

    Args:
        points: Points in the frame of the artefact, (m, 3) [m].
        seen: The same points in the link that carries it, (m, 3) [m].
        now: Believed pose, kept where the points do not determine it, (4, 4) [m].
        fixed_component: Component of the rotation vector from `now` that stays zero where the points lie on a line.
    """
    result = now.copy()
    from_centre, seen_from_centre = points - points.mean(axis=0), seen - seen.mean(axis=0)
    _, sizes, directions = linalg.svd(np.vstack([from_centre, np.zeros((2, 3))]))
    if sizes[1] > _FLAT * sizes[0]:
        result[:3, :3] = best_transform(points, seen)[0]
    elif sizes[0] > 0:
        line = directions[0]
        turned_line = now[:3, :3].T @ (seen_from_centre.T @ (from_centre @ line))
        axis = int(np.argmax(np.abs(line))) if fixed_component is None else fixed_component
        result[:3, :3] = now[:3, :3] @ _turn(line, turned_line / np.linalg.norm(turned_line), axis)
    result[:3, 3] = seen.mean(axis=0) - result[:3, :3] @ points.mean(axis=0)
    return result


def _turn(u: FloatArray, v: FloatArray, k: int) -> FloatArray:
    """The rotation (3, 3) that carries u to v, whose rotation vector has no component k."""
    across = np.eye(3)[k]
    axis = np.cross(across, u - v)
    if np.linalg.norm(axis) < 1e-12:  # nothing to turn, or half a turn about the part of u across e_k
        axis = u - across * u[k]
        axis = axis if np.linalg.norm(axis) > 1e-12 else np.eye(3)[k - 1]
    axis /= np.linalg.norm(axis)
    angle = np.arctan2(axis @ np.cross(u, v), u @ v - (axis @ u) * (axis @ v))
    return scipy.spatial.transform.Rotation.from_rotvec(angle * axis).as_matrix()


def plane_through(points: FloatArray, now: FloatArray, radius: float, along: int | None, *, turns: bool) -> FloatArray:
    """Return the pose of a plane that balls lie on, (4, 4) [m].

    Args:
        points: Their centres in the link of the plane, (n, 3) [m].
        now: Believed pose; its z axis points to the side of the balls, (4, 4) [m].
        radius: Radius of the balls [m].
        along: Axis of the link along which the plane may move; None: it stays.
        turns: Whether its normal is to be found.
    """
    result, middle = now.copy(), points.mean(axis=0)
    _, sizes, directions = linalg.svd(np.vstack([points - middle, np.zeros((2, 3))]))
    if turns and sizes[1] > _FLAT * sizes[0]:
        normal = now[:3, :3].T @ directions[2]
        result[:3, :3] = now[:3, :3] @ _turn(np.eye(3)[2], normal * (1.0 if normal[2] >= 0 else -1.0), 2)
    normal = result[:3, 2]
    if along is not None and abs(normal[along]) > _FLAT:
        result[along, 3] += (normal @ (middle - result[:3, 3]) - radius) / normal[along]
    return result

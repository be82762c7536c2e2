"""First values of what is touched: from the readings of one instrument to `calib.observation.first_places`."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.observation.first_places import Points, plane_through, posed_artefact, sockets_and_targets, sphere_through
from calib.observation.kind import Guess, Scene
from calib.observation.lengths import OwnLength
from calib.observation.touch_sections import Surface
from calib.sections import ANGLE_COMPONENTS, LENGTH_COMPONENTS

_TURNS = {"rx", "ry"}


class Touching(Protocol):
    """What is asked of an instrument that touches: see `calib.observation.touch.Touch`."""

    @property
    def surface(self) -> Surface:
        """What sort of surfaces it touches."""

    @property
    def touched(self) -> tuple[str, ...]:
        """Names of what it touches."""

    @property
    def points_of_artefact(self) -> tuple[tuple[float, float, float], ...]:
        """Points of one piece [m]; empty for places of their own."""

    @property
    def ball(self) -> float:
        """Radius of the ball [m]."""

    @property
    def radii(self) -> tuple[OwnLength, ...]:
        """Radii of the spheres."""

    def radius_unknown(self, which: IntArray) -> IntArray:
        """Return which unknown number is the radius of each sphere (n,), -1 for a known one, (n,)."""


def first_touches(touch: Touching, scene: Scene) -> Guess:
    """Return first values of the places that an instrument touches, and of its target.

    Args:
        touch: The instrument.
        scene: What it touched, when.
    """
    if touch.surface == "socket":
        return _sockets(touch, scene)
    return _planes(touch, scene) if touch.surface == "plane" else _spheres(touch, scene)


def _looked(scene: Scene) -> tuple[list[tuple[str, int]], IntArray]:
    """What was touched: name of the place and detail, each once; and which of these each reading is, (n,)."""
    which = scene.readings.details[:, 0].astype(np.intp)
    keys: dict[tuple[str, int], int] = {}
    pairs = zip(scene.readings.pairs.tolist(), which.tolist(), strict=True)
    numbers = [keys.setdefault((scene.pairs[pair][0], detail), len(keys)) for pair, detail in pairs]
    return list(keys), np.array(numbers, dtype=np.intp)


def _sockets(touch: Touching, scene: Scene) -> Guess:
    keys, number = _looked(scene)
    targets = list(dict.fromkeys(b for _, b in scene.pairs))
    target = np.array([targets.index(b) for _, b in scene.pairs], dtype=np.intp)[scene.readings.pairs]
    inside = _in_place(touch)
    believed = np.array([(scene.places[a] @ inside[detail])[:3] for a, detail in keys])
    open_ = _open(scene, [a for a, _ in keys])
    if touch.points_of_artefact:
        open_ = np.array([[bool(scene.unknown[a])] * 3 for a, _ in keys])
    balls = Points(np.array([scene.places[b][:3, 3] for b in targets]), _open(scene, targets))
    found, found_balls = sockets_and_targets(scene.links, number, target, Points(believed, open_), balls)
    places = _moved(scene, targets, found_balls)
    if touch.points_of_artefact:
        return Guess(places | _artefacts(touch, scene, keys, found))
    return Guess(places | _moved(scene, [a for a, _ in keys], found))


def _planes(touch: Touching, scene: Scene) -> Guess:
    keys, number = _looked(scene)
    balls, places = _balls(scene), {}
    for k, (a, _) in enumerate(keys):
        lengths = [axis for axis, name in enumerate(LENGTH_COMPONENTS) if name in scene.unknown[a]]
        turns = set(scene.unknown[a]) >= _TURNS
        if lengths or turns:
            along = lengths[0] if lengths else None
            places[a] = plane_through(balls[number == k], scene.places[a], touch.ball, along, turns=turns)
    return Guess(places)


def _spheres(touch: Touching, scene: Scene) -> Guess:
    keys, number = _looked(scene)
    balls, unknowns, inside = _balls(scene), scene.unknowns.copy(), _in_place(touch)
    centres: dict[tuple[str, int], FloatArray] = {}
    radii: dict[int, list[float]] = {}
    for k, (a, detail) in enumerate(keys):
        chosen = balls[number == k]
        size = touch.radii[0 if touch.points_of_artefact else detail]
        known = not size.unknown or size.sigma is not None
        if not scene.unknown[a] or len(chosen) < (3 if known else 4):
            continue
        near = (scene.places[a] @ inside[detail])[:3]
        centre, length = sphere_through(chosen, near, size.value + touch.ball if known else None)
        centres[a, detail] = centre
        if not known and length > touch.ball:
            radii.setdefault(int(touch.radius_unknown(np.array([detail]))[0]), []).append(length - touch.ball)
    for index, found in radii.items():
        unknowns[index] = np.mean(found)
    seen, positions = list(centres), np.array(list(centres.values())).reshape(-1, 3)
    if touch.points_of_artefact:
        return Guess(_artefacts(touch, scene, seen, positions), unknowns)
    return Guess(_moved(scene, [a for a, _ in seen], positions), unknowns)


def _artefacts(
    touch: Touching, scene: Scene, keys: list[tuple[str, int]], positions: FloatArray
) -> dict[str, FloatArray]:
    """Poses of the artefact, in every setup, from positions of its points, (m, 3) [m]."""
    inside, places = _in_place(touch)[:, :3], {}
    for a in dict.fromkeys(name for name, _ in keys):
        if scene.unknown[a]:
            own = [k for k, (name, _) in enumerate(keys) if name == a]
            turns = [k for k, name in enumerate(ANGLE_COMPONENTS) if name not in scene.unknown[a]]
            points = inside[[keys[k][1] for k in own]]
            held = turns[0] if len(turns) == 1 else None
            places[a] = posed_artefact(points, positions[own], scene.places[a], held)
    return places


def _in_place(touch: Touching) -> FloatArray:
    """Each thing that is touched in its place, as homogeneous coordinates, (m, 4) [m]."""
    points = np.array(touch.points_of_artefact or [(0.0, 0.0, 0.0)] * len(touch.touched))
    return np.column_stack([points, np.ones(len(points))])


def _balls(scene: Scene) -> FloatArray:
    """Where the ball's centre is believed to be at each reading, in the link of what it touches, (n, 3) [m]."""
    own = np.array([scene.places[b][:, 3] for _, b in scene.pairs])[scene.readings.pairs]
    result: FloatArray = np.einsum("nij,nj->ni", scene.links, own)[:, :3]
    return result


def _moved(scene: Scene, names: list[str], positions: FloatArray) -> dict[str, FloatArray]:
    """Poses of places with these positions, (m, 3) [m]."""
    places = {}
    for name, position in zip(names, positions, strict=True):
        places[name] = scene.places[name].copy()
        places[name][:3, 3] = position
    return places


def _open(scene: Scene, names: list[str]) -> BoolArray:
    """Which coordinates of places are unknown, (m, 3)."""
    return np.array([[axis in scene.unknown[name] for axis in LENGTH_COMPONENTS] for name in names], dtype=bool)

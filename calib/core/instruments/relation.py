"""Readings as implicit relations: a kind defines its prediction, or a function that is zero; all else follows.

A reading v is about two frames, a target and one of several places, each on any link of the robot or in the world:

    f(T_ab, u, v, w) = 0

with the unknown numbers u of the instrument and details w of the reading. A kind defines `predict`, and f where that is
not the prediction minus the reading. This module adds the rest: the place of each row, derivatives, and first values.

Derivatives are central differences of fourth order, whose error, h^4 of truncation and eps / h of rounding, is 1e-12 at
h = 1e-4 for frames that are a metre apart.

First values are least squares over the open places and the unknown numbers, with the present robot, from the described
places and, where the pose of a place is not known, from the rotations of a cube. Undetermined components stay near
these starts, those of the target more than those of places.

When it fails. It fails if the target is nearer than a millimetre to a point where f has no derivative, or the robot's
own errors are so large that readings do not distinguish places.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray, IntArray, evenly_spread
from calib.core.base.sections import ANGLE_COMPONENTS, COMPONENTS, PlaceSection
from calib.core.instruments.camera import cube_rotations
from calib.core.instruments.kind import Column, Comparison, FrameInstrument, Guess, Place, Readings, Scene, View, placed
from calib.core.instruments.rotations import rotation_vectors

_STEP = 1e-4  # m, rad; for unknown numbers in parts of their expected error
_WEIGHTS = ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))
_ROUNDING = 1e-11  # a derivative below this part of the largest counts as zero
_STAY, _STAY_TARGET = 1e-3, 0.1  # weights of the distance of a place, or the target, from its described pose
_FEW = 60  # starts are compared by at most so many readings
_LOST = 5  # a place with so many unknown components may have any orientation
_TRIED, _IMPROVED = 5, 50  # evaluations of a start, and of the best ones
_KEPT = 3


class RelatedSection(PlaceSection):
    """A place that readings are about, on any link."""

    what = "place"

    def place(self, name: str) -> Place:
        """Return the described place under this name."""
        return placed(name, self)


@dataclass(frozen=True)
class Relation(FrameInstrument):
    """A kind of the module docstring. The detail of a reading is the number of its place, where there are several.

    Attributes:
        from_target: Whether frame a is the target and b the place, not the other way round (class attribute).
        own: Places of its readings; none: the measurement frame.
    """

    from_target: ClassVar[bool] = False
    own: tuple[Place, ...] = ()

    @abstractmethod
    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return its readings, (n, n_values); for a touch, the distance from contact."""

    def misses(self, view: View, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return f, (n, n_rows) [SI]: by default prediction minus reading."""
        return self.predict(view, unknowns, readings.details) - readings.values

    def places(self) -> tuple[Place, ...]:
        """Return its places."""
        return self.own

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return the target with each place, or with the measurement frame."""
        names = [place.name for place in self.own] or [base]
        return tuple((self.target, name) if self.from_target else (name, self.target) for name in names)

    def seen_points(self, values: FloatArray) -> FloatArray | None:
        """Return positions of places from values (n, n_values), in the axes of the target, (n, 3) [m]; else None."""
        return None

    def columns(self) -> tuple[Column, ...]:
        """Return its columns; none for a touch, which has no numbers."""
        return () if self.touches else super().columns()

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the things that rows may be about, in the order of the detail: by default its places."""
        return tuple(place.name for place in self.own)

    def text_columns(self) -> tuple[str, ...]:
        """Return `<name>`, which names the thing of a row; no column for a single thing."""
        return (self.name,) if self.touches or len(self.named) > 1 else ()

    def pair_of(self, which: IntArray) -> IntArray:
        """Return the pairs of things that rows are about, (n,): each place has its own pair."""
        return which if len(self.named) == len(self.own) else super().pair_of(which)

    def values(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Return the columns side by side; a touch reads nothing, and gets one row of zeros."""
        return np.zeros((1, self.n_rows)) if self.touches else super().values(columns)

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return f with derivatives by differences."""
        shape = len(readings), self.n_rows

        def slope(moved: Callable[[float], tuple[View, FloatArray]]) -> FloatArray:
            steps = ((weight, moved(k * _STEP)) for k, weight in _WEIGHTS)
            return np.asarray(sum(weight * self.misses(*at, readings) for weight, at in steps) / _STEP)

        by_twist, by_unknown = np.zeros((*shape, 6)), np.zeros((*shape, len(unknowns)))
        for component in range(6):
            by_twist[:, :, component] = slope(lambda step, c=component: (view.after_step(c, step), unknowns))  # type: ignore[misc]
        for k, parameter in enumerate(self.unknowns):
            unit = parameter.sigma_si * np.eye(len(unknowns))[k]
            by_unknown[:, :, k] = slope(lambda step, unit=unit: (view, unknowns + step * unit)) / parameter.sigma_si  # type: ignore[misc]
        by_twist[np.abs(by_twist) < _ROUNDING * np.nanmax(np.abs(by_twist), initial=0.0)] = 0.0
        return Comparison(self.misses(view, unknowns, readings), by_twist, by_unknown)

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return first values as the module docstring says, the best ones first."""
        names = list(dict.fromkeys(name for k in np.unique(scene.readings.pairs) for name in scene.pairs[k]))
        open_ = [(name, COMPONENTS.index(part)) for name in names for part in scene.unknown[name]]
        if not len(scene.readings) or not (open_ or self.unknowns):
            return ()
        few, every = evenly_spread(len(scene.readings), _FEW), np.arange(len(scene.readings))
        tried = [_refine_guess(self, scene, start, open_, few, _TRIED) for start in self._starts(scene, names)]
        kept = [each[1] for each in sorted(tried, key=lambda each: each[0])[:_KEPT]]
        best = sorted((_refine_guess(self, scene, s, open_, every, _IMPROVED) for s in kept), key=lambda each: each[0])
        return tuple(guess for _, guess in best)

    def _starts(self, scene: Scene, names: list[str]) -> Iterator[Guess]:
        """Places as described; without an expected orientation, also turned in each free way of a cube."""
        places = {name: scene.places[name] for name in names}
        yield Guess(places, scene.unknowns)
        sigmas = {place.name: place.sigma_angle for place in self.own}
        for name in names:
            held = [k for k, part in enumerate(ANGLE_COMPONENTS) if part not in scene.unknown[name]]
            if len(scene.unknown[name]) >= _LOST and sigmas.get(name) is None:
                turns = cube_rotations()[1:]
                for turn in turns[np.all(np.abs(rotation_vectors(turns)[:, held]) <= _STEP, axis=1)]:
                    turned = places[name].copy()
                    turned[:3, :3] = turned[:3, :3] @ turn
                    yield Guess(places | {name: turned}, scene.unknowns)


def _refine_guess(
    kind: Relation, scene: Scene, start: Guess, open_: list[tuple[str, int]], chosen: IntArray, most: int
) -> tuple[float, Guess]:
    """The remaining f, as a sum of moderate powers, and the least-squares guess from a start by some readings."""
    readings, n_own = scene.readings.subset(chosen), len(kind.unknowns)
    scales = np.array([parameter.sigma_si for parameter in kind.unknowns])
    first = scene.unknowns if start.unknowns is None else start.unknowns
    looks = [(k, np.flatnonzero(readings.pairs == k)) for k in np.unique(readings.pairs)]
    parts = [(scene.pairs[k], own, scene.links[chosen[own]], readings.subset(own)) for k, own in looks]

    def places_at(x: FloatArray) -> dict[str, FloatArray]:
        steps = {name: np.zeros(6) for name, _ in open_}
        for (name, k), number in zip(open_, x[n_own:], strict=True):
            steps[name][k] = number
        places = dict(start.places)
        for name, step in steps.items():
            places[name] = places[name].copy()
            places[name][:3, 3] += step[:3]
            places[name][:3, :3] = places[name][:3, :3] @ pin.exp3(step[3:])
        return places

    def misses(x: FloatArray) -> FloatArray:
        places, result = places_at(x), np.zeros((len(readings), kind.n_rows))
        for (a, b), own, links, part in parts:
            seen = np.linalg.inv(places[a]) @ links @ places[b]
            result[own] = kind.misses(View(seen[:, :3, :3], seen[:, :3, 3]), first + scales * x[:n_own], part)
        return np.nan_to_num(result.ravel())

    zero = np.zeros(n_own + len(open_))
    stay = np.array([_STAY] * n_own + [_STAY_TARGET if name == kind.target else _STAY for name, _ in open_])
    scale = max(float(np.median(np.abs(misses(zero)))), 1e-6)
    fitted = scipy.optimize.least_squares(
        lambda x: np.concatenate([misses(x) / scale, stay * x]), zero, loss="soft_l1", max_nfev=most
    ).x
    guess = Guess(places_at(fitted), first + scales * fitted[:n_own])
    return float(np.sum(np.sqrt(np.abs(misses(fitted))))), guess

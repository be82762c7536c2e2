"""Pixels: the places of a body's points in a camera's image.

The camera (frame a: its own place, fixed to a link of the robot or next to it) looks at points X of the target frame
(b):

    p = R_ab X + p_ab          (u, v) = image of p (`calib.core.instruments.camera`)          dp = dp_ab - [R_ab X]x dw

For a printed board, readings are predicted where detection would find it: its printed side faces the camera within 65
degrees; its points lie in the image with a margin of 2 %; all of a chessboard or circles is seen, or at least six
points of markers; a marker or square has 16 px or more. Points outside `focus` are not seen.

Points have names, in the column `point` of a file. Where several cameras share columns, the column `camera` names the
camera. A point that the camera cannot see is NaN when predicted, and no reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError
from calib.core.base.parameter import Parameter
from calib.core.base.units import DISPLAY_UNIT, Dimension
from calib.core.instruments.board import Board
from calib.core.instruments.camera import NAMES, is_in_front, is_in_lens, project, rays
from calib.core.instruments.camera_places import Sightings, guesses, seen_points
from calib.core.instruments.kind import (
    Column,
    Comparison,
    FrameInstrument,
    Guess,
    Part,
    Place,
    Readings,
    Scene,
    View,
    placed,
)
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.pixel_section import PixelSection
from calib.core.numerics.rigid import cross_matrices

PIXEL = Part("pixel", ("u", "v"), "pixel", usual=2.0)
_STEEPEST = np.cos(np.deg2rad(65.0))
_MARGIN = 0.02  # margin, as part of the larger side of the image
_LEAST_SEEN = 6  # points
_SMALLEST = 16.0  # side of a marker, square or spacing of dots [px]
_WIDER = 1.1  # factor on the half width of an image whose middle is only guessed
_FEW_AWAY = 0.02  # part of the readings that may lie outside by mistake
_MOSTLY = 0.5  # largest part of the sightings that may lie behind the camera


@dataclass(frozen=True, eq=False)
class Pixel(FrameInstrument):
    """Pixels of named points of one target frame in one camera: two rows. The detail of a reading is its point."""

    section = PixelSection
    parts = (PIXEL,)
    label_column = "camera"
    may_see_nothing = True
    lacks = "has no point"
    place: Place
    intrinsics: tuple[float, ...]
    points_of_body: Mapping[str, tuple[float, float, float]]
    image: tuple[float, float] | None = None
    prefix: str = ""
    board: Board | None = None
    focus: tuple[float, float] | None = None

    @classmethod
    def from_section(cls, name: str, section: PixelSection) -> Pixel:
        """Return the instrument that an entry of a robot description means."""
        numbers = section.intrinsics.model_dump()
        sigmas = {} if section.unknown_intrinsics is None else section.unknown_intrinsics.model_dump()
        unknowns = tuple(
            _parameter(name, key, numbers[key], sigmas[key]) for key in NAMES if sigmas.get(key) is not None
        )
        return cls(
            name,
            section.target,
            placed(name, section.camera),
            tuple(numbers[key] for key in NAMES),
            dict(section.points) if section.board is None else section.board.points(),
            section.image,
            section.columns or name,
            section.board,
            section.focus,
            noise=Noise((PartNoise.from_sigma(section.sigma, 2),)),
            unknowns=unknowns,
        )

    def places(self) -> tuple[Place, ...]:
        """Return the camera's place."""
        return (self.place,)

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return camera and target."""
        return ((self.name, self.target),)

    def columns(self) -> tuple[Column, ...]:
        """Return `<columns>_u` and `_v`."""
        return tuple(Column(f"{self.prefix}_{axis}", "pixel") for axis in PIXEL.axes)

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the points."""
        return tuple(self.points_of_body)

    def text_columns(self) -> tuple[str, ...]:
        """Return `point`."""
        return ("point",)

    def predict(self, view: View, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return pixels, (n, 2); NaN for points that have no image."""
        points, numbers = _points_in_camera(view, self.body(details)), self.numbers(unknowns)
        pixels, seen = self._project(points, numbers)
        if self.board is not None:
            seen &= self._is_detected(self.board, view, numbers)
        return np.where(seen[:, None], pixels, np.nan)

    def _project(self, points: FloatArray, numbers: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Pixels of points in the camera's frame, (n, 2), and a mask of those that are sharp and in the image, (n,)."""
        pixels = project(points, numbers)[0]
        seen = is_in_front(points) & is_in_lens(points, numbers)
        if self.image is not None:
            margin = 0.0 if self.board is None else _MARGIN * max(self.image)
            seen &= np.all((pixels >= margin - 0.5) & (pixels <= np.array(self.image) - 0.5 - margin), axis=1)
        if self.focus is not None:
            seen &= (points[:, 2] >= self.focus[0]) & (points[:, 2] <= self.focus[1])
        return pixels, seen

    def _is_detected(self, board: Board, view: View, numbers: FloatArray) -> BoolArray:
        """Whether a board would be found in the photograph of each reading, (n,)."""
        if len(view.translation) == 0:
            return np.zeros(0, dtype=bool)
        flat = np.concatenate([view.rotation.reshape(-1, 9), view.translation], axis=1)
        first = np.concatenate([[True], np.any(np.diff(flat, axis=0) != 0, axis=1)])  # readings of one view follow
        rotation, translation = view.rotation[first], view.translation[first]
        body_points = np.array(list(self.points_of_body.values()))
        points = np.einsum("kab,jb->kja", rotation, body_points) + translation[:, None]
        seen = self._project(points.reshape(-1, 3), numbers)[1].reshape(points.shape[:2])
        middle = points.mean(axis=1)
        facing = np.einsum("ka,ka->k", rotation[:, :, 2], middle) > _STEEPEST * np.linalg.norm(middle, axis=1)
        large = np.min(numbers[:2]) * board.smallest >= _SMALLEST * middle[:, 2]
        least = len(body_points) if board.dictionary is None else min(_LEAST_SEEN, len(body_points))
        return (facing & large & (np.sum(seen, axis=1) >= least))[np.cumsum(first) - 1]

    def compare(self, view: View, unknowns: FloatArray, readings: Readings) -> Comparison:
        """Return errors in the image, and their derivatives by the twist and unknown intrinsics."""
        body = self.body(readings.details)
        pixels, by_point, by_number = project(_points_in_camera(view, body), self.numbers(unknowns))
        turned = np.einsum("kab,kb->ka", view.rotation, body)
        by_twist = np.concatenate([by_point, -by_point @ cross_matrices(turned)], axis=2)
        return Comparison(pixels - readings.values, by_twist, by_number[:, :, self._unknown_numbers])

    def point_seen(self, view: View, details: FloatArray) -> FloatArray:
        """Return the point of the body behind each pixel, seen from the camera, (n, 3) [m]."""
        return _points_in_camera(view, self.body(details))

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return guesses at camera and target; `DataError` if observed points lie behind the camera in all guesses."""
        result: list[dict[str, FloatArray]] = []
        for number in np.unique(scene.readings.pairs):
            names = scene.pairs[number]
            chosen = np.flatnonzero(scene.readings.pairs == number)
            _, view = np.unique(scene.readings.visits[chosen], return_inverse=True)
            sightings = Sightings(
                scene.links[chosen],
                self.body(scene.readings.details[chosen]),
                rays(scene.readings.values[chosen], self.numbers(scene.unknowns)),
                view.reshape(-1),
            )
            known = (not scene.unknown[names[0]], not scene.unknown[names[1]])
            now = (scene.places[names[0]], scene.places[names[1]])
            guessed = [now] if all(known) else guesses(sightings, now, known)
            self._check(sightings, guessed)
            some = [dict(zip(names, places, strict=True)) for places in guessed]
            result = some if not result else [some[0] | result[0]]  # with several setups: as in the first one
        return tuple(Guess(places) for places in result)

    def doubts(self, readings: Readings) -> tuple[str, ...]:
        """Return a doubt if pixels lie outside an image around the principal point, as every camera has it."""
        middle = np.array(self.intrinsics[2:4])
        half = middle if self.image is None else np.array(self.image) / 2
        low, high = half - _WIDER * half, half + _WIDER * half
        away = np.any((readings.values < low) | (readings.values > high), axis=1)
        if np.mean(away) <= _FEW_AWAY:
            return ()
        largest = np.max(np.abs(readings.values), axis=0)
        size = f"{2 * half[0]:.0f} x {2 * half[1]:.0f} px"
        source = "as `image` states" if self.image is not None else "as cx and cy suggest"
        return (
            f"camera '{self.name}': {int(np.sum(away))} of {len(readings)} readings lie outside an image of {size},"
            f" {source} (they reach u = {largest[0]:.0f}, v = {largest[1]:.0f}): the image was turned by 90 degrees,"
            " cut or scaled after the intrinsics were found, or u and v are exchanged; give the intrinsics of these"
            " images",
        )

    def _check(self, sightings: Sightings, guessed: Sequence[tuple[FloatArray, FloatArray]]) -> None:
        away = min(int(np.sum(~is_in_front(seen_points(sightings, places)))) for places in guessed)
        if away > _MOSTLY * len(sightings.view):
            raise DataError(
                f"camera '{self.name}': {away} of the {len(sightings.view)} points that it saw would lie behind it."
                f" Check the poses of the camera and of target '{self.target}' in the description, and that z of the"
                " camera's frame points where it looks"
            )

    def body(self, details: FloatArray) -> FloatArray:
        """Return the readings' points in the target frame, (n, 3) [m]."""
        body_points = np.array(list(self.points_of_body.values()))
        return body_points[details[:, 0].astype(np.intp)]

    @property
    def _unknown_numbers(self) -> list[int]:
        return [NAMES.index(parameter.name.rpartition(".")[2]) for parameter in self.unknowns]

    def numbers(self, unknowns: FloatArray) -> FloatArray:
        """Return all intrinsics, (9,), with the unknown ones, (n,), in their places."""
        numbers = np.array(self.intrinsics)
        numbers[self._unknown_numbers] = unknowns
        return numbers


def _points_in_camera(view: View, body: FloatArray) -> FloatArray:
    return np.einsum("kab,kb->ka", view.rotation, body) + view.translation


def _parameter(name: str, key: str, nominal: float, sigma: float) -> Parameter:
    dimension: Dimension = "pixel" if key in NAMES[:4] else "number"
    return Parameter(f"{name}.{key}", dimension, nominal, sigma, DISPLAY_UNIT[dimension], placement=True)

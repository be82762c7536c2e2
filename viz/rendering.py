"""The robot as a picture for paper, drawn without a browser: triangles into a buffer of depths, seen from far away.

Every triangle is covered with sample points, closer together than the buffer's cells; a cell shows the sample that is
nearest to the camera. The buffer is finer than the picture, so that averaging its cells makes edges smooth. No lines of
sight are searched and nothing is sorted, so it takes a tenth of a second for a robot of ten thousand triangles.
"""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.threads import one_blas_thread
from viz.poses import IDENTIFICATION
from viz.scene import Scene
from viz.shapes import Shape
from viz.svg import BLUE, ORANGE

WIDTH, HEIGHT = 600, 500  # of the picture [px]
_FINER = 2  # cells of the buffer per pixel, along each side
_DENSER = 1.25  # samples per cell, along each side of a triangle
_STEP = 1.3  # counts of samples differ by such a factor: triangles with the same counts are drawn at once
_MOST_STEPS = 1 << 20  # along a side; a picture has thousands of cells
_AT_ONCE = 100_000  # samples
_MARGIN = 0.04
_LIGHT = np.array([0.35, 0.8, 0.55]) / np.linalg.norm([0.35, 0.8, 0.55])  # in the camera's axes: right, up, towards it
_SHADOW = 0.45  # brightness of what is turned away from the light
_SECTIONS = 48  # of round shapes
_CORNERS = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
_BOX = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
        [1, 5, 7], [1, 7, 3]]  # fmt: skip
_POINT, _SMALL_POINT, _FEW_POINTS = 4.5, 2.0, 200  # radius of a point [px], where there are few and many
_Samples = NDArray[np.float32]


@one_blas_thread
def picture_of(scene: Scene) -> str:
    """Return the robot in its first pose with the measured points, as the address of a PNG that a page holds itself.

    Args:
        scene: The scene; seen as its viewer sees it first, but without perspective.
    """
    camera = _camera(scene)
    triangles, colours = _triangles(scene, camera[2])
    points, point_colours = points_of(scene)
    seen, seen_points = triangles @ camera.T, points @ camera.T
    cells = _FINER * np.array([WIDTH, HEIGHT], dtype=float)
    everything = np.concatenate([seen.reshape(-1, 3), seen_points])
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = float(np.min((1 - 2 * _MARGIN) * cells / np.maximum(high - low, 1e-9)[:2]))
    middle = np.append((low + high)[:2] / 2, 0.0)
    offset = np.append(cells / 2, 0.0)
    buffer = _Buffer()
    buffer.triangles(scale * (seen - middle) + offset, _shaded(seen, colours))
    buffer.discs(scale * (seen_points - middle) + offset, point_colours)
    return "data:image/png;base64," + base64.b64encode(buffer.png()).decode()


class _Buffer:
    """Depth of every cell, and the number of the colour that it shows; x to the right, y upwards, z to the camera.

    Depths have single precision: there are millions of samples, and cells are what counts.
    """

    def __init__(self) -> None:
        self._width, self._height = _FINER * WIDTH, _FINER * HEIGHT
        self._depth = np.full(self._width * self._height, -np.inf, dtype=np.float32)
        self._shown = np.zeros(self._width * self._height, dtype=np.int32)  # the first colour: none
        self._colours = np.zeros((1, 3), dtype=np.float32)

    def triangles(self, corners: FloatArray, colours: FloatArray) -> None:
        """Draw triangles (m, 3, 3) [cells] in colours (m, 3)."""
        numbers = self._number(colours)
        corners = _longest_side_first(corners).astype(np.float32)
        along, across = _sides(corners[..., :2])
        needed = np.maximum(_DENSER * np.stack([along, across], axis=1), 1.0)
        steps = np.ceil(_STEP ** np.ceil(np.log(needed) / np.log(_STEP))).astype(int)  # few different ones
        pairs, of_triangle = np.unique(steps @ [_MOST_STEPS, 1], return_inverse=True)
        for pair, (n_along, n_across) in enumerate(zip(*np.divmod(pairs, _MOST_STEPS), strict=True)):
            s, t = np.meshgrid(
                np.linspace(0, 1, n_along + 1, dtype=np.float32), np.linspace(0, 1, n_across + 1, dtype=np.float32)
            )
            weights = np.stack([(1 - t) * (1 - s), (1 - t) * s, t], axis=-1).reshape(-1, 3)  # of the corners
            chosen = np.flatnonzero(of_triangle == pair)
            for part in np.array_split(chosen, min(len(chosen), -(-len(chosen) * len(weights) // _AT_ONCE))):
                samples = weights @ corners[part].transpose(1, 2, 0).reshape(3, -1)
                x, y, depth = samples.reshape(-1, 3, len(part)).transpose(1, 0, 2).reshape(3, -1)
                self._put(x, y, depth, np.tile(numbers[part], len(weights)))

    def discs(self, places: FloatArray, colours: FloatArray) -> None:
        """Draw a disc at each place (n, 3) [cells]."""
        radius = _FINER * max(_SMALL_POINT, _POINT * min(1.0, float(np.sqrt(_FEW_POINTS / max(len(places), 1)))))
        around = np.arange(-np.ceil(radius), np.ceil(radius) + 1)
        grid = np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
        distance = np.linalg.norm(grid, axis=1)
        disc = np.column_stack([grid, np.full(len(grid), 3 * radius)])[distance <= radius]  # before a socket around it
        edge = distance[distance <= radius] > radius - 1.2 * _FINER / 2
        white = self._number(np.ones((1, 3)))
        numbers = np.where(edge, white, self._number(colours)[:, None])
        x, y, depth = (places[:, None] + disc).reshape(-1, 3).astype(np.float32).T
        self._put(x, y, depth, numbers.ravel())

    def _number(self, colours: FloatArray) -> IntArray:
        """Keep colours (m, 3), and return their numbers, (m,)."""
        first = len(self._colours)
        self._colours = np.concatenate([self._colours, colours.astype(np.float32)])
        return np.arange(first, len(self._colours), dtype=np.int32)

    def _put(self, x: _Samples, y: _Samples, depth: _Samples, numbers: IntArray) -> None:
        """Show samples (n,) [cells] where nothing is nearer, in colours of these numbers, (n,)."""
        inside = (x >= 0) & (x < self._width) & (y >= 0) & (y < self._height)
        if not np.all(inside):
            x, y, depth, numbers = x[inside], y[inside], depth[inside], numbers[inside]
        cell = (self._height - 1 - y.astype(np.int32)) * self._width + x.astype(np.int32)
        np.maximum.at(self._depth, cell, depth)
        nearest = np.flatnonzero(depth == self._depth[cell])
        self._shown[cell[nearest]] = numbers[nearest]

    def png(self) -> bytes:
        """Return the picture; where nothing was drawn it is clear."""
        colours = np.column_stack([self._colours, np.arange(len(self._colours)) > 0])
        cells = self._shown.reshape(HEIGHT, _FINER, WIDTH, _FINER)
        painted = np.zeros((HEIGHT, WIDTH, 4), dtype=np.float32)
        for line, column in np.ndindex(_FINER, _FINER):
            painted += np.take(colours, cells[:, line, :, column], axis=0)  # indexing takes four times as long
        painted[..., :3] *= _FINER**2 / np.maximum(painted[..., 3:], 1)
        return _png(np.round(painted * (255 / _FINER**2)).astype(np.uint8))


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """Return a picture (height, width, 4) of red, green, blue and opacity as a PNG file."""
    height, width, _ = pixels.shape
    lines = np.zeros((height, 1 + 4 * width), dtype=np.uint8)  # each opens with its filter
    lines[:, 0] = 1  # bytes are differences to the pixel on the left: shorter once packed
    lines[:, 1:5] = pixels[:, 0]
    lines[:, 5:] = np.diff(pixels, axis=1).reshape(height, -1)
    parts = {
        b"IHDR": struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0),
        b"IDAT": zlib.compress(lines.tobytes()),
        b"IEND": b"",
    }
    written = (
        struct.pack(">I", len(part)) + name + part + struct.pack(">I", zlib.crc32(name + part))
        for name, part in parts.items()
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(written)


def _camera(scene: Scene) -> FloatArray:
    """Rows: right, up, towards the camera, seen from the measurement frame, (3, 3)."""
    towards = scene.view.direction / np.linalg.norm(scene.view.direction)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    camera: FloatArray = np.stack([right, np.cross(towards, right), towards]) @ scene.view.upright
    return camera


def _triangles(scene: Scene, towards: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Triangles of the robot and of wires (m, 3, 3) [m] in the measurement frame, and their colours (m, 3).

    Args:
        scene: The scene.
        towards: Direction of the camera, (3,).
    """
    number = {name: body for body, name in enumerate(scene.bodies.names)}
    matrices = scene.bodies.matrices(scene.solid, 0)
    triangles, colours = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    lines = [shape for shape in scene.decorations if shape.kind == "cylinder"]  # wires; surfaces would hide the robot
    for shape in [*scene.shapes, *lines]:
        T_base_body = np.eye(4) if shape.body is None else matrices[number[shape.body]]
        M = T_base_body @ shape.T_body_shape
        vertices, faces = _mesh(shape)
        corners = (vertices @ M[:3, :3].T + M[:3, 3])[faces]
        if shape.kind != "mesh":  # closed, and its faces turn the same way round: what looks away is hidden
            corners = corners[_normals(corners) @ towards > 0]
        triangles.append(corners)
        colours.append(np.tile(shape.colour[:3], (len(corners), 1)))
    return np.concatenate(triangles), np.concatenate(colours)


def _mesh(shape: Shape) -> tuple[FloatArray, IntArray]:
    """Corners (n, 3) [m] and faces (m, 3) of a shape in its own frame, faces turning left seen from outside."""
    if shape.kind == "mesh":
        return shape.vertices, shape.faces
    if shape.kind == "box":
        return np.array(_CORNERS) * np.array(shape.size), np.array(_BOX)
    if shape.kind == "cylinder":
        radius, half = shape.size[0], shape.size[1] / 2
        return _turned(np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]]))
    angles = np.linspace(-np.pi / 2, np.pi / 2, _SECTIONS // 2 + 1)
    return _turned(shape.size[0] * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def _turned(outline: FloatArray) -> tuple[FloatArray, IntArray]:
    """Corners and faces of what an outline (k, 2), radius and height from bottom to top, covers when it turns."""
    angles = 2 * np.pi * np.arange(_SECTIONS) / _SECTIONS
    radius, height = outline.T
    x, y = radius[:, None] * np.cos(angles), radius[:, None] * np.sin(angles)
    corners = np.stack([x, y, np.repeat(height[:, None], _SECTIONS, axis=1)], axis=-1).reshape(-1, 3)
    here = (_SECTIONS * np.arange(len(outline) - 1)[:, None] + np.arange(_SECTIONS)).ravel()
    beside = here - here % _SECTIONS + (here + 1) % _SECTIONS
    lower = np.stack([here, beside, beside + _SECTIONS], axis=1)
    upper = np.stack([here, beside + _SECTIONS, here + _SECTIONS], axis=1)
    return corners, np.concatenate([lower, upper])


def _longest_side_first(corners: FloatArray) -> FloatArray:
    """The same triangles (m, 3, 3), turned so that their first two corners are ends of the side that looks longest."""
    lengths = np.linalg.norm(corners[:, [1, 2, 0], :2] - corners[..., :2], axis=2)
    order = (np.argmax(lengths, axis=1)[:, None] + np.arange(3)) % 3
    turned: FloatArray = np.take_along_axis(corners, order[..., None], axis=1)
    return turned


def _sides(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Length of the first side of triangles (m, 3, 2), and the height above it, (m,)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    return length, np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.maximum(length, 1e-9)


def _normals(corners: FloatArray) -> FloatArray:
    """Normals of triangles (m, 3, 3), not of unit length, (m, 3)."""
    normals: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


def _shaded(corners: FloatArray, colours: FloatArray) -> FloatArray:
    """Colours in the light, from whichever side a triangle is seen, (m, 3)."""
    normals = _normals(corners)
    normals *= np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    light = normals @ _LIGHT / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    shaded: FloatArray = colours * (_SHADOW + (1 - _SHADOW) * np.maximum(light, 0.0))[:, None]
    return shaded


def points_of(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return measured points (n, 3) [m], and their colours by whether they were used, (n, 3).

    Where none were measured: the points that readings tell about, where these have them.
    """
    places, groups = scene.poses.measured, scene.poses.group
    if not np.any(np.isfinite(places)) and scene.readings:
        places = np.concatenate([errors.anchors for errors in scene.readings])
        groups = tuple(group for errors in scene.readings for group in errors.group)
    known = np.isfinite(places).all(axis=1)
    used = np.array([group == IDENTIFICATION for group in groups], dtype=bool)
    colours = np.where(used[:, None], *(np.array(list(bytes.fromhex(colour[1:]))) / 255 for colour in (BLUE, ORANGE)))
    return places[known], colours[known]

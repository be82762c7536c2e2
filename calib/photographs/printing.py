"""A board as shapes, and as a page to print in true size.

Black shapes are rectangles and discs in the board's frame (x along the rows, y down, [m]). For boards with markers,
OpenCV gives the places and black cells of markers; squares without a marker are black. All shapes are filled as one
path, so that neighbouring cells leave no hairlines between them.

A ruler of known length is printed below the board: printers that fit pages to paper shrink by some percent, and every
length of a calibration shrinks with them.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import InputError
from calib.core.base.units import millimetres
from calib.core.instruments.board import Board
from calib.photographs.detection import opencv_board
from calib.photographs.opencv import dictionary

FORMATS = ("pdf", "svg")
PAPERS = {"a4": (0.210, 0.297), "a3": (0.297, 0.420), "a2": (0.420, 0.594), "letter": (0.2159, 0.2794)}
"""Width and height [m]."""
_RULER = 0.1  # length of the printed ruler [m]
_FOOT = 0.022  # m below the board for ruler and words
_MARGIN = 0.008
_INCH = 0.0254
_SMALL_DOT, _LARGE_DOT = 0.25, 0.38  # radius over the spacing of a square grid
_DOT = 0.5  # radius of a dot over the spacing


def shapes(board: Board) -> tuple[FloatArray, FloatArray]:
    """Return the black shapes of a board: rectangles x0, y0, x1, y1, (n, 4) [m], and discs x, y, radius, (n, 3) [m].

    Raises:
        InputError: OpenCV, which draws the markers, is not installed.
        DescriptionError: There is no such dictionary.
    """
    none = np.zeros((0, 3))
    if board.spacing is not None:
        places = np.array(list(board.points().values()))[:, :2]
        first, others = (_DOT, _DOT) if board.kind == "circles" else (_LARGE_DOT, _SMALL_DOT)
        radii = board.spacing * np.where(np.arange(len(places)) == 0, first, others)
        return np.zeros((0, 4)), np.column_stack([places, radii])
    if board.kind == "chessboard":
        return _squares(board, lambda i, j: (i + j) % 2 == 0), none
    made: Any = opencv_board(board, bool(board.legacy))
    corners = np.array([np.asarray(marker)[:, :2] for marker in made.getObjPoints()], dtype=float)
    cells = [
        _cells(board.dictionary or "", int(number), places[0], float(places[1, 0] - places[0, 0]))
        for number, places in zip(np.ravel(made.getIds()), corners, strict=True)
    ]
    rectangles = np.concatenate(cells)
    if board.kind == "charuco":
        side = board.square or 0.0
        taken = {(int(x / side), int(y / side)) for x, y in corners.mean(axis=1)}
        rectangles = np.concatenate([_squares(board, lambda i, j: (i, j) not in taken), rectangles])
    return rectangles, none


def _squares(board: Board, black: Callable[[int, int], bool]) -> FloatArray:
    side = board.square or 0.0
    chosen = [(i, j) for j in range(board.rows) for i in range(board.columns) if black(i, j)]
    corners = side * np.array(chosen, dtype=float)
    return np.hstack([corners, corners + side])


def _cells(name: str, number: int, corner: FloatArray, side: float) -> FloatArray:
    """Black cells of a marker, (n, 4) [m], joined along its rows."""
    markers = dictionary(name)
    count = int(markers.markerSize) + 2
    image = np.asarray(markers.generateImageMarker(number, count)) < 128
    step = side / count
    runs = []
    for j, row in enumerate(image):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
        runs += [(start, j, end, j + 1) for start, end in edges.reshape(-1, 2)]
    return np.tile(corner, 2) + step * np.array(runs, dtype=float)


class Paper:
    """A printed board whose exact colour is known at any place, from a grid of the edges of its rectangles."""

    def __init__(self, board: Board) -> None:
        rectangles, discs = shapes(board)
        self._edges = [np.unique(np.round(rectangles[:, (k, k + 2)], 12)) for k in (0, 1)]
        across, down = (len(edges) + 1 for edges in self._edges)
        self._cells = np.zeros((across, down), dtype=bool)
        for rectangle in rectangles:
            (x0, x1), (y0, y1) = (
                np.searchsorted(self._edges[k], np.round(rectangle[[k, k + 2]], 12), side="right") for k in (0, 1)
            )
            self._cells[x0:x1, y0:y1] = True
        self._discs = scipy.spatial.cKDTree(discs[:, :2]) if len(discs) else None
        self._radii = np.append(discs[:, 2], 0.0)  # the last for places far from all discs

    def black(self, places: FloatArray) -> BoolArray:
        """Return whether places on the board, (n, 2) [m], are black; places outside are white."""
        at = [np.searchsorted(self._edges[k], places[:, k], side="right") for k in (0, 1)]
        result: BoolArray = self._cells[at[0], at[1]]
        if self._discs is not None:
            distance, disc = self._discs.query(places, distance_upper_bound=2 * self._radii.max())
            result = result | (distance < self._radii[disc])
        return result


def page(board: Board, form: str, paper: str | None = None) -> bytes:
    """Return a pdf or svg page with the board in true size, a ruler, and the board's description.

    The paper is a key of `PAPERS`, portrait or landscape as the board needs; default: as large as the board.

    Raises:
        InputError: The board is larger than the paper, or OpenCV is not installed.
    """
    from matplotlib.figure import Figure  # slow to import, and only used here
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    width, height = board.size
    needed = np.array([max(width, _RULER) + 2 * _MARGIN, height + _FOOT + 2 * _MARGIN])
    sheet = needed if paper is None else _sheet(paper, needed, board)
    left, top = (sheet[0] - width) / 2, (sheet[1] - height - _FOOT) / 2
    figure = Figure(figsize=tuple(sheet / _INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, sheet[0])
    axes.set_ylim(sheet[1], 0.0)
    axes.set_axis_off()
    rectangles, discs = shapes(board)
    parts = [
        Path(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]), closed=True)
        for x0, y0, x1, y1 in rectangles + np.tile([left, top], 2)
    ]
    parts += [Path.circle((x + left, y + top), radius) for x, y, radius in discs]
    axes.add_patch(PathPatch(Path.make_compound_path(*parts), facecolor="black", edgecolor="none"))
    _draw_foot(axes, board, (sheet[0] - _RULER) / 2, top + height + 0.006)
    stream = io.BytesIO()
    about = {"Date": None} if form == "svg" else {"CreationDate": None}
    figure.savefig(stream, format=form, metadata=about)
    if form == "pdf":
        return stream.getvalue()
    size = 'width="{:g}mm" height="{:g}mm"'.format(*millimetres(sheet))  # points are known to fewer programs
    return re.sub(rb'width="[0-9.]+pt" height="[0-9.]+pt"', size.encode(), stream.getvalue(), count=1)


def _sheet(paper: str, needed: FloatArray, board: Board) -> FloatArray:
    for size in (PAPERS[paper], PAPERS[paper][::-1]):
        if np.all(needed <= size):
            return np.array(size)
    width, height = millimetres(needed)
    raise InputError(
        f"the {board.kind} needs a page of {width:.0f} x {height:.0f} mm, and {paper.upper()} is smaller; take larger"
        " paper, smaller or fewer squares"
    )


def _draw_foot(axes: Any, board: Board, left: float, top: float) -> None:
    for k in range(11):
        x = left + k * _RULER / 10
        axes.plot([x, x], [top, top + (0.004 if k % 5 == 0 else 0.0025)], color="black", linewidth=0.4)
    axes.plot([left, left + _RULER], [top, top], color="black", linewidth=0.4)
    words = f"{board}\nprint at 100 %; the ruler is 100 mm long: measure it, and state the sizes as printed"
    axes.text(left, top + 0.006, words, fontsize=5, va="top")

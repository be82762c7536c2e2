"""Detection of a board's points in an image by OpenCV, and likely reasons if none are found.

    chessboard    `findChessboardCornersSB`, which is accurate below a pixel. The colours of the squares between the
                  corners decide which end is the first.
    charuco       markers, then corners between them, refined by `CharucoDetector`
    circles       `findCirclesGrid`, asymmetric
    dots          `findCirclesGrid`, symmetric; the largest dot of the four corners is the first
    aruco         corners of markers, refined to the edges (`CORNER_REFINE_SUBPIX`)
    apriltag      as aruco

If an image shows no board, the likely mistakes are tried and named if they explain it: a mirrored image, exchanged or
miscounted columns and rows, markers of another dictionary, blur, no contrast. Images of another size than most are left
out: they are of another camera.

The measure of sharpness is the width of edges: contrast over the steepest slopes, within the area of the board. Corners
are accurate up to a width of some 5 px; beyond it their positions become unreliable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count, islice
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DescriptionError
from calib.core.base.words import count_noun
from calib.core.instruments.board import Board
from calib.photographs.opencv import GreyImage, dictionary, dictionary_families, opencv

FEWEST = 4
"""Least number of points by which an image determines the pose of the board."""
_BLURRED = 6.0  # px, width of edges
_OFF = 0.05  # largest distance of a point from a homography, as part of the points' extent: lenses distort
_LEAST_OFF = 5.0  # px, allowed in any case
_TRIES = 3  # images of a set in which other dictionaries and other boards are tried
_MOST_COLUMNS = 30  # largest tried number of columns of markers
_FITTING = 0.9  # least part of the markers' corners that must fit the right board
_LARGER = 1.15  # the dot that marks a corner is at least this many times as large as the others
_FLAT = 30  # difference of grey values between dark and bright


@dataclass(frozen=True, eq=False)
class DetectedImage:
    """Points of a board detected in one image.

    Attributes:
        name: Name of the image.
        size: Width and height [px].
        points: Names of the points.
        pixels: Pixels of the points, (n, 2).
        remark: Problem in words; empty if there is none.
        edge: Width of edges [px]; NaN without a board.
        mirrored: Whether only the mirror image shows the board.
    """

    name: str
    size: tuple[int, int]
    points: tuple[str, ...] = ()
    pixels: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    remark: str = ""
    edge: float = float("nan")
    mirrored: bool = False

    @property
    def usable(self) -> bool:
        """Whether enough points were found."""
        return len(self.points) >= FEWEST


@dataclass(frozen=True)
class Detection:
    """Points of a board, with the layout that shows most corners, detected in each image of a set."""

    board: Board
    images: tuple[DetectedImage, ...]

    @property
    def usable(self) -> tuple[DetectedImage, ...]:
        """Images in which enough points were found."""
        return tuple(image for image in self.images if image.usable)

    @property
    def n_points(self) -> int:
        """Number of points in the usable images."""
        return sum(len(image.points) for image in self.usable)


def detect(board: Board, images: Iterable[tuple[str, GreyImage | str]]) -> Detection:
    """Return the points of a board detected in images.

    A text in place of an image says why the image could not be read. For a ChArUco board with an even number of rows
    and unknown layout, both layouts are tried, and the one that shows more corners in all images is taken.

    Raises:
        DescriptionError: There is no such dictionary, or it has too few markers.
    """
    layouts = _layouts(board)
    detectors = [
        _Detector(board.model_copy(update={"legacy": legacy} if board.kind == "charuco" else {})) for legacy in layouts
    ]
    each: list[list[DetectedImage]] = [[] for _ in layouts]
    for name, image in images:
        if isinstance(image, str):
            shown = [DetectedImage(name, (0, 0), remark=image)] * len(layouts)
        else:
            shown = [detector.find(name, image) for detector in detectors]
            if not any(detected.usable or "first_row" in detected.remark for detected in shown):
                ahead = detectors[0]
                if len(detectors) > 1:
                    ahead = max(detectors, key=lambda detector: detector.n_mirrored_points(image))
                shown = [ahead.with_remark(shown[0], image)] * len(layouts)
        for of_layout, detected in zip(each, shown, strict=True):
            of_layout.append(detected)
    best = max(range(len(layouts)), key=lambda k: sum(len(detected.points) for detected in each[k]))
    return Detection(detectors[best].board, tuple(_images_of_one_size(each[best])))


def _images_of_one_size(images: Sequence[DetectedImage]) -> Iterator[DetectedImage]:
    """The images; an image of another size than most images with a board loses its points."""
    sizes = Counter(image.size for image in images if image.usable)
    for image in images:
        if image.usable and image.size != (most := sizes.most_common(1)[0][0]):
            words = "is {} x {} px, and most images are {} x {}; give images of one camera".format(*image.size, *most)
            yield replace(image, points=(), pixels=np.zeros((0, 2)), remark=words)
        else:
            yield image


class _Detector:
    """Finds one board with a known layout in images."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self._n_points = len(board.points())
        self._tries = _TRIES
        self._dictionary = ""
        self._suspect: tuple[Board, str] | None = None
        self._columns = range(2, _MOST_COLUMNS + 1)
        self._board = opencv_board(board, bool(board.legacy)) if board.dictionary else None

    def find(self, name: str, image: GreyImage) -> DetectedImage:
        """Return the detection in one image."""
        points = self.points(image)
        if 0 < len(points) < self._n_points / 2 and self.n_mirrored_points(image) > 2 * len(points):
            points = {}  # recognised by chance in a mirrored image
        kept = points_on_one_plane(self.board, points)
        if len(kept) < _FITTING * len(points) and (numbered := self._other_numbering(points)):
            return DetectedImage(name, (image.shape[1], image.shape[0]), remark=numbered)
        if 4 * (len(points) - len(kept)) > len(points) and self._other_columns(image):
            kept = {}
        pixels = np.array(list(kept.values())).reshape(-1, 2)
        enough, off = len(kept) >= FEWEST, len(points) - len(kept)
        edge, remark = (edge_width(image, pixels), "") if enough else (float("nan"), "no board found")
        if edge > _BLURRED:
            remark = f"blurred: edges are {edge:.0f} px wide"
        elif off:
            remark = f"{count_noun(off, 'point')} left out: they do not fit the board as placed by the other points"
        elif enough and self.board.dictionary:
            remark = self._strangers(_detected_markers(image, self.board.dictionary)[1])
        return DetectedImage(name, (image.shape[1], image.shape[0]), tuple(kept), pixels, remark, edge)

    def points(self, image: GreyImage) -> dict[str, FloatArray]:
        """Return the detected points of an image, by name."""
        if self.board.kind == "charuco":
            return _charuco(self._board, image)
        return _WITHOUT_MARKERS.get(self.board.kind, _markers)(self.board, image)

    def n_mirrored_points(self, image: GreyImage) -> int:
        """Return the number of points in the mirror image; 0 for a board without markers, which is symmetric."""
        return len(self.points(np.ascontiguousarray(image[:, ::-1]))) if self.board.dictionary else 0

    def with_remark(self, detected: DetectedImage, image: GreyImage) -> DetectedImage:
        """Return the detection, with a likely reason for too few points."""
        n = len(detected.points)
        mirrored = self.n_mirrored_points(image) >= max(FEWEST, 2 * n)
        return replace(detected, remark=self._why_missing(image, n, mirrored), edge=float("nan"), mirrored=mirrored)

    def _why_missing(self, image: GreyImage, n: int, mirrored: bool) -> str:
        few = f"only {count_noun(n, 'point')} found" if n else "no board found"
        board = self.board
        if board.dictionary is None:
            return few + (
                self._board_of_other_count(image)
                or _light_remark(image)
                or "; without markers it is found only if all of it is in the image"
                + (", and if the dot of one corner is larger than the others" if board.kind == "dots" else "")
            )
        markers, columns = _detected_markers(image, board.dictionary)[1], self._other_columns(image)
        if columns:
            return f"{few}: its {count_noun(len(set(markers)), 'marker')} fit {columns}; correct columns and rows"
        if mirrored:
            return f"{few}: the image is mirrored; switch that off in the camera, or flip the images back"
        if len(markers) == 0:
            if self._tries > 0 and not self._dictionary:
                self._tries -= 1
                self._dictionary = _dictionary_in(image)
            if self._dictionary:
                return f"{few}: no marker of {board.dictionary}, but some of {self._dictionary}; correct 'dictionary'"
            return f"{few}: no marker of {board.dictionary}{_light_remark(image)}"
        if strangers := self._strangers(markers):
            return f"{few}: {strangers}"
        return f"{few} ({count_noun(len(set(markers)), 'marker')}): the board is partly outside, covered or too small"

    def _board_of_other_count(self, image: GreyImage) -> str:
        """Remark on another board without markers in the image; empty if none is recognised."""
        others = [self._suspect] if self._suspect else _other_counts(self.board) if self._tries > 0 else ()
        self._tries -= 1
        for other, noun in others:
            find = partial(_chessboard, quick=True) if other.kind == "chessboard" else _WITHOUT_MARKERS[other.kind]
            corners = find(other, image)
            if len(corners) >= FEWEST:
                self._suspect = other, noun
                return f", but one of {other.columns} x {other.rows} {noun}: correct the board"
        return ""

    def _other_columns(self, image: GreyImage) -> str:
        """Remark with the number of columns that the markers fit, if the description has another; else empty."""
        board = self.board
        if board.dictionary is None:
            return ""
        corners, numbers = _detected_markers(image, board.dictionary)
        some = [k for k, number in enumerate(numbers) if number >= board.first_marker and numbers.count(number) == 1]
        if len(some) < FEWEST:
            return ""
        pixels = np.concatenate([corners[k] for k in some])

        def fitting(columns: int) -> int:
            places = [_marker_corners(board, columns, numbers[k] - board.first_marker) for k in some]
            if board.first_row == "bottom":
                places = [place * [1, -1] + [0, board.marker or 0.0] for place in places]
            return int(np.sum(_are_on_plane(np.concatenate(places), pixels, robust=False)))

        fits = {columns: fitting(columns) for columns in self._columns}
        best = max(fits, key=lambda columns: fits[columns])
        if fits[best] < _FITTING * len(pixels) or fits[best] < fitting(board.columns) + FEWEST:
            return ""
        self._columns = range(best, best + 1)
        return f"a board of {best} columns"

    def _other_numbering(self, points: dict[str, FloatArray]) -> str:
        """The correction of the board if markers are numbered from the other side; else empty."""
        other = "bottom" if self.board.first_row == "top" else "top"
        numbered = self.board.model_copy(update={"first_row": other})
        if self.board.kind not in ("aruco", "apriltag") or (
            len(points_on_one_plane(numbered, points)) < _FITTING * len(points)
        ):
            return ""
        return f"its markers are counted from the {other} row; write first_row: {other} into the board"

    def _strangers(self, markers: list[int]) -> str:
        """A sentence on markers in an image that the board does not have; empty if there are none."""
        own = marker_numbers(self.board)
        strange = sorted(set(markers) - set(own))
        if not strange:
            return ""
        return (
            f"marker {strange[0]} is in the image, and the board as described has markers {own[0]} to {own[-1]};"
            " correct columns, rows or first_marker"
        )


def _layouts(board: Board) -> tuple[bool, ...]:
    if board.kind != "charuco" or board.legacy is not None:
        return (bool(board.legacy),)
    return (False, True) if board.rows % 2 == 0 else (False,)


def opencv_board(board: Board, legacy: bool) -> object:
    """Return OpenCV's board for a kind with markers.

    Raises:
        DescriptionError: The dictionary does not exist, or has too few markers.
    """
    cv2 = opencv()
    markers = dictionary(board.dictionary or "")
    numbers = np.array(marker_numbers(board), dtype=np.int32)
    if board.kind != "charuco":  # in the order on the board, row by row from the top
        numbers = np.array([board.marker_at(i, j) for j in range(board.rows) for i in range(board.columns)], np.int32)
    if numbers.max() >= len(markers.bytesList):
        raise DescriptionError(
            f"the board needs markers {numbers.min()} to {numbers.max()}, and {board.dictionary} has"
            f" {len(markers.bytesList)}; name a larger dictionary"
        )
    counts = (board.columns, board.rows)
    if board.kind != "charuco":
        return cv2.aruco.GridBoard(counts, board.marker, board.gap, markers, numbers)
    charuco = cv2.aruco.CharucoBoard(counts, board.square, board.marker, markers, numbers)
    charuco.setLegacyPattern(legacy)
    return charuco


def marker_numbers(board: Board) -> range:
    """Return the numbers of a board's markers."""
    count = board.columns * board.rows
    return range(board.first_marker, board.first_marker + (count // 2 if board.kind == "charuco" else count))


def _marker_corners(board: Board, columns: int, number: int) -> FloatArray:
    """Corners of marker `number`, counted from 0, if the board had this number of columns, (4, 2) [m]."""
    side = board.marker or 0.0
    square = np.array([(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)])
    if board.kind != "charuco":
        pitch = side + (board.gap or 0.0)
        return square + pitch * np.array([number % columns, number // columns])
    first = 0 if board.legacy and board.rows % 2 == 0 else 1
    cells = ((i, j) for j in count() for i in range(columns) if (i + j) % 2 == first)
    pitch = board.square or 0.0
    return square + (pitch - side) / 2 + pitch * np.array(next(islice(cells, number, None)))


def _charuco(board: object, image: GreyImage) -> dict[str, FloatArray]:
    corners, numbers, _, _ = opencv().aruco.CharucoDetector(board).detectBoard(image)
    if numbers is None:
        return {}
    places = np.asarray(corners, dtype=float).reshape(-1, 2)
    return {f"c{int(k)}": place for k, place in zip(np.ravel(numbers), places, strict=True)}


def _detected_markers(image: GreyImage, name: str) -> tuple[list[FloatArray], list[int]]:
    aruco = opencv().aruco
    settings = aruco.DetectorParameters()
    settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    corners, numbers, _ = aruco.ArucoDetector(dictionary(name), settings).detectMarkers(image)
    if numbers is None:
        return [], []
    return [np.asarray(quad, dtype=float).reshape(4, 2) for quad in corners], [int(k) for k in np.ravel(numbers)]


def _markers(board: Board, image: GreyImage) -> dict[str, FloatArray]:
    board_numbers = marker_numbers(board)
    corners, numbers = _detected_markers(image, board.dictionary or "")
    return {
        f"m{number}.{k}": places[k]
        for places, number in sorted(zip(corners, numbers, strict=True), key=lambda pair: pair[1])
        if number in board_numbers and numbers.count(number) == 1
        for k in range(4)
    }


def _dictionary_in(image: GreyImage) -> str:
    """The dictionary whose markers are in an image; empty if none shows three of them.

    Dictionaries of one family begin with the same markers (the first 50 of DICT_4X4_100 are DICT_4X4_50). So the
    largest of each family is tried, and the smallest with all the markers is returned.
    """
    best, most = "", 2
    for family, sizes in sorted(dictionary_families().items()):
        numbers = set(_detected_markers(image, f"{family}{sizes[-1]}")[1])
        if len(numbers) > most:
            smallest = next(size for size in sizes if not size or int(size[1:]) > max(numbers))
            best, most = f"{family}{smallest}", len(numbers)
    return best


def _chessboard(board: Board, image: GreyImage, *, quick: bool = False) -> dict[str, FloatArray]:
    cv2 = opencv()
    counts = board.columns - 1, board.rows - 1
    if min(counts) < 2:
        return {}
    flags = 0 if quick else cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    done, corners = cv2.findChessboardCornersSB(image, counts, flags=flags)
    if not done:
        return {}
    grid = _from_the_front(np.asarray(corners, dtype=float).reshape(board.rows - 1, board.columns - 1, 2))
    pixels = grid.reshape(-1, 2)
    ways = [pixels, pixels[::-1]]
    contrasts = [_contrast(board, image, way) for way in ways]
    if abs(contrasts[0] - contrasts[1]) < 5:  # grey values: the colours of the squares are unclear
        return {}
    return _numbered(ways[int(np.argmax(contrasts))])


def _from_the_front(grid: FloatArray) -> FloatArray:
    """Pixels of a grid (rows, columns, 2), reversed if necessary so that it is seen from the front."""
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return grid[:, ::-1] if along[0] * down[1] < along[1] * down[0] else grid


def _contrast(board: Board, image: GreyImage, pixels: FloatArray) -> float:
    """Brightness of white minus black squares if the square at the top left of the first corner is black."""
    grid = pixels.reshape(board.rows - 1, board.columns - 1, 2)
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    row, column = np.indices(middles.shape[:2])
    limits = np.array([image.shape[1], image.shape[0]]) - 1
    at = np.clip(np.rint(middles).astype(int), 0, limits)
    values = image[at[..., 1], at[..., 0]].astype(float)
    black = (row + column) % 2 == 0  # middles[0, 0] is in square (1, 1), which has the colour of square (0, 0)
    return float(values[~black].mean() - values[black].mean()) if np.any(~black) else 0.0


def _circles(board: Board, image: GreyImage) -> dict[str, FloatArray]:
    cv2, blobs = opencv(), _blobs(image)
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    done, centres = cv2.findCirclesGrid(image, (board.columns, board.rows), flags=flags, blobDetector=blobs)
    return _numbered(np.asarray(centres, dtype=float).reshape(-1, 2)) if done else {}


def _numbered(places: FloatArray) -> dict[str, FloatArray]:
    """Points (n, 2) by the names of corners and dots."""
    return {f"c{k}": place for k, place in enumerate(places)}


def _blobs(image: GreyImage) -> Any:
    cv2 = opencv()
    settings = cv2.SimpleBlobDetector_Params()
    settings.maxArea = image.size / 50
    settings.minArea = 20
    settings.minDistBetweenBlobs = 5
    return cv2.SimpleBlobDetector_create(settings)


def _dots(board: Board, image: GreyImage) -> dict[str, FloatArray]:
    """Centres of a square grid, from the corner with the largest dot; none if no corner's dot is larger."""
    cv2, blobs = opencv(), _blobs(image)
    for flags in (cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING, cv2.CALIB_CB_SYMMETRIC_GRID):
        done, centres = cv2.findCirclesGrid(image, (board.columns, board.rows), flags=flags, blobDetector=blobs)
        if done:
            break
    else:
        return {}
    found = blobs.detect(image)
    places, sizes = np.array([blob.pt for blob in found]), np.array([blob.size for blob in found])
    grid = _from_the_front(np.asarray(centres, dtype=float).reshape(board.rows, board.columns, 2))
    ways = [np.rot90(grid, k) for k in range(4)]
    ways = [way for way in ways if way.shape == grid.shape]
    size = [float(sizes[np.argmin(np.linalg.norm(places - way[0, 0], axis=1))]) for way in ways]
    if max(size) < _LARGER * float(np.median(sizes)):
        return {}
    return _numbered(ways[int(np.argmax(size))].reshape(-1, 2))


_WITHOUT_MARKERS = {"chessboard": _chessboard, "circles": _circles, "dots": _dots}


def _other_counts(board: Board) -> Iterator[tuple[Board, str]]:
    """Boards without markers with miscounted or exchanged rows and columns, the likeliest first."""
    c, r = board.columns, board.rows
    pairs = [(r, c), (c - 1, r), (c + 1, r), (c, r - 2), (c, r + 2)]  # rows of dots stay odd
    if board.kind == "chessboard":  # inner corners counted, or corners and squares mixed
        pairs = [(r, c), (c + 1, r + 1), (r + 1, c + 1), *((c + i, r + j) for i in (-1, 1) for j in (-1, 1))]
        pairs += [(c - 2, r), (c + 2, r), (c, r - 2), (c, r + 2)]
    for columns, rows in dict.fromkeys(pairs):
        even = (columns + rows) % 2 == 0 if board.kind == "chessboard" else rows % 2 == 0 and board.kind == "circles"
        if not even and min(columns, rows) >= 3 and (columns, rows) != (c, r):
            noun = "squares" if board.kind == "chessboard" else "dots"
            yield board.model_copy(update={"columns": columns, "rows": rows}), noun


def _light_remark(image: GreyImage) -> str:
    dark, bright = np.percentile(image, [1, 99])
    if bright - dark < _FLAT:
        return f"; the image has no contrast (grey values from {dark:.0f} to {bright:.0f} of 255)"
    height, width = image.shape
    edge = edge_width(image, np.array([[0.0, 0.0], [width - 1.0, height - 1.0]]))
    return f"; the image is blurred (edges are {edge:.0f} px wide)" if edge > _BLURRED else ""


def points_on_one_plane(board: Board, points: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the points (2,) [px], by name, that agree with the homography of most points."""
    if len(points) <= FEWEST:
        return points
    places = board.points()
    inside = _are_on_plane(np.array([places[name][:2] for name in points]), np.array(list(points.values())))
    return {name: place for (name, place), keep in zip(points.items(), inside, strict=True) if keep}


def _are_on_plane(on_board: FloatArray, pixels: FloatArray, *, robust: bool = True) -> BoolArray:
    """Mask of the points (n, 2) [m] whose pixels (n, 2) fit a homography of most points; if not `robust`, of all."""
    cv2 = opencv()
    allowed = max(_LEAST_OFF, _OFF * float(np.max(np.ptp(pixels, axis=0))))
    H, inside = cv2.findHomography(on_board, pixels, cv2.RANSAC if robust else 0, allowed)
    if H is None:
        return np.zeros(len(pixels), dtype=bool)
    if robust:
        return np.ravel(inside).astype(bool)
    away = cv2.perspectiveTransform(on_board[None], H)[0] - pixels
    return np.linalg.norm(away, axis=1) < allowed


def edge_width(image: GreyImage, pixels: FloatArray) -> float:
    """Return the width of edges in the rectangle around points (n, 2): contrast over the steepest slopes [px]."""
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    high = np.ceil(pixels.max(axis=0)).astype(int) + 1
    part = image[low[1] : high[1], low[0] : high[0]].astype(float)
    if min(part.shape) < 8:
        return float("nan")
    dark, bright = np.percentile(part, [5, 95])
    slopes = np.hypot(*np.gradient(part))
    steepest = float(np.percentile(slopes, 99))
    return float((bright - dark) / steepest) if steepest > 0 else float("inf")

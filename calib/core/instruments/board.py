"""A printed board and its points. One description serves detection, printing, rendering and the robot.

The board lies in the plane z = 0 of its frame: origin in the corner where its first row and column begin, x along the
rows, y down the columns as one reads the print, z into the paper. That is OpenCV's frame. Points have names:

    chessboard    c0, c1, ...: where four squares meet, row by row
    charuco       the same, with a marker of a dictionary in every second square
    circles       c0, c1, ...: centres of dots, row by row; every second row is shifted by half a column (asymmetric)
    dots          c0, c1, ...: centres of dots in a square grid, row by row from the corner whose dot is larger than the
                  others, which is the top left
    aruco         m<number>.<corner>: corners 0 to 3 of markers in rows and columns, clockwise from the top left one
    apriltag      the same, with tags of the family 36h11 unless another dictionary is named

If a board looked the same after half a turn, its points could be exchanged without notice. So chessboards need an odd
and an even number of squares, and circles an odd number of rows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator

from calib.core.base.errors import DescriptionError, nearest
from calib.core.base.sections import PositiveLength, Section, read_yaml
from calib.core.base.units import quantity_text

BoardKind = Literal["charuco", "chessboard", "circles", "dots", "aruco", "apriltag"]
APRILTAG = "DICT_APRILTAG_36H11"
_NEEDS: dict[str, tuple[str, ...]] = {
    "charuco": ("square", "marker", "dictionary"),
    "chessboard": ("square",),
    "circles": ("spacing",),
    "dots": ("spacing",),
    "aruco": ("marker", "gap", "dictionary"),
    "apriltag": ("marker", "gap", "dictionary"),
}
BOARD_KINDS = tuple(_NEEDS)
_MOST = 100
_LARGEST = 5.0  # largest side [m]; larger ones are numbers without their unit


class Board(Section):
    """A printed board.

    Attributes:
        kind: See the module docstring.
        columns, rows: Number of squares (charuco, chessboard), dots (circles, dots) or markers (aruco, apriltag).
        square: Side of a square [m].
        marker: Side of a marker, black border included [m].
        gap: Distance between neighbouring markers [m].
        spacing: Distance between rows of dots [m]; for circles also half of the distance between dots in a row.
        dictionary: OpenCV's name of the dictionary of markers, such as DICT_6X6_250.
        first_marker: Number of the first marker.
        first_row: Row from which markers are counted: `bottom` on boards of Kalibr.
        legacy: Whether a ChArUco board has the layout of OpenCV before 4.6, which has a marker in its first square
            where the number of rows is even; None: not known, both are tried.
    """

    kind: BoardKind
    columns: int = Field(ge=1, le=_MOST)
    rows: int = Field(ge=1, le=_MOST)
    square: PositiveLength | None = None
    marker: PositiveLength | None = None
    gap: PositiveLength | None = None
    spacing: PositiveLength | None = None
    dictionary: str | None = None
    first_marker: int = Field(default=0, ge=0)
    first_row: Literal["top", "bottom"] = "top"
    legacy: bool | None = None

    @model_validator(mode="before")
    @classmethod
    def _family(cls, value: Any) -> Any:
        if isinstance(value, dict) and value.get("kind") == "apriltag":
            value = {"dictionary": APRILTAG, **value}
        if isinstance(value, dict) and value.get("columns") == value.get("rows") == 1 and "marker" in value:
            return {"gap": value["marker"], **value}  # one marker alone has no neighbour
        return value

    @model_validator(mode="after")
    def _complete(self) -> Board:
        needs = _NEEDS[self.kind]
        for key in ("square", "marker", "gap", "spacing", "dictionary"):
            given = getattr(self, key) is not None
            if given != (key in needs):
                raise ValueError(
                    f"a board of kind {self.kind} {'needs' if not given else 'has no'} '{key}'; its keys are columns,"
                    f" rows, {', '.join(needs)}"
                )
        if min(self.columns, self.rows) < 2 and self.kind not in ("aruco", "apriltag"):
            raise ValueError(f"a board of kind {self.kind} needs two or more columns and rows")
        if max(self.size) > _LARGEST:
            raise ValueError(f"the board would be {max(self.size):g} m wide; write the unit of its sizes, such as 30mm")
        if self.first_row == "bottom" and self.kind not in ("aruco", "apriltag"):
            raise ValueError("'first_row' is for boards of markers")
        if self.kind == "charuco" and not (self.marker or 0) < (self.square or 0):
            raise ValueError("'marker' must be smaller than 'square'")
        if self.legacy is not None and self.kind != "charuco":
            raise ValueError("'legacy' is for charuco boards")
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise ValueError(
                f"a chessboard of {self.columns} x {self.rows} squares looks the same turned by half a turn, so that"
                " its points could be exchanged; use one with an odd and an even number of squares (count squares, not"
                " inner corners)"
            )
        if self.kind == "circles" and self.rows % 2 == 0:
            raise ValueError(
                f"circles in {self.rows} rows look the same turned by half a turn; use an odd number of rows (4x11:"
                " rows of 4 dots, 11 of them); a square grid with one larger dot in a corner is kind dots"
            )
        return self

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the printed pattern [m]."""
        step = self.square or self.spacing or 0.0
        if self.kind in ("charuco", "chessboard"):
            return self.columns * step, self.rows * step
        if self.kind in ("circles", "dots"):
            return ((2 if self.kind == "circles" else 1) * self.columns + 1) * step, (self.rows + 1) * step
        pitch, gap = (self.marker or 0.0) + (self.gap or 0.0), self.gap or 0.0
        return self.columns * pitch - gap, self.rows * pitch - gap

    @property
    def smallest(self) -> float:
        """Smallest feature that a camera must resolve: a marker, a square, or the distance of dots [m]."""
        return self.marker or self.square or self.spacing or 0.0

    def marker_at(self, column: int, row: int) -> int:
        """Return the number of the marker in a column and a row, counted from 0, of a board of markers."""
        counted = row if self.first_row == "top" else self.rows - 1 - row
        return self.first_marker + counted * self.columns + column

    def points(self) -> dict[str, tuple[float, float, float]]:
        """Return the position of each point in the board's frame, by name [m]."""
        if self.kind in ("aruco", "apriltag"):
            side, pitch = self.marker or 0.0, (self.marker or 0.0) + (self.gap or 0.0)
            around = ((0.0, 0.0), (side, 0.0), (side, side), (0.0, side))
            return {
                f"m{self.marker_at(i, j)}.{k}": (i * pitch + dx, j * pitch + dy, 0.0)
                for j in range(self.rows)
                for i in range(self.columns)
                for k, (dx, dy) in enumerate(around)
            }
        step, between = self.square or self.spacing or 0.0, int(self.kind in ("charuco", "chessboard"))
        every = [(i, j) for j in range(self.rows - between) for i in range(self.columns - between)]
        if self.kind == "circles":
            every = [(2 * i + j % 2, j) for i, j in every]
        return {f"c{k}": ((i + 1) * step, (j + 1) * step, 0.0) for k, (i, j) in enumerate(every)}

    def __str__(self) -> str:
        shapes = {"circles": "dots", "dots": "dots", "aruco": "markers", "apriltag": "tags"}.get(self.kind, "squares")
        numbers = [
            f"{key} {quantity_text(value, 'mm', 'g')}"
            for key in ("square", "marker", "gap", "spacing")
            if (value := getattr(self, key)) is not None
        ]
        sizes = ", ".join([*numbers, *filter(None, [self.dictionary])])
        return f"{self.kind} of {self.columns} x {self.rows} {shapes}, {sizes}"


def validate_board(content: object, where: str) -> Board:
    """Return the board from the content of a file or an option; `where` names it in a `DescriptionError`."""
    if not isinstance(content, dict):
        raise DescriptionError(f"{where}: is not a mapping of keys to values such as kind, columns, rows, square")
    kind = content.get("kind")
    if kind not in BOARD_KINDS:
        raise DescriptionError(f"{where}: unknown kind of board '{kind}'{nearest(str(kind), BOARD_KINDS)}")
    try:
        return Board.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            raise DescriptionError(f"{where}: key '{key}' is missing") from None
        text = first["msg"].removeprefix("Value error, ")
        raise DescriptionError(f"{where}: {key + ': ' if key else ''}{text}") from None


def read_board(text: str, where: str, folder: Path | None = None) -> Board:
    """Return the board of a YAML file in `folder`, or of its short form, such as chessboard:9x6:25mm.

    `DescriptionError` if the text is no file and no short form (`where` names it), or a key is missing or wrong.
    """
    kind, colon, rest = text.partition(":")
    path = (folder or Path()) / text
    if path.suffix.lower() in (".yaml", ".yml") or path.is_file():
        content = read_yaml(path, "a board (YAML: kind, columns, rows, sizes), or its short form")
        return validate_board(_board_of_file(content, str(path)) if isinstance(content, dict) else content, str(path))
    if not colon and kind not in BOARD_KINDS:
        raise DescriptionError(f"{where}: is neither a YAML file nor a kind of board{nearest(kind, BOARD_KINDS)}")
    if kind not in _NEEDS:
        raise DescriptionError(f"{where}: unknown kind of board '{kind}'{nearest(kind, BOARD_KINDS)}")
    needs, (counts, *values) = _NEEDS[kind], rest.split(":")
    columns, times, rows = counts.partition("x")
    optional = kind == "apriltag" and len(values) == len(needs) - 1
    if not (times and columns.isdigit() and rows.isdigit()) or not (len(values) == len(needs) or optional):
        raise DescriptionError(f"{where}: write it as {kind}:COLUMNSxROWS:{':'.join(key.upper() for key in needs)}")
    sizes = dict(zip(needs, values, strict=False))
    return validate_board({"kind": kind, "columns": int(columns), "rows": int(rows)} | sizes, where)


def _board_of_file(content: dict[str, Any], where: str) -> Any:
    """Content of a board from a file of ours, of Kalibr, or of ROS-Industrial."""
    if "target_type" in content:
        return _board_of_kalibr(content, where)
    target = content.get("target_finder", content)
    if isinstance(target, dict) and {"rows", "cols", "spacing"} <= set(target):
        # ROS-Industrial's grid: its larger dot is at the bottom left, ours at the top left: a quarter turn
        return {"kind": "dots", "columns": target["rows"], "rows": target["cols"], "spacing": target["spacing"]}
    inner = content.get("board")
    return inner if isinstance(inner, dict) else content


def _board_of_kalibr(content: dict[str, Any], where: str) -> dict[str, Any]:
    """Content of a board from a target file of Kalibr, whose tags are counted from the bottom left."""
    kind, keys = content["target_type"], ("tagCols", "tagRows", "tagSize", "tagSpacing")
    counts = ("targetCols", "targetRows", "rowSpacingMeters")
    if kind == "checkerboard" and all(isinstance(content.get(key), (int, float)) for key in counts):
        return {
            "kind": "chessboard",
            "columns": int(content["targetCols"]) + 1,  # Kalibr counts inner corners
            "rows": int(content["targetRows"]) + 1,
            "square": content["rowSpacingMeters"],
        }
    dots = ("targetCols", "targetRows", "spacingMeters")
    if kind == "circlegrid" and content.get("asymmetricGrid") and all(key in content for key in dots):
        columns, rows, spacing = (content[key] for key in dots)
        return {"kind": "circles", "columns": columns, "rows": rows, "spacing": spacing}
    if kind != "aprilgrid" or not all(isinstance(content.get(key), (int, float)) for key in keys):
        raise DescriptionError(
            f"{where}: is a target file of Kalibr, of which aprilgrid ({', '.join(keys)}), checkerboard"
            f" ({', '.join(counts)}) and asymmetric circlegrid ({', '.join(dots)}) are read; write this one as kind,"
            " columns, rows and sizes. A symmetric grid looks the same after a turn, unless the dot of one corner is"
            " larger (kind dots)"
        )
    columns, rows, size, spacing = (content[key] for key in keys)
    return {
        "kind": "apriltag",
        "columns": int(columns),
        "rows": int(rows),
        "marker": float(size),
        "gap": float(size) * float(spacing),
        "first_row": "bottom",
    }

"""The entry of a camera in a robot description, and the points that it sees.

Points of a body come by name from a CSV file: columns `point`, `x`, `y`, `z`, with units in the header.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from calib.core.base.errors import DescriptionError
from calib.core.base.files import read_text
from calib.core.base.sections import Length, PosedSection, PositiveLength, Section
from calib.core.base.units import per_si, split_column
from calib.core.instruments.board import Board, read_board, validate_board
from calib.core.instruments.kind import InstrumentSection

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[_Number, Field(gt=0)]
_COLUMNS = ("point", "x", "y", "z")


def _folder(info: ValidationInfo) -> Path:
    """Folder of the description; files that it names are relative to it."""
    return (info.context or {}).get("folder", Path())


def _board(given: Any, info: ValidationInfo) -> Any:
    """The board of a mapping, of a file, or of its short form."""
    if given is None or isinstance(given, Board):
        return given
    try:
        if isinstance(given, str):
            return read_board(given, f"board: {given}", _folder(info))
        return validate_board(given, "board")
    except DescriptionError as error:
        raise ValueError(str(error).removeprefix("board: ")) from None


class CameraSection(PosedSection):
    """Pose of a camera: its optical frame, z along the optical axis, x to the right and y down in the image."""

    what = "a camera"
    pose: Literal["known", "unknown"] = "unknown"


class IntrinsicsSection(Section):
    """Numbers of the camera model, as OpenCV calls them [px and pure numbers]."""

    fx: _Positive
    fy: _Positive
    cx: _Number
    cy: _Number
    k1: _Number = 0.0
    k2: _Number = 0.0
    p1: _Number = 0.0
    p2: _Number = 0.0
    k3: _Number = 0.0


class UnknownIntrinsicsSection(Section):
    """Expected errors of intrinsics; intrinsics without one are exact."""

    fx: _Positive | None = None
    fy: _Positive | None = None
    cx: _Positive | None = None
    cy: _Positive | None = None
    k1: _Positive | None = None
    k2: _Positive | None = None
    p1: _Positive | None = None
    p2: _Positive | None = None
    k3: _Positive | None = None


class PixelSection(InstrumentSection):
    """A camera that sees points of a target frame.

    Attributes:
        target: The frame of the body that carries the points.
        camera: Place of the camera.
        intrinsics: The camera's model.
        unknown_intrinsics: Expected errors of intrinsics that the measurements must find.
        points: Position of each point in the target frame, by name [m].
        points_file: A CSV file of such points, columns point, x, y, z; its path is relative to the description.
        board: A printed board (`calib.core.instruments.board`), or the YAML file that describes it, in place of points;
            the target frame is then the board's.
        image: Width and height [px]; points outside are not seen. Only predictions need it.
        focus: Smallest and largest distance along its axis of a sharp image [m]. Only predictions need it.
        columns: First part of the columns' names: `<columns>_u`, `<columns>_v`; the instrument's name if left out.
        sigma: Noise of a coordinate [px].
    """

    target: str
    camera: CameraSection
    intrinsics: IntrinsicsSection
    unknown_intrinsics: UnknownIntrinsicsSection | None = None
    points: dict[str, tuple[Length, Length, Length]] = Field(default_factory=dict)
    points_file: str | None = None
    board: Annotated[Board | None, BeforeValidator(_board, json_schema_input_type=Board | str | None)] = None
    image: tuple[_Positive, _Positive] | None = None
    focus: tuple[PositiveLength, PositiveLength] | None = None
    columns: str | None = None
    sigma: _Positive | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, value: Any, info: ValidationInfo) -> Any:
        """Replace a file of points by its points; refuse more than one of points, file and board."""
        if not isinstance(value, dict):
            return value
        sources = [key for key in ("points", "points_file", "board") if value.get(key)]
        if len(sources) > 1:
            raise ValueError(f"has {sources[0]} and {sources[1]}; leave one of them out")
        file = value.get("points_file")
        if not isinstance(file, str):
            return value
        rest = {key: entry for key, entry in value.items() if key != "points_file"}
        try:
            return {**rest, "points": read_points(_folder(info) / file)}
        except DescriptionError as error:
            raise ValueError(str(error)) from None

    @model_validator(mode="after")
    def _some_points(self) -> PixelSection:
        if not self.points and self.board is None:
            raise ValueError("needs points (name: [x, y, z]), points_file or board")
        if self.focus is not None and not self.focus[0] < self.focus[1]:
            raise ValueError("focus: needs the smaller distance first, such as [250 mm, 900 mm]")
        return self


def read_points(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return points by name [m]; a `DescriptionError` names the line of a mistake."""
    lines = read_text(path, "a CSV file with columns point, x, y, z", DescriptionError).splitlines()
    rows = [(k, row) for k, row in enumerate(csv.reader(lines), 1) if row and not row[0].lstrip().startswith("#")]
    header = [split_column(cell) for cell in rows[0][1]] if rows else []
    names = [name for name, _ in header]
    missing = next((name for name in _COLUMNS if name not in names), None)
    if missing is not None:
        raise DescriptionError(f"{path}: no column '{missing}'; expected point, x, y, z")
    place = [names.index(name) for name in _COLUMNS]
    divisors = [per_si(header[k][1], "length", f"{path}, column '{names[k]}'", DescriptionError) for k in place[1:]]
    points: dict[str, tuple[float, float, float]] = {}
    for line, row in rows[1:]:
        if len(row) != len(names):
            raise DescriptionError(f"{path}, line {line}: {len(row)} cells for {len(names)} columns")
        name = row[place[0]].strip()
        if not name or name in points:
            raise DescriptionError(f"{path}, line {line}: {f'point {name!r} comes twice' if name else 'has no name'}")
        x, y, z = (_number(row[k], f"{path}, line {line}, column '{names[k]}'") for k in place[1:])
        points[name] = (x / divisors[0], y / divisors[1], z / divisors[2])
    if not points:
        raise DescriptionError(f"{path}: has no points")
    return points


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DescriptionError(f"{where}: '{cell.strip():.60}' is not a number")
    return value

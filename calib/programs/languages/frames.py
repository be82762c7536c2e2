"""Tools and frames of programs, selected or declared elsewhere, and tables of them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pinocchio as pin

from calib.core.base.errors import DataError
from calib.core.data.tables import read_table
from calib.programs.languages.control_flow import Unknown
from calib.programs.languages.orientations import pose_of
from calib.programs.languages.robot_program import LeftOutError
from calib.programs.languages.visits import Place


@dataclass(frozen=True)
class Frame:
    """Pose of a tool or frame, and the places of the program's data that define it."""

    pose: pin.SE3 = field(default_factory=pin.SE3.Identity)
    places: tuple[Place, ...] = ()


Frames = Mapping[str, Frame | Unknown]
"""Tools and frames by name."""


def as_selected_frame(what: str, value: Hashable) -> Frame:
    """Return the selected tool or frame; `what` names it in messages.

    Raises:
        LeftOutError: Its value is unknown.
    """
    if not isinstance(value, Frame):
        unknown = value if isinstance(value, Unknown) else Unknown("is not known")
        raise LeftOutError(unknown.why if unknown.whole else f"{what} {unknown.why}")
    return value


def read_frames(path: Path | str) -> dict[str, Frame | Unknown]:
    """Read a table of tools and frames that a program uses without declaring them.

    Columns: `name`; x, y, z [m]; rx, ry, rz [rad], about fixed axes. A tool is given in the flange, a frame in the
    robot's base.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path)
    if "name" not in table.names:
        raise DataError(f"{path}: no column 'name'; it says what the program calls each tool and frame")
    names = [name.upper().replace(" ", "") for name in table.text("name")]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DataError(f"{path}: '{twice}' is given twice; give each tool and frame once")
    columns = [table.column(name, "length") for name in "xyz"]
    columns += [table.column(name, "angle") for name in ("rx", "ry", "rz")]
    return {name: Frame(pose_of(row, "xyz")) for name, *row in zip(names, *columns, strict=True)}

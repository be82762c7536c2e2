"""Table I of the paper: the 36 parameters of MedRUE, in SI units.

The file `paper/table1.csv` holds the values as printed, in mm and degrees. This module converts them once,
so that the rest of the package sees metres and radians only. A length is converted in decimal arithmetic
(166.8 mm is exactly the float 0.1668), which keeps the numbers in the URDF short.

Table I prints non-zero nominal joint offsets, Table III prints zero. The nominal offsets are zero here
(column `nominal`); the printed ones stay available in the column `nominal_as_printed`.

Reference: joubair2015 (A. Joubair, L. F. Zhao, P. Bigras, I. Bonev, "Absolute accuracy analysis and
improvement of a hybrid 6-DOF medical robot", Industrial Robot 42(1), 2015, Table I).
"""

import csv
import math
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

LENGTHS = ("L11", "L12", "L13", "L14", "L21", "L22", "L23", "L24")
ANCHORS = ("A1y", "A1z", "C1y", "C1z", "A2y", "A2z", "C2y", "C2z")
TOOL_PART_OFFSETS = ("d31", "d32", "d41", "d42", "d5")
JOINT_OFFSETS = ("dq1", "dq2", "dq3", "dq4", "dq5", "dq6")
BASE_IN_WORLD = ("xb", "yb", "zb", "phi_bx", "phi_by", "phi_bz")
TOOL_POINT = ("xt", "yt", "zt")

PARAMETERS = ANCHORS + LENGTHS + TOOL_PART_OFFSETS + JOINT_OFFSETS + BASE_IN_WORLD + TOOL_POINT
"""Names of the 36 parameters, in the order of Table I. Every parameter vector of this package has this order."""


@dataclass(frozen=True)
class Table1:
    """The columns of Table I, each with shape `(36,)`, in the order of `names`, in m and rad.

    Attributes:
        names: Parameter names.
        units: SI unit of each parameter, "m" or "rad".
        nominal: Nominal values used by this package (joint offsets zero).
        nominal_as_printed: Nominal values as Table I prints them (joint offsets not zero).
        actual: Values of the simulated robot.
        identified_without_noise: Values that the paper identifies without measurement noise.
        identified_with_noise: Values that the paper identifies with measurement noise.
        redundant: Names of the parameters that the paper removes because the others replace them.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: NDArray[np.float64]
    nominal_as_printed: NDArray[np.float64]
    actual: NDArray[np.float64]
    identified_without_noise: NDArray[np.float64]
    identified_with_noise: NDArray[np.float64]
    redundant: tuple[str, ...]


@cache
def table1() -> Table1:
    """Read Table I from the package.

    Returns:
        The table; its arrays are read-only.

    Raises:
        ValueError: The file does not list the parameters in the expected order, or holds an unknown unit.
    """
    text = files("medrue").joinpath("paper", "table1.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    names = tuple(row["parameter"] for row in rows)
    if names != PARAMETERS:
        raise ValueError(f"paper/table1.csv lists {names}, expected {PARAMETERS}")
    return Table1(
        names=names,
        units=tuple("m" if row["unit"] == "mm" else "rad" for row in rows),
        nominal=_column(rows, "nominal"),
        nominal_as_printed=_column(rows, "nominal_as_printed"),
        actual=_column(rows, "actual"),
        identified_without_noise=_column(rows, "identified_without_noise"),
        identified_with_noise=_column(rows, "identified_with_noise"),
        redundant=tuple(row["parameter"] for row in rows if row["redundant"] == "yes"),
    )


def _column(rows: list[dict[str, str]], name: str) -> NDArray[np.float64]:
    """One column of the file in SI units, read-only, `(36,)`."""
    values = np.array([_to_si(row[name], row["unit"]) for row in rows])
    values.setflags(write=False)
    return values


def _to_si(text: str, unit: str) -> float:
    """A number in mm or degrees as m or rad."""
    if unit == "mm":
        return float(Decimal(text) / 1000)
    if unit == "deg":
        return math.radians(float(text))
    raise ValueError(f"paper/table1.csv: unit {unit!r} is neither mm nor deg")

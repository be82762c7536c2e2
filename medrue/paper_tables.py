"""The paper's printed tables: parameters (I, III) in SI units, position errors (II, IV, V) in mm.

The files `paper/table1.csv` to `table5.csv` hold the values as printed, in mm and degrees. Parameters are converted
here once, so that the rest of the package sees metres and radians only. A length is converted in decimal arithmetic
(166.8 mm is exactly the float 0.1668), which keeps the numbers in the URDF short. Errors are only ever shown, so they
stay in mm.

Table I prints non-zero nominal joint offsets, Table III prints zero. The nominal offsets are zero here
(column `nominal`); the printed ones stay available in the column `nominal_as_printed`.

Reference: joubair2015 (A. Joubair, L. F. Zhao, P. Bigras, I. Bonev, "Absolute accuracy analysis and
improvement of a hybrid 6-DOF medical robot", Industrial Robot 42(1), 2015, Tables I to V).
"""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from importlib.resources import files
from types import MappingProxyType

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

    @property
    def reach(self) -> NDArray[np.float64]:
        """Largest errors of the actual parameters that the paper draws, (36,) [m, rad]."""
        return np.where(np.array(self.units) == "m", 2e-3, np.radians(1.5))


@cache
def table1() -> Table1:
    """Read Table I from the package; its arrays are read-only."""
    rows = _parameter_rows("table1.csv")
    return Table1(
        names=PARAMETERS,
        units=tuple("m" if row["unit"] == "mm" else "rad" for row in rows),
        nominal=_column(rows, "nominal"),
        nominal_as_printed=_column(rows, "nominal_as_printed"),
        actual=_column(rows, "actual"),
        identified_without_noise=_column(rows, "identified_without_noise"),
        identified_with_noise=_column(rows, "identified_with_noise"),
        redundant=tuple(row["parameter"] for row in rows if row["redundant"] == "yes"),
    )


@dataclass(frozen=True)
class Table3:
    """Table III: what the experiment identified, each `(36,)` in the order of `PARAMETERS`, in m and rad.

    Attributes:
        nominal: Nominal values.
        identified: Identified values; the redundant ones are nominal.
    """

    nominal: NDArray[np.float64]
    identified: NDArray[np.float64]


@cache
def table3() -> Table3:
    """Read Table III from the package; its arrays are read-only."""
    rows = _parameter_rows("table3.csv")
    return Table3(nominal=_column(rows, "nominal"), identified=_column(rows, "identified"))


ErrorTable = Mapping[str, Mapping[str, float]]
"""Position errors in mm: column (`before`, `O1`, ...), then row (`mean`, `max`, `std`)."""


@cache
def error_table(number: int) -> ErrorTable:
    """Read a table of printed position errors [mm] from the package, by column, then by row; it is read-only.

    2: simulation, by index; 4: experiment, by index; 5: experiment with O1, by axis.
    """
    rows = _rows(f"table{number}.csv")
    columns = [name for name in rows[0] if name != "error_mm"]
    return MappingProxyType(
        {name: MappingProxyType({row["error_mm"]: float(row[name]) for row in rows}) for name in columns}
    )


def _rows(name: str) -> list[dict[str, str]]:
    text = files("medrue").joinpath("paper", name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def _parameter_rows(name: str) -> list[dict[str, str]]:
    """Rows of a table of parameters."""
    rows = _rows(name)
    assert tuple(row["parameter"] for row in rows) == PARAMETERS, name
    return rows


def _column(rows: list[dict[str, str]], name: str) -> NDArray[np.float64]:
    """One column of the file in SI units, read-only, `(36,)`."""
    values = np.array([_to_si(row[name], row["unit"]) for row in rows])
    values.setflags(write=False)
    return values


def _to_si(text: str, unit: str) -> float:
    """A number in mm or degrees as m or rad."""
    return float(Decimal(text) / 1000) if unit == "mm" else math.radians(float(text))

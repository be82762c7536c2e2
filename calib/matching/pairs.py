"""Pairs of joint values and poses that a controller prints: their columns, and their rounding steps.

Columns are found by the manufacturers' words. Without such words or a header, the numbers of a line are joint values,
x, y, z, and the rotation, in this order. `calib.matching.readings` finds units and meaning of the numbers, of which a
`Convention` is one form of rotations.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, ReadOnlyArrays, evenly_spread
from calib.core.base.errors import DataError
from calib.core.base.files import read_text
from calib.core.base.words import count_noun
from calib.core.data.layouts import is_comment
from calib.core.data.tables import Table, read_table
from calib.core.instruments.rotations import Form, not_rotations
from calib.core.judging.rounded_joint_values import usual_step


@dataclass(frozen=True)
class Convention:
    """A form of rotations.

    Attributes:
        form: Its name; three axes in scipy's notation (capitals: moving axes).
        width: Numbers of a rotation.
        makers: Manufacturers that use it.
    """

    form: str
    width: int = 3
    makers: str = ""

    @property
    def has_angles(self) -> bool:
        """Whether the numbers of a rotation are angles, which have a unit."""
        return self.width == 3

    def rotation(self, numbers: FloatArray) -> scipy.spatial.transform.Rotation:
        """Return the rotations of numbers (n, width), angles in rad."""
        of = scipy.spatial.transform.Rotation
        if self.form == "rotation vector":
            return of.from_rotvec(numbers.copy())
        if self.form == "matrix":
            return of.from_matrix(numbers.reshape(-1, 3, 3))
        if self.width == 4:
            return of.from_quat(numbers, scalar_first=self.form.startswith("qw"))
        return of.from_euler(self.form, numbers)

    def __str__(self) -> str:
        axes = f"angles about {'moving' if self.form.isupper() else 'fixed'} axes" if len(self.form) == 3 else ""
        description = ", ".join(filter(None, (axes, self.makers)))
        return f"{self.form} ({description})" if description else self.form


_SEQUENCES = sorted({a + b + c for a, b in permutations("XYZ", 2) for c in "XYZ" if c != b})
_MAKERS = {"xyz": "FANUC's W P R, roll pitch yaw", "ZYX": "KUKA's A B C", "XYZ": "Stäubli's rx ry rz", "ZYZ": "O A T"}
CONVENTIONS = (
    Convention("rotation vector", makers="UR's rx ry rz"),
    *(Convention(axes, makers=_MAKERS.get(axes, "")) for axes in (*_SEQUENCES, *map(str.lower, _SEQUENCES))),
    Convention("qx qy qz qw", 4),
    Convention("qw qx qy qz", 4),
    Convention("matrix", 9),
)
HEADERS = {
    "qx qy qz qw": "qx qy qz qw",
    "q1 q2 q3 q4": "qw qx qy qz",
    "w p r": "xyz",
    "a b c": "ZYX",
    "o a t": "ZYZ",
    "roll pitch yaw": "xyz",
    "alpha beta gamma": "XYZ",
    "rx ry rz": "",
    "thetax thetay thetaz": "xyz",
    " ".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)): "matrix",
}
"""Endings of column names, and the form that they mean; rx ry rz are ambiguous."""


_TYPED = 0.1  # deviation of a rotation that was typed or rounded
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_STEMS = ("j", "joint", "axis", "a", "rax", "ax", "theta", "q", "actualq", "jointposition", "actualjointpositions")
"""Beginnings of joint column names, the most certain first: q1 to q4 may be a quaternion."""
_WIDTHS = (3, 4, 9)
_POSES = ("pose", "otee")
"""Parts of the names of numbered pose columns: UR's actual_TCP_pose_0, Franka's O_T_EE_0."""
_NUMBERED = {6: tuple(range(6)), 7: tuple(range(7)), 16: (12, 13, 14, 0, 4, 8, 1, 5, 9, 2, 6, 10)}
"""Indices of x, y, z and of the rotation, by the count of numbers; 16 are a matrix, column by column."""


@dataclass(frozen=True, eq=False)
class Pairs(ReadOnlyArrays):
    """Joint values and poses of a file, in its units.

    Attributes:
        path: The file.
        rows: Name of each row in messages, (n,).
        joints: (n, n_joints), in units of the file.
        positions: Positions in the units of the file, (n, 3).
        rotations: Rotations in the units of the file, (n, 3, 4 or 9).
        units: Units of each joint, of positions and of rotations, or None where the file states none.
        steps: Rounding steps of each joint, of positions and of rotations, in units of the file, (n_joints + 2,).
        words: Key in `HEADERS` for the names of the rotation's columns; empty if they have none.
    """

    path: str
    rows: tuple[str, ...]
    joints: FloatArray
    positions: FloatArray
    rotations: FloatArray
    units: tuple[str | None, ...]
    steps: FloatArray
    words: str

    def __len__(self) -> int:
        return len(self.joints)

    def evenly(self, most: int) -> Pairs:
        """Return at most `most` pairs, evenly spread over the file, since a log has thousands of similar pairs."""
        kept = evenly_spread(len(self), most)
        arrays = {name: getattr(self, name)[kept] for name in ("joints", "positions", "rotations")}
        return replace(self, rows=tuple(self.rows[k] for k in kept), **arrays)


def read_pairs(path: Path | str, joint_names: Sequence[str]) -> Pairs:
    """Read a file of pairs.

    Args:
        path: A table with a header, or lines of numbers alone, such as `[j1, ..., j6], p[x, y, z, rx, ry, rz]`.
        joint_names: Names of the robot's joints, in its order.

    Raises:
        DataError: Columns are missing or ambiguous.
    """
    table = _without_header(path) or read_table(path)
    names = [re.sub(r"[\W_]", "", name.casefold()) for name in table.names]
    joints = _joint_columns(table, names, joint_names)
    positions, rotations, words = _pose_columns(names, joints)
    if not (joints and positions and rotations):
        order, n = list(range(len(names))), len(joint_names)
        if len(names) - n - 3 not in _WIDTHS:
            raise DataError(
                f"{path}: {count_noun(n, 'joint value')}, x, y, z and a rotation of 3, 4 or 9 numbers are needed in"
                f" each row; name the columns, such as {joint_names[0]}, x, rx, qw, or leave out all others (found:"
                f" {', '.join(table.names)})"
            )
        joints, positions, rotations = order[:n], order[n : n + 3], order[n + 3 :]
    used = (*joints, *positions, *rotations)
    plain = replace(table, units=tuple("1" if k in used else None for k in range(len(names))))
    numbers = {k: plain.column(table.names[k], "number") for k in used}
    units = (*(table.units[k] for k in joints), _unit(table, positions), _unit(table, rotations))
    steps = [_step(table, columns, numbers) for columns in (*([k] for k in joints), positions, rotations)]
    q, p, r = (np.stack([numbers[k] for k in columns], axis=1) for columns in (joints, positions, rotations))
    rows = tuple(f"line {line}" for line in table.lines)
    forms: dict[int, Form] = {4: "quaternion", 9: "matrix"}
    if len(rotations) in forms:
        bad, what = not_rotations(forms[len(rotations)], r, _TYPED)
        if len(bad):
            raise DataError(f"{path}, {rows[bad[0]]}: the rotation is not {what}; correct it, or leave the row out")
    return Pairs(str(path), rows, q, p, r, units, np.array(steps), words)


def _without_header(path: Path | str) -> Table | None:
    """The numbers of each line if the first line is no header; None for a table."""
    if not str(path).lower().endswith((".csv", ".txt", ".log", ".dat", ".tsv")):
        return None
    lines = list(enumerate(read_text(path, "a file of pairs", DataError).splitlines(), start=1))
    kept = [(number, line) for number, line in lines if line.strip() and not is_comment(line)]
    if not kept or re.search(r"[A-DF-OQ-Za-df-oq-z]", kept[0][1]):  # e is part of a number, p of a pose of UR
        return None
    rows = [(number, tuple(_NUMBER.findall(line))) for number, line in kept]
    width = len(rows[0][1])
    odd = next((number for number, cells in rows if len(cells) != width), None)
    if odd is not None:
        raise DataError(f"{path}, line {odd}: has a different count of numbers than line {rows[0][0]} ({width})")
    names = tuple(f"number {k + 1}" for k in range(width))
    cells = tuple(cells for _, cells in rows)
    return Table(str(path), names, (None,) * width, cells, tuple(number for number, _ in rows), (), ",")


def _series(names: list[str]) -> dict[str, dict[int, int]]:
    """Numbered columns, by the text before the number: number to column."""
    series: dict[str, dict[int, int]] = {}
    for k, name in enumerate(names):
        if match := re.fullmatch(r"(.*?)(\d+)(?:deg|rad|pos|position)?", name):
            series.setdefault(match[1], {})[int(match[2])] = k
    return series


def _joint_columns(table: Table, names: list[str], joint_names: Sequence[str]) -> list[int]:
    """Columns of the joints: by the robot's names, or numbered with a stem for joints."""
    if all(name in table.names for name in joint_names):
        return [table.names.index(name) for name in joint_names]
    series, n = _series(names), len(joint_names)
    for stem in sorted(series, key=lambda stem: _STEMS.index(stem) if stem in _STEMS else len(_STEMS)):
        for first in (1, 0):
            if all(first + k in series[stem] for k in range(n)):
                return [series[stem][first + k] for k in range(n)]
    return []


def _pose_columns(names: list[str], joints: Sequence[int]) -> tuple[list[int], list[int], str]:
    """Columns of positions and of rotations, and the header's word for these; empty if names do not show it."""
    for stem, columns in _series(names).items():
        order = _NUMBERED.get(len(columns))
        if order is not None and any(word in stem for word in _POSES) and not set(columns.values()) & set(joints):
            numbers = [columns[k] for k in sorted(columns)]
            return [numbers[k] for k in order[:3]], [numbers[k] for k in order[3:]], ""
    turns = tuple(ending for words in HEADERS for ending in words.split())
    left = [k for k in range(len(names)) if k not in joints]
    ends = [[k for k in left if names[k].endswith(axis) and not names[k].endswith(turns)][:1] for axis in "xyz"]
    positions = [k for found in ends for k in found] if all(ends) else []
    left = [k for k in left if k not in positions]
    for words in HEADERS:
        rotations = [next((k for k in left if names[k].endswith(ending)), -1) for ending in words.split()]
        if -1 not in rotations and len(set(rotations)) == len(rotations):
            return positions, rotations, words
    after = [k for k in left if k > max((*joints, *positions), default=-1)]
    return positions, after if len(after) in _WIDTHS else [], ""


def _unit(table: Table, columns: Sequence[int]) -> str | None:
    units = {table.units[k] for k in columns}
    if len(units) > 1:
        names = ", ".join(table.names[k] for k in columns)
        raise DataError(f"{table.path}: columns {names} have different units; write them in one")
    return units.pop()


def _step(table: Table, columns: Sequence[int], numbers: dict[int, FloatArray]) -> float:
    """Rounding step of columns: the largest usual step that divides all numbers, or the cells' median last digit."""
    values = np.concatenate([numbers[k] for k in columns])
    decimals = [
        len(mantissa.strip().replace(",", ".").partition(".")[2]) - int(exponent or 0)
        for k in columns
        for mantissa, _, exponent in (text.lower().partition("e") for text in table.text(table.names[k]))
    ]
    return max(usual_step(values), float(10.0 ** -np.median(decimals)))

"""Programs of robot controllers: their targets, and the places of the targets' numbers in the text.

A program is bytes. The language's reader finds the numbers of the targets; only these change in the written file. A
target is joint values, or a pose of a tool:

    T_base_flange = T_base_frame P T_flange_tool^-1

with P the pose as written, in the frame (user frame, work object, base) and with the tool that hold at the move. A
target that the program computes at run time, or reaches with two different tools or frames, is not compensated; it is
listed with its line and the reason.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import pinocchio as pin

from calib.core.base.errors import DataError
from calib.core.base.files import read_bytes
from calib.core.base.units import PER_SI
from calib.programs.languages.orientations import Rotation, numbers_of, pose_of

DEGREE, MILLIMETRE = 1 / PER_SI["angle"]["deg"], 1 / PER_SI["length"]["mm"]
_DECIMALS = {1.0: 7, MILLIMETRE: 4, DEGREE: 5}  # least number of decimals, by unit
_QUATERNION_DECIMALS = 9
_LARGEST = 1e6


class LeftOutError(Exception):
    """A target of a program cannot be compensated; the message says why."""


@dataclass(frozen=True)
class Number:
    """A number of a program.

    Attributes:
        file: Index of its file in the program.
        start, end: Its span in the text.
        value: Value [SI].
        unit: Size of its unit in SI.
        decimals: Number of decimals to write.
        width: Number of characters to fill with blanks on the left; 0: as many as needed.
    """

    file: int
    start: int
    end: int
    value: float
    unit: float
    decimals: int
    width: int = 0

    def format(self, value: float) -> str:
        """Return the text of a value [SI] in this place."""
        text = f"{value / self.unit:.{self.decimals}f}"
        text = text.replace("-", "") if float(text) == 0 else text
        return text.rjust(self.width)


@dataclass(frozen=True)
class Configuration:
    """Joint configuration that a program states with a pose.

    Attributes:
        text: As written.
        ranges: Interval of each stated joint, by number from 0 [rad].
        behind: Whether the wrist is on another side of axis 1 than in the reference pose; None: not stated.
        elbow: The same for the wrist and the line through axes 2 and 3.
        flipped: The same for the sign of joint 5.
        elbow_bent: Whether joint 3 is beyond the pose in which axes 2 and 3 and the wrist are in line.
    """

    text: str
    ranges: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    behind: bool | None = None
    elbow: bool | None = None
    flipped: bool | None = None
    elbow_bent: bool | None = None


@dataclass(frozen=True)
class ProgramTarget:
    """A target of a program.

    Attributes:
        line: Number of its line, from 1.
        path: Path of its file.
        name: Name in the program; empty if it has none.
        cells: Its numbers: joint values; or a position and an orientation as the language writes it.
        rotation: Form of the orientation; None: joint values.
        frame: T_base_frame of the frame in which the pose is given.
        tool: T_flange_tool of the tool whose pose it is.
        configuration: The stated joint configuration.
        near: Stated joint values near the pose [m or rad]; empty if none are stated.
    """

    line: int
    path: str
    name: str
    cells: tuple[Number, ...]
    rotation: Rotation | None
    frame: pin.SE3 = field(default_factory=pin.SE3.Identity)
    tool: pin.SE3 = field(default_factory=pin.SE3.Identity)
    configuration: Configuration | None = None
    near: tuple[float, ...] = ()

    @property
    def label(self) -> str:
        """Name in messages."""
        return f"{self.path}, line {self.line}" + (f" ({self.name})" if self.name else "")

    @property
    def values(self) -> tuple[float, ...]:
        """Numbers of the target [SI]."""
        return tuple(cell.value for cell in self.cells)

    @property
    def flange(self) -> pin.SE3:
        """T_base_flange of a pose."""
        assert self.rotation is not None
        return self.frame * pose_of(self.values, self.rotation) * self.tool.inverse()

    def numbers_of(self, flange: pin.SE3) -> tuple[float, ...]:
        """Return the numbers [SI] of the pose that brings the flange to T_base_flange."""
        assert self.rotation is not None
        pose = self.frame.inverse() * flange * self.tool
        return numbers_of(pose, self.rotation, self.values)


@dataclass(frozen=True)
class NotCompensated:
    """A target that stays unchanged: its file, line, text there, and the reason."""

    path: str
    line: int
    text: str
    why: str

    def __str__(self) -> str:
        return f"{self.path}, line {self.line}: {self.text}: {self.why}"


@dataclass(frozen=True)
class ProgramSource:
    """A file of a program: its bytes as text, each byte a character."""

    path: str
    text: str

    @classmethod
    def read(cls, path: Path | str, what: str) -> ProgramSource:
        """Read a file; `what` names the expected content in messages.

        Raises:
            DataError: The file cannot be read, or is not text.
        """
        text = read_bytes(path, what, DataError).decode("latin-1")
        odd = re.search(r"[\x00-\x08\x0e-\x1f]", text)
        if odd is not None:
            line = text.count("\n", 0, odd.start()) + 1
            raise DataError(f"{path}, line {line}: is not text; is this {what}?")
        return cls(str(path), text)

    @cached_property
    def _ends(self) -> list[int]:
        """Ends of lines."""
        return [match.start() for match in re.finditer("\n", self.text)]

    def line(self, at: int) -> int:
        """Return the line of a place in the text, from 1."""
        return bisect_left(self._ends, at) + 1

    def location(self, at: int) -> str:
        """Return file and line of a place in the text."""
        return f"{self.path}, line {self.line(at)}"

    def excerpt(self, start: int, end: int) -> str:
        """Return a piece of the program for a message: one line of at most 60 characters."""
        return " ".join(self.text[start : min(end, start + 1000)].split())[:60]


@dataclass(frozen=True)
class RobotProgram:
    """A program.

    Attributes:
        language: Name of its language.
        sources: Its files, the given file first.
        targets: Targets in the order in which the text first goes to them.
        left_out: Targets that stay unchanged.
    """

    language: str
    sources: tuple[ProgramSource, ...]
    targets: tuple[ProgramTarget, ...]
    left_out: tuple[NotCompensated, ...]

    def rewritten(self, values: Sequence[Sequence[float] | None]) -> tuple[bytes, ...]:
        """Return the contents of its files with other numbers of each target [SI]; None: the target stays."""
        texts = []
        for k, source in enumerate(self.sources):
            edits = [
                (cell, number)
                for target, numbers in zip(self.targets, values, strict=True)
                for cell, number in zip(target.cells, numbers or (), strict=numbers is not None)
                if cell.file == k
            ]
            text, end = [], 0
            for cell, number in sorted(edits, key=lambda edit: edit[0].start):
                text += [source.text[end : cell.start], cell.format(number)]
                end = cell.end
            texts.append("".join([*text, source.text[end:]]).encode("latin-1"))
        return tuple(texts)

    def as_written(self, values: Sequence[float], k: int) -> tuple[float, ...]:
        """Return the numbers [SI] of target k as a file holds them."""
        return tuple(
            float(cell.format(value)) * cell.unit for cell, value in zip(self.targets[k].cells, values, strict=True)
        )


def cells_at(
    source: ProgramSource, file: int, spans: Iterable[tuple[int, int]], units: Sequence[float]
) -> tuple[Number, ...]:
    """Return numbers of a text.

    Args:
        source: The text.
        file: Its index in the program.
        spans: Places of the numbers.
        units: Size of each number's unit in SI; 0 for components of a quaternion.

    Raises:
        DataError: A number is larger than any machine reads.
    """
    cells = []
    for (start, end), unit in zip(spans, units, strict=True):
        text = source.text[start:end]
        if abs(float(text)) > _LARGEST:
            raise DataError(f"{source.location(start)}: '{text:.20}' is beyond what any machine reads; correct it")
        least = _DECIMALS[unit] if unit else _QUATERNION_DECIMALS
        written = len(re.split("[eE]", text)[0].partition(".")[2])
        cells.append(Number(file, start, end, float(text) * (unit or 1.0), unit or 1.0, max(least, written)))
    return tuple(cells)

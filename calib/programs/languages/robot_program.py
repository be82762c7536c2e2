"""Programs of robot controllers: their targets, and the places of the targets' numbers in the text.

A program is bytes. The language's reader finds the numbers of the targets; only these change in the written file. A
target is joint values, or a pose of a tool:

    T_base_flange = T_base_frame P T_flange_tool^-1

with P the pose as written, in the frame (user frame, work object, base) and with the tool that hold at the move. A
target that the program computes at run time, or reaches with two different tools or frames, is not compensated; it is
listed with its line and the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError
from calib.programs.languages.tokens import Number, ProgramSource

FourSides = tuple[bool | None, bool | None, bool | None, bool | None]
NO_SIDES: FourSides = (None, None, None, None)
Place = tuple[int, int]
"""Where numbers stand: index of the file, and index of their first word."""
_UNIT_LENGTH = 1e-3  # allowed deviation of a quaternion from unit length
Rotation = Literal["vector", "quaternion", "zyx", "xyz"]
"""How a language writes an orientation: rotation vector; quaternion w, x, y, z; angles about z, y', x'' (A, B, C of
KUKA); the same rotation as angles x, y, z about fixed axes (W, P, R of FANUC)."""


def pose_of(values: Sequence[float], rotation: Rotation, where: str = "") -> pin.SE3:
    """Return the pose of a position [m] and an orientation in a language's form [rad or quaternion].

    Raises:
        DataError: The quaternion does not have unit length.
    """
    turned = np.array(values[3:])
    if rotation == "quaternion" and abs(np.linalg.norm(turned) - 1) > _UNIT_LENGTH:
        raise DataError(f"{where}: the quaternion has length {np.linalg.norm(turned):.6g}, not 1; correct it")
    return pin.SE3(_ROTATIONS[rotation][0](turned), np.array(values[:3]))


def numbers_of(pose: pin.SE3, rotation: Rotation, near: Sequence[float]) -> tuple[float, ...]:
    """Return the numbers of a pose [m, rad], among equal orientations those nearest to the numbers `near`."""
    turned = _ROTATIONS[rotation][1](pose.rotation, np.array(near[3:]))
    return (*map(float, pose.translation), *map(float, turned))


def _to_vector(R: FloatArray, near: FloatArray) -> FloatArray:
    """The rotation vector nearest to `near`, (3,), among those of the same rotation."""
    v = np.asarray(pin.log3(R))
    angle = float(np.linalg.norm(v))
    if angle < 1e-9:
        return v
    return _nearest((v * (1 + 2 * np.pi * k / angle) for k in (-1, 0, 1)), near)


def _to_quaternion(R: FloatArray, near: FloatArray) -> FloatArray:
    x, y, z, w = pin.Quaternion(R).normalized().coeffs()
    return _nearest((np.array([w, x, y, z]), -np.array([w, x, y, z])), near)


def _to_xyz(R: FloatArray, near: FloatArray) -> FloatArray:
    """Roll, pitch and yaw nearest to `near`, (3,), among both triples of the same rotation."""
    angles = np.asarray(pin.rpy.matrixToRpy(R))
    other = np.array([angles[0] + np.pi, np.pi - angles[1], angles[2] + np.pi])
    best = _nearest((v + 2 * np.pi * np.round((near - v) / (2 * np.pi)) for v in (angles, other)), near)
    return np.where(np.abs(best) > np.pi, best - np.sign(best) * 2 * np.pi, best)


def _nearest(vectors: Iterable[FloatArray], near: FloatArray) -> FloatArray:
    return min(vectors, key=lambda vector: float(np.linalg.norm(vector - near)))


_ROTATIONS: dict[
    Rotation, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray, FloatArray], FloatArray]]
] = {
    "vector": (pin.exp3, _to_vector),
    "quaternion": (lambda q: pin.Quaternion(*(q / np.linalg.norm(q))).toRotationMatrix(), _to_quaternion),
    "zyx": (lambda v: pin.rpy.rpyToMatrix(*v[::-1]), lambda R, near: _to_xyz(R, near[::-1])[::-1]),
    "xyz": (lambda v: pin.rpy.rpyToMatrix(*v), _to_xyz),
}


@dataclass(frozen=True)
class Frame:
    """Pose of a tool or frame, and the places of the program's data that define it."""

    pose: pin.SE3 = field(default_factory=pin.SE3.Identity)
    places: tuple[Place, ...] = ()


ITSELF = Frame()
"""The robot's base as a frame, or its flange as a tool."""


class LeftOutError(Exception):
    """A target of a program cannot be compensated; the message says why."""


@dataclass(frozen=True)
class Configuration:
    """Joint configuration that a program states with a pose.

    Attributes:
        text: As written.
        ranges: Interval of each stated joint, by number from 0 [rad].
        sides: Whether the wrist is on another side of axis 1 than in the reference pose; the same for the wrist and the
            line through axes 2 and 3; the same for the sign of joint 5; whether joint 3 is beyond the pose in which
            axes 2 and 3 and the wrist are in line. None: not stated.
    """

    text: str
    ranges: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    sides: FourSides = NO_SIDES


@dataclass(frozen=True)
class ProgramTarget:
    """A target of a program.

    Attributes:
        line: Number of its line, from 1.
        path: Path of its file.
        name: Name in the program; empty if it has none.
        cells: Its numbers: joint values; or a position and an orientation as the language writes it.
        rotation: Form of the orientation; None: joint values.
        frame: The frame in which the pose is given, T_base_frame.
        tool: The tool whose pose it is, T_flange_tool.
        configuration: The stated joint configuration.
        near: Stated joint values near the pose [m or rad]; empty if none are stated.
    """

    line: int
    path: str
    name: str
    cells: tuple[Number, ...]
    rotation: Rotation | None
    frame: Frame = ITSELF
    tool: Frame = ITSELF
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
        return self.frame.pose * pose_of(self.values, self.rotation) * self.tool.pose.inverse()

    def numbers_of(self, flange: pin.SE3) -> tuple[float, ...]:
        """Return the numbers [SI] of the pose that brings the flange to T_base_flange."""
        assert self.rotation is not None
        return numbers_of(self.frame.pose.inverse() * flange * self.tool.pose, self.rotation, self.values)


@dataclass(frozen=True)
class Visit:
    """A move of a program to a target.

    Attributes:
        path, line: File and line of the move.
        text: The text there.
        place: Place of the target's numbers; None if the program does not have them.
        target: The target; None if it cannot be compensated.
        why: Why the target stays unchanged; empty if it does not.
    """

    path: str
    line: int
    text: str
    place: Place | None = None
    target: ProgramTarget | None = None
    why: str = ""

    def __str__(self) -> str:
        return f"{self.path}, line {self.line}: {self.text}: {self.why}"


@dataclass(frozen=True)
class RobotProgram:
    """A program.

    Attributes:
        language: Name of its language.
        sources: Its files, the given file first.
        targets: Targets in the order in which the text first goes to them.
        left_out: Visits whose targets stay unchanged.
    """

    language: str
    sources: tuple[ProgramSource, ...]
    targets: tuple[ProgramTarget, ...]
    left_out: tuple[Visit, ...]

    def rewritten(self, values: Sequence[Sequence[float] | None]) -> tuple[bytes, ...]:
        """Return the contents of its files with other numbers of each target [SI]; None: the target stays."""
        texts = []
        for source in self.sources:
            edits = [
                (cell, number)
                for target, numbers in zip(self.targets, values, strict=True)
                for cell, number in zip(target.cells, numbers or (), strict=numbers is not None)
                if cell.source is source
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


def program_of(language: str, sources: Sequence[ProgramSource], visits: Iterable[Visit]) -> RobotProgram:
    """Return a program with the targets that can be compensated, from visits in the order of the text.

    The numbers of a target stand in one place, and the program may go there several times. They stay unchanged if any
    of these visits cannot be compensated, if visits have different tools or frames, or if the target would move along
    with another target that is its frame or tool.

    Raises:
        DataError: No target can be compensated.
    """
    left, others = list[Visit](), list[Visit]()  # others: because of these
    same = dict[Place, list[Visit]]()
    for visit in visits:
        if visit.target is None:
            left.append(visit)
        if visit.place is not None:
            same.setdefault(visit.place, []).append(visit)
    targets = dict[Place, ProgramTarget]()
    for place, group in same.items():
        reached = [visit.target for visit in group if visit.target is not None]
        stays = next((visit for visit in group if visit.target is None or _differs(reached[0], visit.target)), None)
        if stays is None:
            targets[place] = replace(reached[0], near=next((target.near for target in reached if target.near), ()))
            continue
        if stays.target is not None:
            left.append(replace(stays, why="is reached with different tools or frames; give each a target"))
        because = f"stays as it is because of line {stays.line}"
        others += [replace(visit, why=because) for visit in group if visit.target is not None and visit is not stays]
    along = {
        place: targets[frame].name
        for place in targets
        for visit in same[place]
        if visit.target is not None
        for frame in reversed(visit.target.frame.places + visit.target.tool.places)
        if frame in targets
    }
    for place, name in along.items():
        why = f"moves along with {name}, a target that is its frame or tool"
        left += [replace(visit, why=why) for visit in same[place]]
        del targets[place]
    once = {(visit.path, visit.line, visit.text): visit for visit in reversed(left + others)}  # the first reason counts
    ordered = sorted(once.values(), key=lambda visit: (visit.path != sources[0].path, visit.line))
    if not targets:
        why = next((f"; {visit}" for visit in ordered if visit in left), "")
        raise DataError(f"{sources[0].path}: has no targets that can be compensated as {language}{why}")
    return RobotProgram(language, tuple(sources), tuple(targets.values()), tuple(ordered))


def _differs(one: ProgramTarget, other: ProgramTarget) -> bool:
    """Whether two poses are in different frames or of different tools."""
    frames = ((one.frame, other.frame), (one.tool, other.tool))
    return one.rotation is not None and not all(a.pose.isApprox(b.pose) for a, b in frames)

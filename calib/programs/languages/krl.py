"""Targets of KRL, the language of KUKA: a `.src` file with the `.dat` file beside it.

Read are `PTP`, `LIN`, `CIRC`, `SPL` and their splines with positions (`E6POS`, `POS`, `FRAME`) and axes (`E6AXIS`,
`AXIS`), declared in either file or written out. Tool and base are those that hold there on every way to the motion: of
the inline forms (`FDAT_ACT` and a `BAS` behind it, or the spline's `STOOL2`, `SBASE`), of `BAS(#TOOL, ...)` and
`BAS(#BASE, ...)`, or set in `$TOOL` and `$BASE`. `TOOL_DATA` and `BASE_DATA` stand in the controller's `$config.dat`,
or in a table of frames.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.krl_statements import Aggregate, Frame, KrlStatements
from calib.programs.languages.orientations import pose_of
from calib.programs.languages.robot_program import (
    DEGREE,
    MILLIMETRE,
    Configuration,
    LeftOutError,
    Number,
    ProgramTarget,
    RobotProgram,
    Source,
    cells_at,
)
from calib.programs.languages.tokens import Span

LANGUAGE, SUFFIXES = "KRL", (".src",)
_WHAT = "a KRL program"
_POSE, _AXES = ("X", "Y", "Z", "A", "B", "C"), ("A1", "A2", "A3", "A4", "A5", "A6")
_NULL = ("$NULLFRAME", "TOOL_DATA[0]", "BASE_DATA[0]")


def read_krl(path: Path | str, frames: Mapping[str, pin.SE3 | str], harmless: Collection[str] = ()) -> RobotProgram:
    """Read a program and the `.dat` file beside it, if there is one.

    Args:
        path: The `.src` file.
        frames: `TOOL_DATA[1]`, `BASE_DATA[2]`, ... that it does not set.
        harmless: Routines of other files that set no data, tool or base, in capitals.

    Raises:
        DataError: The message names file and line.
    """
    beside = [Path(path).with_suffix(suffix) for suffix in (".dat", ".DAT", ".Dat")]
    data_files = [file for file in beside if file.is_file()][:1]
    reader = _Reader([Source.read(file, _WHAT) for file in (Path(path), *data_files)], frames, harmless)
    return reader.program()


def krl_frames(path: Path | str) -> dict[str, pin.SE3 | str]:
    """Return `TOOL_DATA[...]` and `BASE_DATA[...]` of a file, such as `$config.dat`."""
    reader = _Reader([Source.read(path, "a KRL data list")], {}, ())
    reader.read_data(0)
    frames: dict[str, pin.SE3 | str] = {}
    for name in reader.declared:
        if name.startswith(("TOOL_DATA[", "BASE_DATA[")):
            frame = reader.frame_named(name, reader.flow.start)
            frames[name] = pose_of(frame.values, "zyx") if isinstance(frame, Frame) else getattr(frame, "why", name)
    return frames


class _Reader(KrlStatements):
    def __init__(self, sources: list[Source], frames: Mapping[str, pin.SE3 | str], harmless: Collection[str]) -> None:
        super().__init__(sources, harmless)
        self.frames = frames

    def program(self) -> RobotProgram:
        """Read the statements, follow the program, and take in its moves."""
        self.read()
        self.uses.follow()
        self.flow.follow()
        return self.collector.program(LANGUAGE, self.sources)

    def frame(self, span: Span, state: State) -> Hashable:
        """Return what a tool or base is set to: a `Frame`, the name of a given one, or `Unknown`."""
        if self.code.inside(*span, "{"):
            components = self.components(0, *span)
            if components is None or not set(_POSE) <= set(components):
                return Unknown("is not six plain numbers")
            return Frame(self._values(0, components))
        return self.frame_named("".join(token.text for token in self.code.tokens[slice(*span)]), state)

    def frame_named(self, name: str, state: State) -> Hashable:
        """Return the frame of a name."""
        unknown = Unknown(f"{name if '[' in name else name.lower()} is not known here; give $config.dat with --frames")
        if name in _NULL:
            return Frame((0.0,) * 6)
        if state.get(name) is not None:
            return state[name]
        base = name.partition("[")[0]
        if base in ("TOOL_DATA", "BASE_DATA") and isinstance(state["DATA"], Unknown):
            return Unknown(f"{name} {state['DATA'].why}")
        data = self.declared.get(name)
        if data is not None and data.components is None and base in ("TOOL_DATA", "BASE_DATA"):
            return Unknown(f"{name} is not six plain numbers")
        if data is not None and data.components is not None and set(_POSE) <= set(data.components):
            if base not in ("TOOL_DATA", "BASE_DATA") and (self.uses.is_set(name) or (data.shared and self.foreign)):
                return unknown
            return Frame(self._values(data.file, data.components), ((data.file, data.components["X"][0]),))
        return name if name in self.frames else unknown

    def form(self, name: str, state: State) -> tuple[Hashable, Hashable, Hashable]:
        """Return tool, base and interpolation mode of an inline form."""
        file, span = self.forms.get(name, (0, (0, 0)))
        code, members = self.codes[file], dict[str, str]()
        inside = code.inside(*span, "{")
        for first, stop in code.split(*inside) if inside else []:
            members[code.tokens[first].text] = "".join(token.text for token in code.tokens[first + 1 : stop])
        if not {"TOOL_NO", "BASE_NO"} <= set(members) or self.uses.is_set(name):
            why = Unknown(f"{name} is {'set while the program runs' if members else 'declared nowhere here'}")
            return why, why, why
        tool = self.frame_named(f"TOOL_DATA[{members['TOOL_NO']}]", state)
        base = self.frame_named(f"BASE_DATA[{members['BASE_NO']}]", state)
        return tool, base, members.get("IPO_FRAME", "#BASE")

    def _values(self, file: int, components: Mapping[str, tuple[int, int]]) -> tuple[float, ...]:
        return tuple(cell.value for cell in self._cells(file, components, _POSE))

    def _cells(
        self, file: int, components: Mapping[str, tuple[int, int]], names: tuple[str, ...]
    ) -> tuple[Number, ...]:
        units = [MILLIMETRE if name in "XYZ" else DEGREE for name in names]
        return cells_at(self.sources[file], file, [components[name] for name in names], units)

    def move(self, word: str, span: Span, state: State | None) -> None:
        """Take in one motion: its arguments, and what holds there."""
        code = self.code
        base, _, relative = word.partition("_")
        for first, stop in code.split(*span)[: 2 if base.endswith("CIRC") else 1]:
            end = next((k for k in range(first, stop) if code.tokens[k].text.startswith("C_")), stop)
            data, start = None, code.tokens[first].start
            try:
                if relative:
                    raise LeftOutError("is relative to where the robot is")
                if state is None:
                    raise LeftOutError("is a place to which the program never comes")
                data = self._data(first, end)
                self.collector.take(self._target(data, state), self.sources[0], start)
            except LeftOutError as why:
                if data is not None and data.components:
                    self._refuse(data, start)
                self.collector.leave(self.sources[0], start, code.shown(first, end), str(why))

    def _refuse(self, data: Aggregate, start: int) -> None:
        """Leave a target as it is everywhere."""
        for key in ("X", "A1"):
            if data.components and key in data.components:
                self.collector.refuse(
                    cells_at(self.sources[data.file], data.file, [data.components[key]], [1.0]), self.sources[0], start
                )

    def _data(self, first: int, stop: int) -> Aggregate:
        """The numbers of a target, written out or declared."""
        code = self.code
        name = "".join(token.text for token in code.tokens[first:stop])
        written = code.inside(first, stop, "{") is not None
        data = Aggregate(0, first, "", self.components(0, first, stop)) if written else self.declared.get(name)
        if data is None and self.uses.is_set(name):
            raise LeftOutError("is set while the program runs")
        if data is None:
            single = stop == first + 1 and code.tokens[first].kind == "name" and not name.startswith("$")
            raise LeftOutError("is declared nowhere here" if single else "is computed at run time")
        if data.components is None:
            raise LeftOutError("is not plain numbers")
        return data

    def _target(self, data: Aggregate, state: State) -> ProgramTarget:
        assert data.components is not None
        source, code = self.sources[data.file], self.codes[data.file]
        why = self.uses.why_not(data.name.upper().partition("[")[0]) if data.name else ""
        if why or (data.shared and self.foreign):
            raise LeftOutError(why or f"may be set by {self.foreign}")
        numbers = {key: float(source.text[slice(*place)]) for key, place in data.components.items()}
        if any(numbers.get(f"E{k}", 0.0) for k in range(1, 7)):
            raise LeftOutError("moves external axes, which the description does not have")
        path, line = source.path, code.line(data.at)
        if set(_AXES) <= set(numbers):
            return ProgramTarget(line, path, data.name, self._cells(data.file, data.components, _AXES), None)
        if not set(_POSE) <= set(numbers):
            raise LeftOutError("gives only a part of a position; the rest depends on where the robot is")
        tool, base = (self._pose(key, state[key]) for key in ("$TOOL", "$BASE"))
        mode = state["$IPO_MODE"]
        if mode != "#BASE":
            raise LeftOutError(
                "the tool is not on the robot" if mode == "#TCP" else "whether the tool is on the robot is not known"
            )
        cells, configuration = self._cells(data.file, data.components, _POSE), _configuration(numbers)
        places = tuple(place for key in ("$BASE", "$TOOL") for place in getattr(state[key], "places", ()))
        return ProgramTarget(line, path, data.name, cells, "zyx", base, tool, configuration, constants=places)

    def _pose(self, key: str, value: object) -> pin.SE3:
        """A tool or base as a pose."""
        if isinstance(value, Frame):
            return pose_of(value.values, "zyx")
        frame = self.frames.get(value) if isinstance(value, str) else None
        if isinstance(frame, pin.SE3):
            return frame
        why = frame if isinstance(frame, str) else getattr(value, "why", "is not known")
        starts = ("nothing", "TOOL_DATA", "BASE_DATA")
        own = why.startswith(starts) or "known here" in why or "declared nowhere here" in why.partition("(")[0]
        raise LeftOutError(why if own else f"{key} {why}")


def _configuration(numbers: Mapping[str, float]) -> Configuration | None:
    """S: bit 0 the side of axis 1, bit 1 of axis 3. T: the signs of the axes. Bit 2 of S says no more than these."""
    text = ", ".join(f"{key} {numbers[key]:g}" for key in ("S", "T") if key in numbers)
    if not text:
        return None
    ranges = {}
    if "T" in numbers:
        turns = int(numbers["T"])
        ranges = {k: (-np.inf, 0.0) if turns >> k & 1 else (0.0, np.inf) for k in range(6)}
    status = int(numbers["S"]) if "S" in numbers else None
    behind, bent = (None, None) if status is None else (bool(status & 1), bool(status & 2))
    return Configuration(text, ranges, behind=behind, bent=bent)

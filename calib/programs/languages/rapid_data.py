"""Data of RAPID: targets, tools and work objects as nested lists of numbers, and the tool and work object of a move."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import pinocchio as pin

from calib.core.base.errors import DataError
from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.frames import Frame, Frames, as_selected_frame
from calib.programs.languages.harmless import RAPID
from calib.programs.languages.orientations import pose_of
from calib.programs.languages.reader import NO_VALUE, Data, Reader
from calib.programs.languages.robot_program import MILLIMETRE, LeftOutError, Number, ProgramSource, cells_at
from calib.programs.languages.tokens import ProgramWords, Span, word_pattern

_WORDS = word_pattern(r"![^\n]*", r"[^\W\d]\w*", r":=|<=|>=|<>|[-+*/()\[\]{}=<>,.:;\\?|%]")
SIZES = {"ROBTARGET": 4, "JOINTTARGET": 2, "TOOLDATA": 3, "WOBJDATA": 5}  # number of components by type
_REFERENCES = ("INOUT", "PERS", "VAR", "REF")
TWO_TARGETS = re.compile(r"(MOVE|TRIGG|ARC|DISP|PAINT)C")
_BY_NAME = ("SETDATAVAL", "SETALLDATAVAL", "GETDATAVAL")  # set or read data, even LOCAL ones, by a name in a text
_FIXED = {"TOOL0": Frame(), "WOBJ0": Frame()}


class RapidData(Reader):
    """Reads the data of a module.

    Args:
        path: File of the module.
        frames: Tools and work objects that the module does not declare, by their names in capitals.
        harmless: Routines of other modules that set no data and no mode of motion, in capitals.
    """

    language, assigning, danger = "RAPID", ":=", "change a mode of motion"

    def __init__(self, path: Path | str, frames: Frames, harmless: Collection[str]) -> None:
        source = ProgramSource.read(path, "a RAPID module")
        code = ProgramWords(source, _WORDS, lines="blank", ends=";:")
        start: State = {"PDISP": None, "EOFFS": None, "CONFL": True, "CONFJ": True}
        super().__init__([code], start, {**_FIXED, **frames}, RAPID | set(harmless))
        self.sets_by_name = any(token.text in _BY_NAME for token in code.tokens)
        traps = [at for at in code.names(0, len(code.tokens) - 2) if code.tokens[at].text == "TRAP"]
        self.routines |= {code.tokens[at + 1].text: False for at in traps}

    def parameter(self, span: Span) -> tuple[list[str], bool]:
        """Return the names of a parameter, and whether it is a reference."""
        names = [
            self.code.tokens[k].text
            for k in self.code.names(*span)
            if self.code.is_mark(k + 1, ",", ")", "\\", "|", "{")
        ]
        return names, bool(self.names(*span) & {*_REFERENCES})

    def parts(self, span: Span) -> list[Span]:
        """Return the spans between the commas in brackets."""
        inside = self.code.bracket_content(*span, "[")
        return self.code.split(*inside) if inside else []

    def numbers(self, span: Span, count: int, what: str) -> list[tuple[int, int]]:
        """Return the places of the plain numbers in brackets.

        Raises:
            LeftOutError: Some part is not a plain number.
            DataError: Not `count` numbers.
        """
        spans = self.parts(span)
        numbers = [self.code.number(*part) for part in spans]
        for number, part in zip(numbers, spans, strict=True):
            if number is None:
                raise LeftOutError(f"'{self.code.excerpt(*part)}' is not a plain number")
        if len(spans) != count:
            raise DataError(f"{self.code.location(span[0])}: {what} has {len(spans)} numbers; expected {count}")
        return [number for number in numbers if number is not None]

    def values(self, span: Span, count: int, what: str) -> list[float]:
        """Return the plain numbers in brackets."""
        return [float(self.sources[0].text[slice(*place)]) for place in self.numbers(span, count, what)]

    def complete(self, data: Data) -> list[Span]:
        """Return the components of data; `DataError` if some are missing."""
        parts = self.parts(data.span)
        if len(parts) != SIZES[data.kind]:
            what = f"{data.kind.lower()} '{data.name}' is not complete; correct it"
            raise DataError(f"{self.code.location(data.span[0])}: {what}")
        return parts

    def pose(self, parts: Sequence[Span]) -> tuple[tuple[Number, ...], pin.SE3]:
        """Return the numbers of a position and a quaternion, and the pose.

        Raises:
            DataError: Not two parts.
        """
        where = self.code.location(parts[0][0])
        if len(parts) != 2:
            raise DataError(f"{where}: a frame is written [[x,y,z],[q1,q2,q3,q4]]; correct it")
        spans = self.numbers(parts[0], 3, "a position") + self.numbers(parts[1], 4, "a quaternion")
        cells = cells_at(self.sources[0], 0, spans, (*[MILLIMETRE] * 3, *[0.0] * 4))
        return cells, pose_of([cell.value for cell in cells], "quaternion", where)

    def frame(self, data: Data) -> Frame:
        """Return a tool or work object as a frame, or raise `LeftOutError`."""
        parts = self.complete(data)
        texts = [self.code.tokens[start].text for start, _ in parts]
        if data.kind == "TOOLDATA" and texts[0] != "TRUE":
            raise LeftOutError(f"tool '{data.name}' is not on the robot")
        if data.kind == "WOBJDATA" and texts[0] != "FALSE":
            raise LeftOutError(f"the robot holds work object '{data.name}'")
        if data.kind == "WOBJDATA" and texts[1] != "TRUE":
            raise LeftOutError(f"work object '{data.name}' is moved by another unit")
        try:
            poses = [self.pose(self.parts(part))[1] for part in (parts[1:2] if data.kind == "TOOLDATA" else parts[3:])]
        except LeftOutError as why:
            raise LeftOutError(f"'{data.name}' is not constant: {why}") from None
        return Frame(poses[0] if data.kind == "TOOLDATA" else poses[0] * poses[1])

    def _is_frame(self, name: str, kind: str) -> bool:
        """Whether the name belongs to a tool or work object, by `kind`."""
        return self.declared[name].kind == kind if name in self.declared else name in self.frames

    def tool(self, word: str, spans: Sequence[Span]) -> Frame:
        """Return the tool of a move, or raise `LeftOutError`."""
        known = [name for name in (self.code.text(*span) for span in spans) if self._is_frame(name, "TOOLDATA")]
        if not known:
            place = 4 if TWO_TARGETS.match(word) else 3
            name = self.code.excerpt(*spans[place]) if len(spans) > place else "?"
            raise LeftOutError(f"tool '{name}' is not declared here; give its module with --frames")
        return self._usable(known[-1])

    def work_object(self, options: Mapping[str, Span]) -> Frame:
        """Return the work object of a move, or raise `LeftOutError`."""
        if "WOBJ" not in options:
            return Frame()
        name = self.code.text(*options["WOBJ"])
        if not self._is_frame(name, "WOBJDATA"):
            shown = self.code.excerpt(*options["WOBJ"])
            raise LeftOutError(f"work object '{shown}' is not declared here; give its module with --frames")
        return self._usable(name)

    def _usable(self, name: str) -> Frame:
        """The frame of a tool or work object that the program does not set, or `LeftOutError`."""
        data, shown, base = self.declared.get(name), f"'{name.lower()}'", name.partition("{")[0]
        if self.uses.is_set(base):
            raise LeftOutError(f"{shown} {self.uses.why_not(base)}")
        if self.foreign and name not in _FIXED and (data is None or data.shared):
            raise LeftOutError(f"{shown} may be set by {self.foreign}")
        if data is None or data.span == NO_VALUE:
            return as_selected_frame(shown, self.frames.get(name, Unknown("is not constant: it has no value")))
        return self.frame(data)

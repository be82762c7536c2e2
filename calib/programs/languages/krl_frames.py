"""Tools and bases selected at each place of a KRL program.

A program selects them by inline forms (`FDAT_ACT` with a `BAS` after it, or `STOOL2` and `SBASE` of a spline), by
`BAS(#TOOL, ...)` and `BAS(#BASE, ...)`, or by an assignment to `$TOOL` and `$BASE`. `TOOL_DATA` and `BASE_DATA` are in
the controller's `$config.dat`, or in a table of frames.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence

from calib.programs.languages.control_flow import State, Unknown
from calib.programs.languages.frames import Frame, Frames
from calib.programs.languages.harmless import BAS_FORMS, BAS_HARMLESS, KRL
from calib.programs.languages.orientations import pose_of
from calib.programs.languages.reader import NO_VALUE, Data, Reader
from calib.programs.languages.robot_program import DEGREE, MILLIMETRE, Number, ProgramSource, cells_at
from calib.programs.languages.tokens import ProgramWords, Span, word_pattern

SELECTED = ("$TOOL", "$BASE", "$IPO_MODE")
_WORDS = word_pattern(
    r"[;&][^\n]*", r"[$#]?[^\W\d][\w$]*", r"[=<>]=|<>|[-+*/()\[\]{}=<>,.:!?^%@~|]", r"\"[^\"\n]*\"|'[^'\n]*'"
)
_POSE = ("X", "Y", "Z", "A", "B", "C")
_LISTS = ("TOOL_DATA", "BASE_DATA")
_NULL = ("$NULLFRAME", "TOOL_DATA[0]", "BASE_DATA[0]")


class KrlFrames(Reader):
    """Reads which tool and base a program selects.

    Args:
        sources: The `.src` file, then data lists.
        frames: Frames such as `TOOL_DATA[1]` and `BASE_DATA[2]` that the sources do not set.
        harmless: Routines of other files that set no data, tool or base, in capitals.
    """

    language, danger = "KRL", "set a tool, base or frame"

    def __init__(self, sources: list[ProgramSource], frames: Frames, harmless: Collection[str]) -> None:
        codes = [ProgramWords(source, _WORDS) for source in sources]
        start: dict[str, Hashable] = {
            key: Unknown(f"nothing before it selects a {key[1:].lower()} (BAS, ${key[1:]}, an inline form)", whole=True)
            for key in SELECTED[:2]
        }
        start |= {"$IPO_MODE": "#BASE", "FDAT_ACT": Unknown("no FDAT_ACT before it", whole=True), "DATA": ""}
        code = codes[0]
        self._selecting = {
            code.tokens[at].text for at in code.names(1, len(code.tokens)) if code.is_mark(at - 1, "=")
        } | {*start, *_LISTS}
        super().__init__(codes, start, frames, KRL | set(harmless))

    def word(self, first: int, *words: str) -> int:
        """Return the index of the first of these words in the rest of the line, or of the line's end."""
        while self.code.tokens[first].kind != "end" and self.code.tokens[first].text not in words:
            first = self.code.partner[first] + 1
        return first

    # numbers in braces

    def components(self, data: Data) -> dict[str, Span] | None:
        """Return the spans of the numbers in braces by component; None if some component is not a plain number."""
        code = self.codes[data.file]
        inside = code.bracket_content(*data.span, "{")
        if inside is None or data.span == NO_VALUE:
            return None
        left, right = inside
        if right > left + 1 and code.is_mark(left + 1, ":"):  # the type may come first
            left += 2
        components = dict[str, Span]()
        for start, end in code.split(left, right):
            number = code.number(start + 1, end)
            if number is None or code.tokens[start].kind != "name" or code.tokens[start].text in components:
                return None
            components[code.tokens[start].text] = number
        return components

    def cells(self, data: Data, names: Sequence[str]) -> tuple[Number, ...]:
        """Return the named components as numbers."""
        components = self.components(data) or {}
        units = [MILLIMETRE if name in "XYZ" else DEGREE for name in names]
        return cells_at(self.sources[data.file], data.file, [components[name] for name in names], units)

    def pose_cells(self, data: Data) -> tuple[Number, ...] | None:
        """Return the numbers of a pose; None unless they are six plain numbers."""
        return self.cells(data, _POSE) if set(_POSE) <= set(self.components(data) or {}) else None

    # values of tools and bases

    def _frame_of(self, data: Data) -> Frame | None:
        cells = self.pose_cells(data)
        if cells is None:
            return None
        return Frame(pose_of([cell.value for cell in cells], "zyx"), (data.place,) if data.name else ())

    def _frame(self, span: Span, state: State) -> Frame | Unknown:
        """Value of a tool or base."""
        if self.code.bracket_content(*span, "{"):
            return self._frame_of(Data("", 0, span)) or Unknown("is not six plain numbers")
        return self.frame_named(self.code.text(*span), state)

    def frame_named(self, name: str, state: State) -> Frame | Unknown:
        """Return the frame with this name."""
        shown, base = name if "[" in name else name.lower(), name.partition("[")[0]
        value, data = state.get(name), self.declared.get(name)
        if name in _NULL:
            return Frame()
        if isinstance(value, (Frame, Unknown)):
            return value
        if base in _LISTS and isinstance(state["DATA"], Unknown):
            return Unknown(f"{name} {state['DATA'].why}", whole=True)
        given = self.frames.get(name)
        safe = base in _LISTS or not (self.uses.is_set(name) or (data and data.shared and self.foreign))
        if data is not None and safe and (frame := self._frame_of(data)) is not None:
            return frame
        if data is not None and base in _LISTS:
            return Unknown(f"{name} is not six plain numbers", whole=True)
        if given is not None:
            return given
        return Unknown(f"{shown} is not known here; give $config.dat with --frames", whole=True)

    def _form(self, form: Hashable, state: State) -> dict[str, Hashable]:
        """Tool, base and interpolation mode of an inline form."""
        if isinstance(form, Unknown):
            return dict.fromkeys(SELECTED, form)
        name, members = str(form), dict[str, str]()
        data = self.declared.get(name)
        if data is not None and data.kind == "FDAT":
            code = self.codes[data.file]
            for first, stop in code.split(data.span[0] + 1, data.span[1] - 1):
                members[code.tokens[first].text] = code.text(first + 1, stop)
        if not {"TOOL_NO", "BASE_NO"} <= set(members) or self.uses.is_set(name):
            why = f"{name} is {'set while the program runs' if members else 'not declared here'}"
            return dict.fromkeys(SELECTED, Unknown(why, whole=True))
        tool = self.frame_named(f"TOOL_DATA[{members['TOOL_NO']}]", state)
        base = self.frame_named(f"BASE_DATA[{members['BASE_NO']}]", state)
        return dict(zip(SELECTED, (tool, base, members.get("IPO_FRAME", "#BASE")), strict=True))

    # statements that select

    def change(self, name: str, why: str = "is set while the program runs") -> None:
        """Process a change of data, or of a frame."""
        self.uses.note_change(name, why)
        self._select(name, None, why)

    def _select(self, name: str, value: Callable[[State], Hashable] | None, why: str = "") -> None:
        """Record that a name which selects frames gets a value; without `value`, it becomes unknown."""
        if name.partition("[")[0] in self._selecting:
            self.flow.change([name], lambda state: {**state, name: value(state) if value else Unknown(why)})

    def select_assigned(self, at: int, stop: int, equals: int) -> None:
        """Process an assignment that may select tool or base."""
        code, word, line = self.code, self.code.tokens[at].text, self.code.line(at)
        number = code.number(at + 2, equals - 1) if code.is_mark(at + 1, "[") and equals > at + 3 else None
        whole = code.partner[at + 1] + 1 if number else at + 1  # after the element of an array
        in_part = f"is set in part (line {line})"
        if word in ("$IPO_MODE", "FDAT_ACT"):
            text = code.text(equals + 1, stop)
            self._select(word, (lambda _: text) if equals == at + 1 else None, in_part)
        elif word.startswith("$") and word not in SELECTED:
            if word not in self.harmless:
                self.flow.mark_unknown(f"is not known after {word} is set (line {line})")
        elif equals == whole:
            self._select(code.text(at, equals), lambda state: self._frame((equals + 1, stop), state))
        elif number is not None or not code.is_mark(at + 1, "["):
            self._select(code.text(at, whole), None, in_part)
        elif word in _LISTS:
            self._select("DATA", None, f"is not known after {word} is set (line {line})")

    def read_known_call(self, at: int, span: Span, *, maybe: bool) -> bool:
        """Process a call of BAS, which selects tool and base; return whether the call is known."""
        name, code = self.code.tokens[at].text, self.code
        if name != "BAS":
            return name in self.harmless
        given = code.split(*span)
        what = code.tokens[given[0][0]].text if given else ""
        if what in ("#TOOL", "#BASE") and len(given) == 2 and not maybe:
            frame = f"{what[1:]}_DATA[{code.text(*given[1])}]"
            self._select(f"${what[1:]}", lambda state: self.frame_named(frame, state))
        elif what in BAS_FORMS and not maybe:
            self.flow.change(SELECTED, lambda state: {**state, **self._form(state["FDAT_ACT"], state)})
        elif what not in BAS_HARMLESS:
            self.flow.mark_unknown(f"is not selected after {code.excerpt(at, span[1] + 1)}", SELECTED)
        return True

    # selections for one motion or spline

    def spline(self, at: int, _: int) -> int:
        """Begin a spline, with its own selections after WITH."""
        stop = self.code.line_end(at)
        self.save("of the program")
        self.read_with_clause(self.word(at, "WITH"), stop)
        return stop

    def end_spline(self, at: int, _: int) -> int:
        """End a spline."""
        self.restore("of the program")
        return self.code.line_end(at)

    def save(self, key: str) -> None:
        """Save the selected tool and base under a key."""
        self.flow.change([key], lambda state: {**state, key: tuple(state[name] for name in SELECTED)})

    def restore(self, key: str) -> None:
        """Restore the tool and base that were saved under a key."""

        def restored(state: State) -> State:
            saved = state.get(key)
            values = saved if isinstance(saved, tuple) else [Unknown("is not known after a spline")] * 3
            return {**state, **dict(zip(SELECTED, values, strict=True))}

        self.flow.change(SELECTED, restored)

    def read_with_clause(self, first: int, stop: int) -> None:
        """Process the selections of one motion or spline, after WITH."""
        code = self.code
        for left, right in code.split(first + 1, stop):
            name, line = code.tokens[left].text, code.line(left)
            if name not in SELECTED:
                if name not in self.harmless and name != "$NULLFRAME":
                    self.flow.mark_unknown(f"is not known where {name} is set (line {line})")
            elif code.text(left + 2, left + 4) in ("STOOL(", "STOOL2(", "SBASE(", "SIPO_MODE("):
                self.flow.change([name], self._with_form(name, code.tokens[left + 4].text))
            elif code.is_mark(left + 1, "="):
                self.select_assigned(left, right, left + 1)
            else:
                self._select(name, None, f"is set in part (line {line})")

    def _with_form(self, name: str, form: str) -> Callable[[State], State]:
        return lambda state: {**state, name: self._form(form, state)[name]}

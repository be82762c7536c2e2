"""Files of programs: their words without comments (numbers, names, marks, ends of lines), with matching brackets.

A language is one pattern of its words; any other character is an error. The alternatives of the pattern never go back
over text that they have read, so the time is linear in the text.
"""

from __future__ import annotations

import codecs
import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

from calib.core.base.errors import DataError
from calib.core.base.files import read_bytes
from calib.core.base.units import from_unit

DEGREE, MILLIMETRE = from_unit(1.0, "deg"), from_unit(1.0, "mm")
_DECIMALS = {1.0: 7, MILLIMETRE: 4, DEGREE: 5, 0: 9}  # least number of decimals, by unit; 0: of a quaternion
_LARGEST = 1e6
_MARK = codecs.BOM_UTF8.decode("latin-1")
Span = tuple[int, int]
"""The index of the first of some words, and the index after the last."""
_TEXT = Path(__file__).with_name("harmless.txt").read_text(encoding="utf-8")
_LISTS = dict(re.findall(r"^\[(.*)\]\n([^\[]*)", _TEXT, re.MULTILINE))
_CLOSING = {")": "(", "]": "[", "}": "{"}
_DEEPEST = 100


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

    def numbers(self, spans: Iterable[tuple[int, int]], units: Sequence[float]) -> tuple[Number, ...]:
        """Return the numbers at these spans of the text; a unit is its size in SI, or 0 in a quaternion.

        Raises:
            DataError: A number is larger than any machine reads.
        """
        cells = []
        for (start, end), unit in zip(spans, units, strict=True):
            text = self.text[start:end]
            if abs(float(text)) > _LARGEST:
                raise DataError(f"{self.location(start)}: '{text:.20}' is beyond what any machine reads; correct it")
            written = len(re.split("[eE]", text)[0].partition(".")[2])
            si = float(text) * (unit or 1.0)
            cells.append(Number(self, start, end, si, unit or 1.0, max(_DECIMALS[unit], written)))
        return tuple(cells)


@dataclass(frozen=True)
class Number:
    """A number of a program.

    Attributes:
        source: The file.
        start, end: Its span in the text.
        value: Value [SI].
        unit: Size of its unit in SI.
        decimals: Number of decimals to write.
        width: Number of characters to fill with blanks on the left; 0: as many as needed.
    """

    source: ProgramSource
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


class Token(NamedTuple):
    """A word of a program.

    Attributes:
        kind: `name`, `number`, `text`, `mark`, or `end` of a statement.
        text: The word; in capitals where case does not count.
        start, end: Its span in the text.
    """

    kind: str
    text: str
    start: int
    end: int


def word_pattern(blank: str, name: str, marks: str, text: str = r'"[^"\n]*"') -> re.Pattern[str]:
    """Return the pattern of a language's words from patterns of its comments, names, marks and quoted texts."""
    return re.compile(
        rf"(?P<line>\n)|(?P<text>{text})|(?P<blank>{blank}|[^\S\n]+)"
        rf"|(?P<name>{name})|(?P<number>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)|(?P<mark>{marks})|(?P<odd>.)",
        re.MULTILINE,
    )


def word_list(name: str, *, fold_case: bool = True) -> frozenset[str]:
    """Return a list of `harmless.txt`: words of the manufacturers' manuals, in capitals with `fold_case`.

    A name that is neither listed nor declared in the program may change anything.
    """
    return frozenset((_LISTS[name].upper() if fold_case else _LISTS[name]).split())


class ProgramWords:
    """The words of a source.

    Args:
        source: The text.
        words: Pattern of its words.
        fold_case: Whether case does not count.
        lines: Meaning of the end of a line: nothing (`blank`), or the end of a statement outside of brackets
            (`outside`) or anywhere (`all`; brackets then may not span lines).
        ends: Marks that end a statement outside of brackets.
        part: Part of the text to read.

    Attributes:
        tokens: The words, and an `end` after the last.
        partner: Index of the matching bracket of each word; its own index for all other words.

    Raises:
        DataError: A character that the language does not have, or a bracket that is not closed.
    """

    def __init__(
        self,
        source: ProgramSource,
        words: re.Pattern[str],
        *,
        fold_case: bool = True,
        lines: Literal["blank", "outside", "all"] = "all",
        ends: str = "",
        part: slice = slice(None),
    ) -> None:
        self.source = source
        self.tokens: list[Token] = []
        self.partner: list[int] = []
        opened: list[int] = []
        first = part.start or (len(_MARK) if source.text.startswith(_MARK) else 0)
        for match in words.finditer(source.text, first, len(source.text) if part.stop is None else part.stop):
            kind = str(match.lastgroup)
            if kind == "blank" or (kind == "line" and (lines == "blank" or (opened and lines == "outside"))):
                continue
            if kind == "line" and opened:
                raise self._unclosed_error(opened[-1])
            if kind == "odd":
                raise DataError(f"{source.location(match.start())}: '{match[0]}' is not understood here; correct it")
            at = len(self.tokens)
            if kind == "line" or (kind == "mark" and match[0] in ends and not opened):
                kind = "end"
            self.tokens.append(
                Token(kind, match[0].upper() if fold_case and kind == "name" else match[0], match.start(), match.end())
            )
            self.partner.append(at)
            if kind == "mark" and match[0] in "([{":
                opened.append(at)
                if len(opened) > _DEEPEST:
                    raise DataError(f"{source.location(match.start())}: has brackets in more than {_DEEPEST} brackets")
            elif kind == "mark" and match[0] in _CLOSING:
                if not opened or self.tokens[opened[-1]].text != _CLOSING[match[0]]:
                    raise self._unclosed_error(opened[-1] if opened else at)
                self.partner[at] = opened.pop()
                self.partner[self.partner[at]] = at
        if opened:
            raise self._unclosed_error(opened[-1])
        self.tokens.append(Token("end", "\n", len(source.text), len(source.text)))
        self.partner.append(len(self.tokens) - 1)

    def _unclosed_error(self, at: int) -> DataError:
        start = self.tokens[at - 1].start if at and self.tokens[at - 1].kind == "name" else self.tokens[at].start
        text = self.source.excerpt(start, self.tokens[at].end)
        return DataError(f"{self.source.location(start)}: {text}: has a bracket that is not closed; correct it")

    def word(self, at: int) -> str:
        """Return the text of a word, in capitals where case does not count."""
        return self.tokens[at].text

    def name(self, first: int, end: int) -> str:
        """Return the name that the given words are; empty if they are anything else."""
        return self.tokens[first].text if end == first + 1 and self.tokens[first].kind == "name" else ""

    def location(self, at: int) -> str:
        """Return file and line of a word."""
        return self.source.location(self.tokens[at].start)

    def line(self, at: int) -> int:
        """Return the line of a word."""
        return self.source.line(self.tokens[at].start)

    def excerpt(self, first: int, end: int) -> str:
        """Return the text of words for a message."""
        return self.source.excerpt(self.tokens[first].start, self.tokens[end - 1].end) if end > first else ""

    def is_mark(self, at: int, *marks: str) -> bool:
        """Return whether a word is any of these marks."""
        token = self.tokens[at]
        return token.kind == "mark" and token.text in marks

    def line_end(self, at: int) -> int:
        """Return the index at which the statement around a word ends."""
        while self.tokens[at].kind != "end":
            at = self.partner[at] + 1
        return at

    def find_mark(self, first: int, end: int, *marks: str) -> int:
        """Return the index of the next of these marks outside of brackets, or `end`."""
        at = first
        while at < end and not self.is_mark(at, *marks):
            at = max(self.partner[at], at) + 1
        return at

    def split(self, first: int, end: int, mark: str = ",") -> list[Span]:
        """Return the nonempty spans between marks outside of brackets."""
        pieces = []
        while first < end:
            stop = self.find_mark(first, end, mark)
            if stop > first:
                pieces.append((first, stop))
            first = stop + 1
        return pieces

    def bracket_content(self, first: int, end: int, opening: str) -> Span | None:
        """Return the words inside a bracket if the given words are exactly one bracket of this kind."""
        whole = end > first and self.is_mark(first, opening) and self.partner[first] == end - 1
        return (first + 1, end - 1) if whole else None

    def text(self, first: int, end: int) -> str:
        """Return words joined without the blanks between them."""
        return "".join(token.text for token in self.tokens[first:end])

    def number(self, first: int, end: int) -> tuple[int, int] | None:
        """Return the span in the text of a plain number with its sign, if the words are one."""
        tokens = self.tokens[first:end]
        signed = len(tokens) == 2 and tokens[0].text in ("+", "-") and tokens[0].end == tokens[1].start
        if (len(tokens) == 1 or signed) and tokens[-1].kind == "number":
            return tokens[0].start, tokens[-1].end
        return None

    def names(self, first: int = 0, end: int | None = None) -> Iterator[int]:
        """Yield the indices of names."""
        return (at for at in range(first, len(self.tokens) if end is None else end) if self.tokens[at].kind == "name")

    def calls(self, first: int, end: int) -> Iterator[int]:
        """Yield the indices of names with arguments in brackets after them, inner calls first."""
        calls = [at for at in self.names(first, end - 1) if self.is_mark(at + 1, "(")]
        return iter(sorted(calls, key=lambda at: self.partner[at + 1]))

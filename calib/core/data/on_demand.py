"""Long sequences whose items are made when they are read: as Python objects they take ten times the memory.

What is kept is what the items are made of: numbers, or text in one piece. A million poses of a file have names, labels
for messages and rows of cells, and hardly any of them is looked at twice.
"""

from __future__ import annotations

import csv
import tempfile
import weakref
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import SupportsIndex, TypeVar, overload

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import InputError
from calib.core.base.memory import scratch

Item = TypeVar("Item")
_PART = 256  # rows that are kept together
_FEW = 10_000  # texts of which a copy weighs nothing


class OnDemand(Sequence[Item]):
    """A sequence that equals a tuple of its items; slices of it, and sums with others, are tuples."""

    @abstractmethod
    def _made(self, k: int) -> Item:
        """Return item k, which there is."""

    @overload
    def __getitem__(self, which: SupportsIndex) -> Item: ...
    @overload
    def __getitem__(self, which: slice) -> tuple[Item, ...]: ...
    def __getitem__(self, which: SupportsIndex | slice) -> Item | tuple[Item, ...]:
        places = range(len(self))[which]
        return self._made(places) if isinstance(places, int) else tuple(self._made(k) for k in places)

    def __iter__(self) -> Iterator[Item]:
        return (self._made(k) for k in range(len(self)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence) or len(self) != len(other):
            return False
        return all(item == another for item, another in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(tuple(self))


Texts = tuple[str, ...] | OnDemand[str]
"""Names or labels, of few or of very many."""


@dataclass(frozen=True, eq=False, repr=False)
class Numbered(OnDemand[str]):
    """Texts that end with a number, such as `pose 7`, or with a name after it.

    Attributes:
        before: What they begin with.
        numbers: Of each.
        names: What comes after these, in brackets; None: nothing.
    """

    before: str
    numbers: Sequence[int]
    names: Texts | None = None

    def __len__(self) -> int:
        return len(self.numbers)

    def _made(self, k: int) -> str:
        return f"{self.before}{self.numbers[k]}" + ("" if self.names is None else f" (pose {self.names[k]})")


@dataclass(frozen=True, eq=False, repr=False)
class _Picked(OnDemand[str]):
    """Some of many texts.

    Attributes:
        every: All of them.
        places: Which, (n,).
    """

    every: OnDemand[str]
    places: IntArray

    def __len__(self) -> int:
        return len(self.places)

    def _made(self, k: int) -> str:
        return self.every[int(self.places[k])]


def held(texts: Texts) -> Texts:
    """Return a tuple of few texts; very many as they are, because a copy of them takes more memory than the rest."""
    return tuple(texts) if len(texts) <= _FEW else texts


def picked(texts: Texts, index: IntArray) -> Texts:
    """Return the texts with these indices (n,), in this order."""
    if isinstance(texts, tuple):
        return tuple([texts[k] for k in index])
    every, index = (texts.every, texts.places[index]) if isinstance(texts, _Picked) else (texts, index)
    return _Picked(every, index)


class Packed(OnDemand[str]):
    """Texts, one behind the other."""

    def __init__(self, texts: Iterable[str]) -> None:
        kept = bytearray()
        self._ends: IntArray = np.fromiter((_length_after(kept, text) for text in texts), dtype=np.intp)
        self._kept = bytes(kept)

    def __len__(self) -> int:
        return len(self._ends)

    def _made(self, k: int) -> str:
        return self._kept[self._ends[k - 1] if k else 0 : self._ends[k]].decode()


def _length_after(kept: bytearray, text: str) -> int:
    kept += text.encode()
    return len(kept)


class TextRows(OnDemand[tuple[str, ...]]):
    """Cells of rows, kept as text (`calib.core.base.memory.scratch`).

    Args:
        lines: A row each.
        separator: What stands between cells.

    Raises:
        InputError: There is no room for them.
    """

    def __init__(self, lines: Iterable[str], separator: str) -> None:
        self._text, self._separator = scratch(), separator
        weakref.finalize(self, self._text.close)
        self._ends, self._length, left = [0], 0, iter(lines)
        while part := list(islice(left, _PART)):
            self._length += len(part)
            try:
                self._ends.append(self._ends[-1] + self._text.write("\n".join(part).encode()))
            except OSError:
                raise InputError(
                    f"a file does not fit into the free memory, and {tempfile.gettempdir()} is full; name a folder with"
                    " more room in TMPDIR"
                ) from None

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[tuple[str, ...]]:
        for number in range(len(self._ends) - 1):
            for line in self._lines(number):
                yield cells_of(line, self._separator)

    def column(self, index: int) -> Iterator[str]:
        """Yield the cells of one column."""
        for number in range(len(self._ends) - 1):
            text = self._text_of(number)
            if is_plain(text):
                cells = [line.split(self._separator, index + 1)[index] for line in text.split("\n")]
                yield from [cell.lstrip(" ") for cell in cells] if " " in text else cells
            else:
                yield from (cells_of(line, self._separator)[index] for line in text.split("\n"))

    def plain_numbers(self, width: int) -> dict[int, FloatArray]:
        """Return the columns of nothing but finite numbers, as `float` reads them, (n_rows,) each, by their place.

        None where cells are quoted, or hold a `_`, which `float` takes for a mark of thousands.

        Args:
            width: Number of columns.
        """
        columns: dict[int, FloatArray] = {index: np.empty(len(self)) for index in range(width)}
        first = 0
        for number in range(len(self._ends) - 1):
            text = self._text_of(number)
            if "_" in text or not is_plain(text):
                return {}
            cells = text.replace("\n", self._separator).split(self._separator)
            rows = len(cells) // width
            for index, column in list(columns.items()):
                try:
                    column[first : first + rows] = list(map(float, cells[index::width]))
                except ValueError:
                    del columns[index]
            first += rows
        return {index: column for index, column in columns.items() if np.all(np.isfinite(column))}

    def _made(self, k: int) -> tuple[str, ...]:
        return cells_of(self._lines(k // _PART)[k % _PART], self._separator)

    def _lines(self, number: int) -> list[str]:
        return self._text_of(number).split("\n")

    def _text_of(self, number: int) -> str:
        start, end = self._ends[number : number + 2]
        self._text.seek(start)
        return self._text.read(end - start).decode()


def cells_of(line: str, separator: str) -> tuple[str, ...]:
    """Return the cells of a line of CSV.

    Raises:
        csv.Error: It is none.
    """
    if not is_plain(line):
        return tuple(next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True)))
    cells = line.split(separator)  # what csv does, in a third of the time
    return tuple([cell.lstrip(" ") for cell in cells] if " " in line else cells)


def is_plain(text: str) -> bool:
    """Return whether every separator in lines of CSV parts two cells."""
    return '"' not in text and len(text) <= csv.field_size_limit()

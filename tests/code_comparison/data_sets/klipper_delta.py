"""Delta printers: `printer.cfg` of Klipper as owners published them."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ..data_set import DataSet, Split

FILES = (
    *("kossel_1", "kossel_2", "kossel_3", "kossel_4", "q5", "super_racer_a", "super_racer_b"),
    *("v400_a1", "v400_a2", "v400_a3", "v400_a4", "v400_b"),
)
_ROW = re.compile(r"^(height|distance)(\d+)(_pos1?|_pos2)?\s*:\s*(.*)$")


@dataclass(frozen=True)
class Row:
    """A height or a distance [mm], and the steps of the carriages at its one or two places."""

    measured: float
    places: tuple[str, ...]

    def lines(self, number: int) -> list[str]:
        """As it stands in a printer.cfg."""
        kind, ends = ("height", ("_pos",)) if len(self.places) == 1 else ("distance", ("_pos1", "_pos2"))
        own = [f"{kind}{number}{end}: {place}" for end, place in zip(ends, self.places, strict=True)]
        return [f"{kind}{number}: {self.measured}", *own]


@dataclass(frozen=True)
class Fold:
    """What stands before the rows of a file, rows to fit, and rows to predict."""

    head: str
    rows: tuple[Row, ...]
    unseen: tuple[Row, ...]


@dataclass(frozen=True)
class Folds:
    """Fits of one split: `fitted` or unseen rows; `shifted`: their mean does not count (another day's probe)."""

    folds: tuple[Fold, ...]
    fitted: bool
    shifted: bool

    def __len__(self) -> int:
        return len(self.folds[0].rows) if self.fitted else sum(len(fold.unseen) for fold in self.folds)

    def keys(self) -> set[tuple[int, Row]]:
        """What tells one row of a fit from another."""
        return {(k, row) for k, fold in enumerate(self.folds) for row in (fold.rows if self.fitted else fold.unseen)}


@dataclass(frozen=True, kw_only=True)
class Printers(DataSet):
    """Printers of Klipper; a code gets a printer.cfg for each fit."""

    problem: ClassVar[str] = "printers"
    chance: ClassVar[float] = 1e-2  # rows left out in turn are few

    def write(self, here: Path, split: Split, folder: Path) -> None:
        for k, fold in enumerate(split.train.folds):
            texts = [fold.head]
            for n in (1, 2):
                same = [row for row in fold.rows if len(row.places) == n]
                texts += [line for number, row in enumerate(same) for line in row.lines(number)]
            (folder / f"fold_{k}.cfg").write_text("\n".join(texts) + "\n")
        (folder / "unseen.json").write_text(json.dumps([[row.places for row in o.unseen] for o in split.train.folds]))

    def errors(self, unseen: Folds, predicted: np.ndarray) -> np.ndarray:
        """Of heights and distances [m]."""
        off = predicted - [1e-3 * row.measured for fold in unseen.folds for row in fold.unseen]
        parts = np.split(off, np.cumsum([len(fold.unseen) for fold in unseen.folds])[:-1])
        return np.abs(np.concatenate([part - part.mean() if unseen.shifted else part for part in parts]))


def read(path: Path, microsteps: str | None = None) -> tuple[str, tuple[Row, ...]]:
    """Return what stands before the rows of a file, and its rows; microsteps in place of those that it says."""
    head, rows_by_places = [], dict[tuple[str, str], dict[str, str]]()
    for line in path.read_text().splitlines():
        match = _ROW.match(line)
        if match:
            rows_by_places.setdefault((match[1], match[2]), {})[match[3] or ""] = match[4]
        else:
            head.append(re.sub(r"^microsteps:.*", f"microsteps: {microsteps}", line) if microsteps else line)
    rows = tuple(Row(float(of[""]), tuple(of[end] for end in sorted(of) if end)) for of in rows_by_places.values())
    return "\n".join(head), rows


def left_out(head: str, rows: tuple[Row, ...]) -> Iterator[Fold]:
    """Each row left out in turn."""
    for k, out in enumerate(rows):
        yield Fold(head, rows[:k] + rows[k + 1 :], (out,))


def heights(head: str, rows: tuple[Row, ...], by: str) -> Iterator[Row]:
    """Heights of a file, in the steps of another day's: the owner of the V400 went from 16 to 64 microsteps."""
    own, other = (int(re.search(r"^microsteps: (\d+)", text, re.MULTILINE)[1]) for text in (head, by))
    for row in rows:
        if len(row.places) == 1:
            steps = (float(text) * other / own for text in row.places[0].split(","))
            yield Row(row.measured, (",".join(map(repr, steps)),))


def _splits(folder: Path) -> Iterator[Split]:
    # the owner of the last Kossel changed its controller: its steps fit twice the microsteps that its file says
    files = {path.stem: read(path, "32" if path.stem == "kossel_4" else None) for path in sorted(folder.glob("*.cfg"))}

    def split(words: str, folds: list[Fold], *, shifted: bool = False) -> Split:
        return Split(words, *(Folds(tuple(folds), fitted, shifted) for fitted in (True, False)))

    for names, words in ((("kossel_4",), "Kossel"), (("v400_a2", "v400_a3"), "V400, 2 files"), (("q5",), "Q5")):
        yield split(f"{words}: each row left out", [f for name in names for f in left_out(*files[name])])
    for days, words in (("kossel_1", "kossel_2"), "Kossel"), (("v400_a1", "v400_a2", "v400_a3", "v400_a4"), "V400"):
        folds = [
            Fold(*files[day], tuple(heights(*files[other], files[day][0])))
            for pair in itertools.pairwise(days)
            for day, other in (pair, pair[::-1])
        ]
        yield split(f"{words}: heights of another day, up to a shift", folds, shifted=True)


DATA = Printers(
    name="Printers",
    robot="delta printers: Kossel, FLSUN Super Racer, V400 and Q5",
    instrument="their own probes, and a caliper on printed objects",
    origin="files of github.com/AHHams/kossel-config, cupsster/FLSUN-SR---Klipper-Config,"
    " danorder/Flsun-super-racer-Full-klipper-config-, fzechert/FLSun-V400, Brumet/Flsun-v400,"
    " RazorCopter/Klipper_FLSUN_Q5",
    licence="MIT, CC0-1.0, CC0-1.0, CC0-1.0, none stated, GPL-3.0; numbers only",
    columns="printer.cfg with [printer], [stepper_a] to [stepper_c] and the rows of [delta_calibrate] alone",
    folder="klipper_delta",
    files=tuple(f"{name}.cfg" for name in FILES),
    digest="185deee3da7226095cb9897a4357373f831f903296a2e3a5a2bfced94250d8f2",
    splits=_splits,
    owners="what Klipper saved leaves 0.004 to 0.076 mm at heights that it was fitted to",
)

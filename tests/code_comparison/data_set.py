"""What a data set says of itself, and one problem of it: rows to fit, and rows that no code sees."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np


class MissingDataError(Exception):
    """Files are not there, or not those that were published."""


@dataclass(frozen=True)
class Rows:
    """Joints (n, n_joints) [m or rad]; and points (n, 3) [m], or the place and the socket (n, 2) that were touched."""

    q: np.ndarray
    read: np.ndarray

    def __getitem__(self, index: np.ndarray) -> Rows:
        return Rows(self.q[index], self.read[index])

    def __len__(self) -> int:
        return len(self.q)

    def keys(self) -> set[bytes]:
        """What tells one row from another."""
        return {row.tobytes() for row in np.hstack([self.q, self.read])}


@dataclass(frozen=True)
class Split:
    """One way to part the rows."""

    words: str
    train: Any
    unseen: Any


@dataclass(frozen=True)
class DataSet(ABC):
    """Measurements by others; each kind of problem says how one is written for codes, and what errors are.

    Attributes:
        name: What the page calls it.
        robot, instrument: What was measured, and how.
        origin: Its address and what to cite.
        licence: Under which others may use it.
        columns: What its files hold, in words, for whoever fetches it by hand.
        folder: Its folder in the folder of all data.
        files: Names in the folder.
        digest: SHA-256 of all files, one after another.
        splits: Makes the splits, of the folder.
        owners: What its owners, or others before, report.
        reasons: Why this project is behind, by the words of a split; told where it is.
    """

    problem: ClassVar[str]
    unit: ClassVar[tuple[str, float]] = ("mm", 1e3)
    chance: ClassVar[float] = (
        1e-3  # of a difference by chance; small, as rows that follow each other are not independent
    )
    name: str
    robot: str
    instrument: str
    origin: str
    licence: str
    columns: str
    folder: str
    files: Sequence[str]
    digest: str
    splits: Callable[[Path], Iterable[Split]]
    _: KW_ONLY
    owners: str = ""
    reasons: Mapping[str, str] = field(default_factory=dict)

    @abstractmethod
    def write(self, here: Path, split: Split, folder: Path) -> None:
        """Write a problem as `codes/exchange.py` says; `here` has the files."""

    @abstractmethod
    def errors(self, unseen: Any, predicted: np.ndarray) -> np.ndarray:
        """How far off predictions are, one number for each unseen row [m, or px]."""

    def checked(self, folder: Path) -> Path:
        """Return the folder of its files, which are those that were published.

        Raises:
            MissingDataError: A file is missing, or another one.
        """
        here, read = folder / self.folder, hashlib.sha256()
        for path in (here / name for name in self.files):
            if not path.is_file():
                raise MissingDataError(f"{path} is missing; take it from {self.origin}, and write {self.columns}")
            read.update(path.read_bytes())
        if read.hexdigest() != self.digest:
            raise MissingDataError(f"{here}: {', '.join(self.files)} are other data than here, by their SHA-256")
        return here


def write_json(folder: Path, told: Mapping[str, object]) -> None:
    """Write problem.json, arrays as lists."""
    (folder / "problem.json").write_text(json.dumps(told, default=np.ndarray.tolist))


def drawn(rows: Rows, seed: int, n_train: int, n_unseen: int = 0) -> tuple[Rows, Rows]:
    """Return as many rows at random, in their order, and others."""
    order = np.random.default_rng(seed).permutation(len(rows))
    return rows[np.sort(order[:n_train])], rows[np.sort(order[n_train : n_train + n_unseen])]

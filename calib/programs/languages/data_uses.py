"""Uses of a program's data other than as targets.

Numbers of a target may be changed only if the program does nothing else with them. If the program sets them, they are
not the numbers of the text. If a condition or count depends on them, other numbers may change the program's path. If
the program computes other data from them, these count too, so decisions are followed back to their sources.
"""

from __future__ import annotations

from collections.abc import Iterable


class DataUses:
    """The names that a program sets, computes from each other, and decides by."""

    def __init__(self) -> None:
        self._set: dict[str, str] = {}
        self._decides: dict[str, str] = {}
        self._sources: dict[str, set[str]] = {}

    def note_change(self, name: str, why: str = "is set while the program runs") -> None:
        """Note that the program assigns a new value to a name."""
        self._set.setdefault(name, why)

    def compute(self, name: str, sources: Iterable[str]) -> None:
        """Note that a name is computed from others."""
        self._sources.setdefault(name, set()).update(sources)

    def decide(self, names: Iterable[str], line: int) -> None:
        """Note that the program's path depends on these names, or that an unknown routine gets them."""
        for name in names:
            self._decides.setdefault(name, f"also decides what the program does, in line {line}")

    def follow(self) -> None:
        """Mark all data from which deciding names are computed as deciding, too."""
        work = list(self._decides)
        while work:
            name = work.pop()
            for source in self._sources.get(name, ()):
                if source not in self._decides:
                    self._decides[source] = self._decides[name]
                    work.append(source)

    def is_set(self, name: str) -> bool:
        """Return whether the program sets a name."""
        return name in self._set

    def why_not(self, name: str) -> str:
        """Return why the numbers of a name must stay as they are; empty if they may be changed."""
        return self._set.get(name) or self._decides.get(name, "")

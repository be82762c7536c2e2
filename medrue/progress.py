"""Progress of long work, reported to whoever listens."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

Advance = Callable[[int], None]


class StageProgress(Protocol):
    """Something that reports stages of work."""

    def stage(self, name: str, total: int) -> AbstractContextManager[Advance]:
        """Announce a stage of `total` steps; the function that it gives is called with steps done."""


class SilentProgress:
    """Tell nothing."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        """See `StageProgress`."""
        yield lambda steps: None


class TerminalBars:
    """Progress bars on standard error, if that is a terminal."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        """See `StageProgress`."""
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bars(*columns, console=console, disable=not console.is_terminal, transient=True) as bars:
            task = bars.add_task(name, total=total)
            yield lambda steps: bars.advance(task, steps)

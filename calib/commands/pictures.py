"""Pictures are not this package's business: what draws them is found under the entry point group `calib.pictures`.

An entry is a module, called like the command that it adds, with

    command             that command
    pages(fit)          the pages of a result folder, file name -> content
    figures(subject)    the figures of an assessment or a selection, file name -> content

so that everything below this floor writes and computes without asking what is installed.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Protocol

import click

from calib.errors import InputError

if TYPE_CHECKING:
    from calib.identification.fitted import Fit

GROUP = "calib.pictures"


class Pictures(Protocol):
    """What an entry of the group offers."""

    command: click.Command

    def pages(self, fit: Fit) -> dict[str, bytes]:
        """Return the pages of a result folder."""

    def figures(self, subject: object) -> dict[str, bytes]:
        """Return the figures of an assessment or a selection."""


def commands() -> tuple[str, ...]:
    """Return names of the commands that are added."""
    return tuple(sorted(entry_points(group=GROUP).names))


def command(name: str) -> click.Command:
    """Return an added command."""
    (entry,) = entry_points(group=GROUP, name=name)
    found: Pictures = entry.load()
    return found.command


def pages(fit: Fit) -> dict[str, bytes]:
    """Return the pages of a result folder; none of a robot that cannot be assembled."""
    files: dict[str, bytes] = {}
    for entry in entry_points(group=GROUP) if fit.assembles else ():
        found: Pictures = entry.load()
        files |= found.pages(fit)
    return files


def figures(subject: object) -> dict[str, bytes]:
    """Return figures of an assessment or a selection as files, name -> content.

    Raises:
        InputError: Nothing that draws is installed, or something that it needs is missing.
    """
    found: list[Pictures] = [entry.load() for entry in entry_points(group=GROUP)]
    if not found:
        raise InputError(f"--plots: nothing that draws is installed (entry point group {GROUP})")
    files: dict[str, bytes] = {}
    for one in found:
        try:
            files |= one.figures(subject)
        except ImportError as error:
            raise InputError(f"--plots: {error.name} is not installed; `pip install {error.name}` first") from None
    return files

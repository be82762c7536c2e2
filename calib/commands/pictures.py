"""Pictures are not this package's business: what draws them is found under the entry point group `calib.pictures`.

An entry is a module, called like the command that it adds, with

    command             that command
    pages(fit, logo)    the pages of a result folder, file name -> content
    comparison(found)   the page of results side by side
    figures(subject)    the figures of an assessment or a selection, file name -> content

so that everything below this floor writes and computes without asking what is installed.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import click

from calib.errors import InputError
from calib.files import image_address

if TYPE_CHECKING:
    from calib.identification.fitted import Fit
    from calib.reporting.result_comparison import ResultComparison

GROUP = "calib.pictures"


class Pictures(Protocol):
    """What an entry of the group offers."""

    command: click.Command

    def pages(self, fit: Fit, logo: str) -> dict[str, bytes]:
        """Return the pages of a result folder, with an image that its address holds (none: empty)."""

    def comparison(self, found: ResultComparison) -> bytes:
        """Return the page of results side by side."""

    def figures(self, subject: object) -> dict[str, bytes]:
        """Return the figures of an assessment or a selection."""


def commands() -> tuple[str, ...]:
    """Return names of the commands that are added."""
    return tuple(sorted(entry_points(group=GROUP).names))


def command(name: str) -> click.Command:
    """Return an added command."""
    (entry,) = entry_points(group=GROUP, name=name)
    pictures: Pictures = entry.load()
    return pictures.command


def pages(fit: Fit, logo: Path | str | None = None) -> dict[str, bytes]:
    """Return the pages of a result folder; none of a robot that cannot be assembled.

    Args:
        fit: The fit.
        logo: PNG, JPEG or SVG file for the report.
    """
    address = "" if logo is None else image_address(logo)
    files: dict[str, bytes] = {}
    for entry in entry_points(group=GROUP) if fit.assembles else ():
        pictures: Pictures = entry.load()
        files |= pictures.pages(fit, address)
    return files


def comparison(found: ResultComparison) -> bytes:
    """Return the page of results side by side.

    Raises:
        InputError: Nothing that draws is installed.
    """
    modules: list[Pictures] = [entry.load() for entry in entry_points(group=GROUP)]
    if not modules:
        raise InputError(f"--html: nothing that draws is installed (entry point group {GROUP})")
    return modules[0].comparison(found)


def figures(subject: object) -> dict[str, bytes]:
    """Return figures of an assessment or a selection as files, name -> content.

    Raises:
        InputError: Nothing that draws is installed, or something that it needs is missing.
    """
    modules: list[Pictures] = [entry.load() for entry in entry_points(group=GROUP)]
    if not modules:
        raise InputError(f"--plots: nothing that draws is installed (entry point group {GROUP})")
    files: dict[str, bytes] = {}
    for one in modules:
        try:
            files |= one.figures(subject)
        except ImportError as error:
            raise InputError(f"--plots: {error.name} is not installed; `pip install {error.name}` first") from None
    return files

"""Pictures are drawn by another package, which is found under the entry point group `calib.pictures`.

An entry is a module with the name of the command that it adds, and with the functions of `Pictures`. So all other code
writes and computes without asking what is installed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

from calib.core.base.errors import InputError
from calib.core.base.files import image_address

if TYPE_CHECKING:
    from calib.core.fitting.fitted import Fit
    from calib.core.robots.robot import Robot

GROUP = "calib.pictures"
Drawn = TypeVar("Drawn")


class Plots(Protocol):
    """Figures of a fit: axes in (a new figure if not given), axes out."""

    def __call__(self, axes: Any = None) -> Any:
        """Draw `errors`."""

    def errors(self, axes: Any = None) -> Any:
        """Draw how many points have which error, before and after."""

    def by_pose(self, axes: Any = None) -> Any:
        """Draw the error of each pose in the order of measurement."""

    def residuals(self, joint: str, axes: Any = None) -> Any:
        """Draw residuals against a joint."""

    def normal(self, axes: Any = None) -> Any:
        """Draw residuals against normal noise."""

    def parameters(self, axes: Any = None) -> Any:
        """Draw parameters with their 95 % intervals, in sigmas of what was expected."""


class Live(Protocol):
    """A live page in a browser on this computer."""

    @property
    def url(self) -> str:
        """Address to open."""

    def show(self, progress: Any) -> None:
        """Show the progress after the poses measured so far."""

    def remember(self, progress: Any) -> None:
        """Keep the progress after some poses, for the curve towards the goal."""

    def close(self) -> None:
        """End the viewer."""


class Pictures(Protocol):
    """Functions that an entry of the group offers."""

    summary: str
    """Summary of the command, for the list of commands."""
    command: click.Command

    def pages(self, fit: Fit, logo: str) -> dict[str, bytes]:
        """Return the pages of a result folder, with an image that its address holds (none: empty)."""

    def comparison(self, result_comparison: Any) -> bytes:
        """Return the page of results side by side."""

    def fleet(self, learned: Any) -> bytes:
        """Return the page of a fleet."""

    def answer(self, subject: object, title: str, text: str, figures: Sequence[tuple[int, str]]) -> bytes:
        """Return the page of a judgement or of a hand-eye calibration, with the text on the terminal.

        `figures` are HTML of pictures, each with the number of the image that it belongs to (-1: of none).
        """

    def figures(self, subject: object) -> dict[str, bytes]:
        """Return the figures of an assessment or a selection."""

    def plots(self, fit: Fit) -> Plots:
        """Return the figures of a fit."""

    def live(self, robot: Robot, dragged: bool) -> Live:
        """Return a live page; `dragged`: one with a slider for each joint and a target to drag."""


def commands() -> tuple[str, ...]:
    """Return names of the commands that are added."""
    return tuple(sorted(entry_points(group=GROUP).names))


def named(name: str) -> Pictures:
    """Return the functions of an entry, the one that adds the command of this name."""
    (entry,) = entry_points(group=GROUP, name=name)
    pictures: Pictures = entry.load()
    return pictures


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


def figures(subject: object) -> dict[str, bytes]:
    """Return figures of an assessment or a selection as files, name -> content.

    Raises:
        InputError: Nothing that draws is installed, or something that it needs is missing.
    """
    return _with_packages("--plots", lambda pictures: pictures.figures(subject))


def plots(fit: Fit) -> Plots:
    """Return the figures of a fit as methods that draw.

    Raises:
        InputError: Nothing that draws is installed, or something that it needs is missing.
    """
    return _with_packages("plot", lambda pictures: pictures.plots(fit))


def _with_packages(option: str, draw: Callable[[Pictures], Drawn]) -> Drawn:
    try:
        return draw(installed(option))
    except ImportError as error:
        raise InputError(f"{option}: {error.name} is not installed; `pip install {error.name}` first") from None


def installed(option: str) -> Pictures:
    """Return the functions that draw, for an option or attribute that needs them.

    Raises:
        InputError: Nothing that draws is installed.
    """
    entry = next(iter(entry_points(group=GROUP)), None)
    if entry is None:
        raise InputError(f"{option}: nothing that draws is installed (entry point group {GROUP})")
    pictures: Pictures = entry.load()
    return pictures

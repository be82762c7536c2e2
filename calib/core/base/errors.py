"""Errors that a user can act on: what is wrong, where, and what to do.

Two families, one for each exit code of the command line:

* `InputError` (exit code 2): a file, a name, a unit, a number or a pose that was given is wrong.
* `ComputationError` (exit code 3): the input is fine, but no answer that can be trusted came out.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import SequenceMatcher
from importlib import import_module
from itertools import takewhile
from typing import Any

from calib.core.base.letters import brief, visible

_ALIKE = 0.6
"""One name may be a misspelling of another if at least this part of both agrees."""
_LISTED = 100
"""Largest number of names in a message: all parameters of most robots."""


class CalibrationError(Exception):
    """Base of every error that this package raises on purpose: what is wrong, where, and what to do.

    Long quotes of files in the message are cut.
    """

    exit_code = 3

    def __init__(self, message: str = "") -> None:
        super().__init__(brief(visible(message)))


class InputError(CalibrationError):
    """Something that the user gave is wrong; nothing was computed or written."""

    exit_code = 2


class UrdfError(InputError):
    """The URDF cannot be read, or does not describe one tree of joints."""


class DescriptionError(InputError):
    """The robot description (YAML) is not valid, or does not fit its URDF."""


class DataError(InputError):
    """A table of joint values or measurements is not valid."""


class ParameterError(InputError):
    """A parameter name, value or table is not valid."""


class UnreachablePoseError(InputError):
    """Poses that were given cannot be assembled: a loop stays open there."""


class ComputationError(CalibrationError):
    """The computation could not give an answer that can be trusted."""


class NotIdentifiableError(ComputationError):
    """The measurements do not determine the requested parameters."""


class NotConvergedError(ComputationError):
    """The iteration stopped before it reached a solution."""


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return the hint `"; did you mean 'x'?"`, or the list of valid names when none is close.

    >>> nearest("degrees", ["rad", "deg"])
    "; did you mean 'deg'?"
    >>> nearest("q", ["rad", "deg"])
    '; valid: deg, rad'
    >>> nearest("elbow.offset", ["elbow.x", "elbow.rz", "wrist.x"])
    "; 'elbow' has elbow.rz, elbow.x"
    """
    names = sorted({str(item) for item in valid})
    same = [item for item in names if item.casefold() == str(name).casefold()]
    stem, _, leaf = str(name).rpartition(".")
    stem = stem or leaf
    siblings = [item for item in names if item.startswith(f"{stem}.")]
    if not same and len(siblings) > 1 and not any(_alike(item.removeprefix(f"{stem}."), leaf) for item in siblings):
        return f"; '{stem}' has {', '.join(siblings)}"
    close = same[0] if same else _closest(str(name), names)
    if close:
        return f"; did you mean '{close}'?"
    if not names:
        return "; nothing is valid here"
    return f"; valid: {listed_columns(names)}"


def require_known(name: str, valid: Collection[str], message: str, error: type[Exception] = InputError) -> None:
    """Raise an error with this beginning, the name and the `nearest` valid one, unless the name is valid."""
    if name not in valid:
        raise error(f"{message} '{name}'{nearest(name, valid)}")


def require_package(name: str, missing: str, error: type[Exception] = InputError) -> Any:
    """Return an optional package, or a module of one; raise the `error` with the message `missing` without it."""
    try:
        return import_module(name)
    except ImportError:
        raise error(missing) from None


def listed_columns(columns: Collection[str]) -> str:
    """Return names, such as the columns of a file, as a list; of very many the first ones."""
    names = list(columns)
    more = f", and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return (", ".join(names[:_LISTED]) or "no columns") + more


def _alike(name: str, other: str) -> bool:
    return SequenceMatcher(None, name.casefold(), other.casefold()).ratio() >= _ALIKE


def _closest(name: str, names: list[str]) -> str:
    """The name with most words in common at the beginning, then the most similar one; empty if none is close.

    Beginnings count more than endings, because many names end alike, such as `..._joint`.
    """
    words = _words(name)
    best, closest = (0, 0.0), ""
    for item in names:
        other = _words(item)
        shared = len(list(takewhile(lambda pair: pair[0] == pair[1], zip(words, other, strict=False))))
        continued = 0 < shared == min(len(words), len(other))
        alike = SequenceMatcher(None, item, name).ratio()
        if (alike >= _ALIKE or continued) and (shared, alike) >= best:
            best, closest = (shared, alike), item
    return closest


def _words(name: str) -> list[str]:
    return re.findall(r"[^\W_]+", name.casefold())

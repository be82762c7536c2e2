"""Words of other packages, and what to write here: the table `other_words.txt`, behind errors and a page of the docs.

There is one word for each thing in this package. A user who types the word of another
package, as an attribute, a command or an option, gets a hint at the word here.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from calib.core.base.errors import InputError, nearest

EXAMPLES = ("joint_3.z", "joint_4.x")
"""Examples in the table of words. If a robot lacks them, hints name its first and last parameter."""


class UnknownNameError(InputError, AttributeError):
    """Something has no attribute of this name."""


class UnknownOptionError(InputError, TypeError):
    """Something is used in an unintended way."""


@dataclass(frozen=True)
class Words:
    """Words for one thing.

    Attributes:
        package: Package that uses the words.
        words: The words.
        here: The word here, with remarks.
    """

    package: str
    words: tuple[str, ...]
    here: str


@functools.cache
def tables() -> dict[str, tuple[Words, ...]]:
    """Return all words by place; the table is read at the first use."""
    result: dict[str, tuple[Words, ...]] = {}
    section = ""
    for line in Path(__file__).with_suffix(".txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif line and not line.startswith("#"):
            package, words, here = (cell.strip() for cell in line.split(" | "))
            result[section] = (*result.get(section, ()), Words(package, tuple(words.split()), here))
    return result


def hint_for(word: str, section: str) -> str:
    """Return the hint for a word of other packages, from a section of the table, to end a message; or nothing."""
    row = _row(word, section, str) or _row(word, section, _plain)
    return f"; here: {row.here.replace('`', '')}" if row else ""


def _row(word: str, section: str, spelling: Callable[[str], str]) -> Words | None:
    """The row of the table that has a word; words are the same if `spelling` gives the same text for them."""
    spelled = spelling(word)
    return next((row for row in tables().get(section, ()) if spelled in map(spelling, row.words)), None)


def _plain(word: str) -> str:
    """A word without capitals, underscores and a first verb such as `get`: `getParams` becomes `params`."""
    plain = word.casefold().replace("_", "")
    for verb in ("get", "compute", "calculate", "calc", "load", "read", "make"):
        if len(plain) > len(verb) and plain.startswith(verb):
            return plain.removeprefix(verb)
    return plain or word


class HintedObject:
    """Base of objects that users hold: the error for an unknown attribute names the right one.

    `_other_words` is the section of the table with what other packages call its attributes.
    """

    _other_words: ClassVar[str] = ""

    def _own_parameters(self) -> Sequence[str]:
        """Names of its parameters, if any; hints then show these in place of `EXAMPLES`."""
        return ()

    if not TYPE_CHECKING:  # type checkers know better which attributes there are

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            if any(name in parent.__dict__ for parent in type(self).__mro__):
                return object.__getattribute__(self, name)  # the name exists: show the error inside it
            hint = hint_for(name, self._other_words)
            own = [*self._own_parameters()] if hint else []
            for example, parameter in zip(EXAMPLES, own[:1] + own[-1:], strict=False):
                hint = hint if example in own else hint.replace(f'"{example}"', f'"{parameter}"')
            raise UnknownNameError(_unknown_name_error(type(self).__name__, name, hint, dir(self)))


def _unknown_name_error(of: str, name: str, hint: str, names: list[str]) -> str:
    public = [candidate for candidate in names if candidate[0] != "_" and candidate.isidentifier()]
    return f"{of} has no '{name}'" + (hint or nearest(name, public))


def unknown_name_error(name: str, names: list[str]) -> UnknownNameError:
    """Return the error of a name that `calib` does not have; `names` are those that it has."""
    return UnknownNameError(_unknown_name_error("module 'calib'", name, hint_for(name, "`calib` itself"), names))

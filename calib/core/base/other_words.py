"""Words of other packages, and what to write here: the table `other_words.txt`, behind errors and a page of the docs.

There is one word for each thing in this package. Who types the word of another one is told this one, in place of a bare
`AttributeError` or `TypeError`.
"""

from __future__ import annotations

import functools
from abc import ABCMeta
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter, get_annotations, signature
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeVar

from calib.core.base.errors import InputError, nearest

EXAMPLES = ("joint_3.z", "joint_4.x")
"""Parameters that the table names; a robot without them has its first and last one there."""
P = ParamSpec("P")
R = TypeVar("R")


class UnknownNameError(InputError, AttributeError):
    """Something has no attribute of this name."""


class UnknownOptionError(InputError, TypeError):
    """A function takes no argument of this name, or is called in another way than it is meant."""


@dataclass(frozen=True)
class Words:
    """Words for one thing.

    Attributes:
        package: Whose words they are.
        words: The words.
        here: What to write here, with what there is to say about it.
    """

    package: str
    words: tuple[str, ...]
    here: str


def tables() -> dict[str, tuple[Words, ...]]:
    """Return all words, by where they are looked for; read when the first is."""
    return _read(Path(__file__).with_suffix(".txt").read_text(encoding="utf-8"))


@functools.cache
def _read(text: str) -> dict[str, tuple[Words, ...]]:
    result: dict[str, tuple[Words, ...]] = {}
    place = ""
    for line in text.splitlines():
        if line.startswith("["):
            place = line.strip("[]")
        elif line and not line.startswith("#"):
            package, words, here = (cell.strip() for cell in line.split(" | "))
            result[place] = (*result.get(place, ()), Words(package, tuple(words.split()), here))
    return result


def way(word: str, place: str) -> str:
    """Return what to write for a word of another package, as the end of a message; empty if the table has none.

    Args:
        word: The word.
        place: Where it is looked for, as the table has it.
    """
    row = _row(word, place, str) or _row(word, place, _plain)
    return f"; here: {row.here.replace('`', '')}" if row else ""


def _row(word: str, place: str, spelling: Callable[[str], str]) -> Words | None:
    """The row of the table that has a word, of which spellings count as the same that this function makes the same."""
    spelled = spelling(word)
    for row in tables().get(place, ()):
        if spelled in (spelling(other) for other in row.words):
            return row
    return None


def _plain(word: str) -> str:
    """A word without capitals, underscores and a verb that says nothing: `getParams` is `params`."""
    plain = word.casefold().replace("_", "")
    for verb in ("get", "compute", "calculate", "calc", "load", "read", "make"):
        if len(plain) > len(verb) and plain.startswith(verb):
            return plain.removeprefix(verb)
    return plain or word


class _Worded(ABCMeta):
    """The class of classes that are asked for more than they have, such as `Robot.from_urdf`."""

    if not TYPE_CHECKING:

        def __getattr__(cls, name: str) -> Any:
            if name.startswith("_") or name in get_annotations(cls):  # dataclasses ask for each field's default
                raise AttributeError(name)
            raise UnknownNameError(_no_name(f"class {cls.__name__}", name, way(name, cls._other_words), dir(cls)))

        def __setattr__(cls, name: str, value: Any) -> None:
            """Set an attribute of the class; that of frozen dataclasses which refuses to assign says what to do."""
            super().__setattr__(name, _refuse if name == "__setattr__" else value)

        def __call__(cls, *args: Any, **options: Any) -> Any:
            """Make one; who meant to load one is told how."""
            try:
                return super().__call__(*args, **options)
            except TypeError as error:
                if not cls._made_by or isinstance(error, InputError) or _binds(cls.__init__, args, options):
                    raise
                raise UnknownOptionError(f"{cls.__name__}: is made by {cls._made_by}") from None


def _refuse(never_changed: Worded, name: str, value: object) -> None:
    place = never_changed._other_words
    hint = way(name, place) or way("=", place)
    raise UnknownNameError(f"{type(never_changed).__name__}: never changes, so '{name}' cannot be set{hint}")


def _binds(function: Callable[..., Any], args: tuple[Any, ...], options: dict[str, Any]) -> bool:
    try:
        signature(function).bind(None, *args, **options)
    except TypeError:
        return False
    return True


class Worded(metaclass=_Worded):
    """Base of what users hold: a name that it does not have is answered with the one that is meant.

    Attributes:
        _other_words: Section of the table with what other packages call its attributes (class attribute).
        _made_by: What makes one, if not the class itself (class attribute).
    """

    _other_words: ClassVar[str] = ""
    _made_by: ClassVar[str] = ""

    def _own_parameters(self) -> Sequence[str]:
        """Names of its parameters, which hints have in place of `EXAMPLES`; none where it has none."""
        return ()

    def _way(self, word: str) -> str:
        """What to write for a word of another package, with names that this object has."""
        hint = way(word, self._other_words)
        own = [*self._own_parameters()] if hint else []
        for example, name in zip(EXAMPLES, own[:1] + own[-1:], strict=False):
            hint = hint if example in own else hint.replace(f'"{example}"', f'"{name}"')
        return hint

    if not TYPE_CHECKING:  # type checkers know better which attributes there are

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            if any(name in parent.__dict__ for parent in type(self).__mro__):
                return object.__getattribute__(self, name)  # it has it: the error that comes is what went wrong inside
            raise UnknownNameError(_no_name(type(self).__name__, name, self._way(name), dir(self)))

        def __getitem__(self, key: Any) -> Any:
            raise UnknownOptionError(f"{type(self).__name__}: takes no [{key!r:.40}]{self._way('[]')}")

        def __len__(self) -> int:
            raise UnknownOptionError(f"{type(self).__name__}: has no length{self._way('len()')}")

        def __bool__(self) -> bool:
            return type(self).__len__ is Worded.__len__ or len(self) > 0  # what has no length is never empty

        def __call__(self, *args: Any, **options: Any) -> Any:
            """Say what to call instead."""
            raise UnknownOptionError(f"{type(self).__name__}: is not a function{self._way('()')}")

        def _no_number(self, *_other: object) -> Any:
            raise UnknownOptionError(f"{type(self).__name__}: is not a number{self._way('+')}")

        __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _no_number
        __neg__ = __abs__ = __float__ = __lt__ = __le__ = __gt__ = __ge__ = _no_number


def _no_name(of: str, name: str, hint: str, names: list[str]) -> str:
    public = [candidate for candidate in names if candidate[0] != "_" and candidate.isidentifier()]
    return f"{of} has no '{name}'" + (hint or nearest(name, public))


def no_name_in_package(name: str, names: list[str]) -> UnknownNameError:
    """Return the error of a name that `calib` does not have, whose names these are."""
    return UnknownNameError(_no_name("module 'calib'", name, way(name, "`calib` itself"), names))


def _is_whole(value: object) -> bool:
    return hasattr(value, "__index__")


def _is_path(value: object) -> bool:
    return isinstance(value, (str, PathLike))


_MEANT: dict[str, tuple[Callable[[object], bool], str]] = {
    "int": (_is_whole, "a whole number"),
    "float": (lambda value: isinstance(value, Real), "a number"),
    "Path | str": (_is_path, "a path"),
    "str | Sequence[str]": (lambda value: isinstance(value, (str, Sequence)), "a name, or a list of names"),
    "Mapping[str, str] | None": (
        lambda value: value is None or isinstance(value, Mapping),
        'values by name, such as {"joint_3.z": "0.1 mm"}',
    ),
    "Progress | None": (
        lambda value: value is None or callable(value),
        "what is called with two numbers: lambda done, total: ...",
    ),
}
"""What an argument with such an annotation may be: the test, and its words."""


def worded(function: Callable[P, R]) -> Callable[P, R]:
    """Answer an argument that a function does not take with the one that is meant; and one of a wrong type.

    Args:
        function: The function.

    Raises:
        UnknownOptionError: From what is returned, where it is called with such an argument.
    """
    parameters = signature(function).parameters
    known = [name for name in parameters if name != "self"]
    in_order = [name for name, parameter in parameters.items() if parameter.kind is not Parameter.KEYWORD_ONLY]
    needed = [name for name in in_order if parameters[name].default is Parameter.empty]
    named = [
        name
        for name, parameter in parameters.items()
        if parameter.kind is Parameter.KEYWORD_ONLY and parameter.default is Parameter.empty
    ]
    order = ", ".join(name for name in in_order if name != "self")
    takes = f"{order} in this order, and the rest by name" if order else "every argument by its name"
    place = f"arguments of {function.__name__}"
    called_as = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]

    @functools.wraps(function)
    def called(*args: P.args, **options: P.kwargs) -> R:
        for name in options:
            if name not in known:
                hint = way(name, place) or way(name, "arguments") or nearest(name, known)
                raise UnknownOptionError(f"{called_as}: takes no argument '{name}'{hint}")
        if len(args) > len(in_order):
            raise UnknownOptionError(f"{called_as}: takes {takes}{way('another', place)}")
        missing = [name for name in (*needed[len(args) :], *named) if name not in options]
        if missing:
            verb = "is" if len(missing) == 1 else "are"
            raise UnknownOptionError(f"{called_as}: {' and '.join(missing)} {verb} missing; it takes {takes}")
        for name, value in (*zip(in_order, args, strict=False), *options.items()):
            meant = _MEANT.get(parameters[name].annotation)
            if meant is not None and not meant[0](value):
                raise UnknownOptionError(f"{called_as}: {name}: expected {meant[1]}, not {value!r:.40}")
        return function(*args, **options)

    return called

"""Names of array types, frozen dataclasses whose arrays are frozen too, and random numbers from a seed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from functools import cache, cached_property, wraps
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.core.base.errors import InputError, require_known

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


def as_slice(chosen: IntArray) -> IntArray | slice:
    """Return consecutive indices (n,) as a slice, so that the selected part is changed in place, not copied."""
    first = int(chosen[0]) if len(chosen) else 0
    span = slice(first, first + len(chosen))
    return span if np.array_equal(chosen, np.arange(span.start, span.stop)) else chosen


def evenly_spread(n: int, most: int) -> IntArray:
    """Return at most so many places out of n, evenly spread from the first to the last, (n_places,)."""
    return np.unique(np.linspace(0, n - 1, min(most, n)).astype(np.intp))


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array itself if it is read-only, and the array that it is a view of; else a read-only copy."""
    owner = array if array.base is None else array.base
    if isinstance(owner, np.ndarray) and not (array.flags.writeable or owner.flags.writeable):
        return array
    copied = array.copy()
    copied.flags.writeable = False
    return copied


def hold(*arrays: NDArray[Any]) -> None:
    """Make new arrays read-only, so that their owner needs no copies."""
    for array in arrays:
        array.flags.writeable = False


_HOLDING = (np.ndarray, tuple, dict)


def _read_only_copy(value: Any) -> Any:
    """Return an array, or a tuple or dictionary of arrays, that is read-only; anything else as it is."""
    if isinstance(value, np.ndarray):
        return read_only(value)
    if isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
        return tuple(read_only(array) for array in value)
    if isinstance(value, dict) and any(isinstance(array, np.ndarray) for array in value.values()):
        return {key: _read_only_copy(array) for key, array in value.items()}
    return value


def _short(value: object) -> str:
    """Text of one value, or the number of values."""
    if isinstance(value, np.ndarray):
        return str(value.shape)
    return f"of {len(value)}" if isinstance(value, (tuple, list, dict, frozenset)) else repr(value)


@cache
def _names_of_fields(of: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(of))


def numbers_in(given: ArrayLike, what: str) -> FloatArray:
    """Return numbers in the given shape, (..., n), NaN where they are masked.

    Anything else, such as text or complex numbers, is an `InputError` that says what.
    """
    try:
        array = np.ma.asarray(given) if isinstance(given, np.ma.MaskedArray) else np.asarray(given)
        if not np.iscomplexobj(array):
            return np.asarray(np.ma.filled(array.astype(float, copy=False), np.nan))
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
    raise InputError(f"{what}: expected numbers, not {given!r:.60}")


class NamedRows(np.ndarray[Any, np.dtype[np.float64]]):
    """A read-only array whose rows also have names: `limits["elbow"]` is `limits[1]`; its parts are plain arrays."""

    _names: tuple[str, ...] = ()

    @staticmethod
    def from_array(array: FloatArray, names: tuple[str, ...]) -> NamedRows:
        """Return the array (n, ...) with names of its rows; taking a row of another name is an `InputError`."""
        result = read_only(array).view(NamedRows)
        result._names = names
        return result

    def __getitem__(self, key: Any) -> Any:
        """Return a row by its name (an unknown one is an `InputError`), or anything else as an array does."""
        if isinstance(key, str):
            require_known(key, self._names, "no row")
        return np.asarray(self)[self._names.index(key) if isinstance(key, str) else key]

    def __reduce__(self) -> tuple[Callable[..., NamedRows], tuple[FloatArray, tuple[str, ...]]]:
        return NamedRows.from_array, (np.asarray(self), self._names)

    def __repr__(self) -> str:
        return repr(np.asarray(self))


def _held(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make the array that a function of one object returns read-only."""

    @wraps(function)
    def answer(thing: Any) -> Any:
        value = function(thing)
        if isinstance(value, np.ndarray):
            hold(value)
        return value

    return answer


class ReadOnlyArrays:
    """Base of frozen dataclasses: arrays, tuples and dictionaries of them become read-only copies.

    Arrays of cached properties are read-only, too, and all of them after unpickling. `repr` shows the shapes of arrays,
    not their numbers.
    """

    def __init_subclass__(cls) -> None:
        for value in vars(cls).values():
            if isinstance(value, cached_property):
                value.func = _held(value.func)
        if cls.__repr__ is ReadOnlyArrays.__repr__:
            cls.__repr__ = ReadOnlyArrays.__repr__  # type: ignore[method-assign]  # the class has its own, which dataclass keeps

    def __repr__(self) -> str:
        shown = (f"{field.name} {_short(getattr(self, field.name))}" for field in fields(self))  # type: ignore[arg-type]
        return f"<{type(self).__name__}: {', '.join(shown)}>"

    def __post_init__(self) -> None:
        kept = self.__dict__
        for name in _names_of_fields(type(self)):  # type: ignore[arg-type]  # classes have a hash
            value = kept[name]
            if isinstance(value, _HOLDING):
                kept[name] = _read_only_copy(value)

    def _with(self, forgotten: tuple[str, ...] = (), **values: Any) -> Self:
        """Return a copy with other values of some fields; cached results stay, except those to forget."""
        changed = object.__new__(type(self))
        changed.__dict__.update(self.__dict__)
        for name in forgotten:
            changed.__dict__.pop(name, None)
        changed.__dict__.update({name: _read_only_copy(value) for name, value in values.items()})
        return changed

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({name: _read_only_copy(value) for name, value in state.items()})  # unpickled: writable


class ReadAsArray(np.lib.mixins.NDArrayOperatorsMixin, ABC):
    """Base of objects that NumPy reads as one array: `1e3 * residuals`, `predicted - measured`.

    A subclass says by `__array__` which array that is.
    """

    @abstractmethod
    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the array."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with the arrays; `InputError` if NumPy would repeat both to a common shape."""
        plain = [np.asarray(given) if isinstance(given, ReadAsArray) else given for given in inputs]
        shapes = [np.shape(given) for given in plain]
        with suppress(ValueError):  # shapes that do not fit: the function says so
            if method == "__call__" and np.broadcast_shapes(*shapes) not in shapes:
                raise InputError(
                    f"{type(self).__name__}: shapes {' and '.join(map(str, shapes))} do not match: numpy would repeat"
                    f" both; give an array of shape {np.shape(self)}"
                )
        return getattr(ufunc, method)(*plain, **options)

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self)[key]

    def __len__(self) -> int:
        return len(np.asarray(self))


def random_numbers(seed: int | np.random.Generator) -> np.random.Generator:
    """Return a generator of random numbers; a negative seed is an `InputError`."""
    if isinstance(seed, int) and seed < 0:
        raise InputError(f"seed {seed}: must be zero or positive")
    return np.random.default_rng(seed)

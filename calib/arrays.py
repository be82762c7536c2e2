"""Names of array types, and frozen dataclasses whose arrays are frozen too."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array itself if nobody can write to it, else a read-only copy."""
    if not array.flags.writeable and array.base is None:
        return array
    copied = array.copy()
    copied.flags.writeable = False
    return copied


class ReadOnlyArrays:
    """Base of frozen dataclasses: arrays, and tuples of them, become read-only copies, also after unpickling."""

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]  # only dataclasses derive from this
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, field.name, read_only(value))
            elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
                object.__setattr__(self, field.name, tuple(read_only(array) for array in value))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        ReadOnlyArrays.__post_init__(self)  # unpickled arrays can be written to

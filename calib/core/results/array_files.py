"""Nested data with arrays as one binary file: a zip of NumPy arrays (`numpy.load` reads it), without pickle.

Entry `content` is JSON in UTF-8. An array in it is `{"array": k}`, stored in the entry named k. The zip has a checksum
of every entry, so that a damaged file is never read as other numbers.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

_CONTENT, _ARRAY = "content", "array"


def array_file(content: object) -> bytes:
    """Return the file of mappings, sequences, arrays, text and numbers; NaN and infinite numbers included."""
    arrays: list[NDArray[Any]] = []
    text = json.dumps(content, default=lambda array: {_ARRAY: _place_in(arrays, array)})
    entries = {_CONTENT: np.frombuffer(text.encode(), dtype=np.uint8)}
    entries |= {str(k): array for k, array in enumerate(arrays)}
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **entries)
    return stream.getvalue()


def read_array_file(file: bytes) -> Any:
    """Return the content that `array_file` wrote, sequences as lists, or raise `ValueError` if it is damaged."""
    try:
        with np.load(io.BytesIO(file), allow_pickle=False) as entries:
            content = json.loads(entries[_CONTENT].tobytes())
            return _with_arrays(content, {name: entries[name] for name in entries.files if name != _CONTENT})
    except Exception as error:  # zip, zlib, NumPy and JSON raise many kinds of errors for damage
        raise ValueError(f"it is damaged: {error}") from None


def _place_in(arrays: list[NDArray[Any]], array: object) -> int:
    """The index of an array among others, at whose end it is put unless it is there."""
    if not isinstance(array, np.ndarray):
        raise TypeError(f"cannot be stored: {type(array).__name__}")
    known = next((k for k, other in enumerate(arrays) if other is array), len(arrays))
    arrays += [array] * (known == len(arrays))
    return known


def _with_arrays(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {_ARRAY}:
            return arrays[str(value[_ARRAY])]
        return {key: _with_arrays(part, arrays) for key, part in value.items()}
    return [_with_arrays(part, arrays) for part in value] if isinstance(value, list) else value

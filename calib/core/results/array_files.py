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
    text = json.dumps(_without_arrays(content, arrays))
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


def _without_arrays(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """The value with arrays replaced by their indices, and appended to `arrays` unless they are there."""
    if isinstance(value, np.ndarray):
        known = next((k for k, array in enumerate(arrays) if array is value), len(arrays))
        if known == len(arrays):
            arrays.append(value)
        return {_ARRAY: known}
    if isinstance(value, dict):
        return {key: _without_arrays(part, arrays) for key, part in value.items()}
    return [_without_arrays(part, arrays) for part in value] if isinstance(value, (list, tuple)) else value


def _with_arrays(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        if value.keys() == {_ARRAY}:
            return arrays[str(value[_ARRAY])]
        return {key: _with_arrays(part, arrays) for key, part in value.items()}
    return [_with_arrays(part, arrays) for part in value] if isinstance(value, list) else value

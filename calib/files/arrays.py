"""Named arrays as columns: NumPy's `.npz`, MATLAB's `.mat`, JSON."""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from calib.core.base.errors import DataError
from calib.core.base.files import read_bytes
from calib.core.data.other_formats import SomeFile

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


def numpy_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a NumPy file.

    Raises:
        DataError: The file cannot be read, or has no arrays of one length.
    """
    try:
        loaded = np.load(io.BytesIO(_content(file)), allow_pickle=False)
        return _columns(file, {file.path.stem: loaded} if isinstance(loaded, np.ndarray) else dict(loaded))
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise _unreadable(file, error) from None


def mat5_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a MATLAB file of version 5; for errors see `numpy_columns`."""
    try:
        return _columns(file, _flatten(scipy.io.loadmat(io.BytesIO(_content(file)), simplify_cells=True)))
    except (ValueError, OSError, TypeError, NotImplementedError) as error:
        raise _unreadable(file, error) from None


def mat73_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a MATLAB file of version 7.3, whose axes are in reverse order.

    Raises:
        DataError: The package h5py is missing; for others see `numpy_columns`.
    """
    try:
        import h5py
    except ImportError:
        raise DataError(
            f"{file.path}: is a MATLAB file of version 7.3, and the package that reads them is not installed: pip"
            " install h5py; or save it with -v7"
        ) from None
    try:
        with h5py.File(file.path, "r") as opened:
            return _columns(file, {n: np.asarray(d).T for n, d in opened.items() if isinstance(d, h5py.Dataset)})
    except (ValueError, OSError, TypeError) as error:
        raise _unreadable(file, error) from None


def json_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of JSON: arrays by name, or records by name, in a list or one per line.

    Raises:
        DataError: The file is no valid JSON, or holds no arrays or records; for others see `numpy_columns`.
    """
    text = "\n".join(file.lines)
    try:
        try:
            content = json.loads(text)
        except ValueError:
            content = [json.loads(line) for line in file.lines if line.strip()]
        if isinstance(content, list) and content and all(isinstance(record, dict) for record in content):
            records = [_flatten(record) for record in content]
            content = {name: [record[name] for record in records] for name in records[0]}
        return _columns(file, _flatten(content if isinstance(content, dict) else {file.path.stem: content}))
    except KeyError as error:
        raise DataError(f"{file.path}: not every record has {error}; give each the same names") from None
    except (ValueError, RecursionError) as error:
        raise _unreadable(file, error) from None


def has_lists(file: SomeFile) -> bool:
    """Return whether the first row of a table has a list of numbers in a cell."""
    return len(file.first_lines) > 1 and bool(re.search(r'(^|[,"])\[[-+\d.e,\s]+(\]|$)', file.first_lines[1]))


def list_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a table with lists in its cells; for errors see `numpy_columns`."""
    try:
        header, *rows = (row for row in csv.reader(file.lines) if row)
        cells = zip(*([re.findall(r"[^\s,\[\]]+", c) if c[:1] == "[" else c for c in row] for row in rows), strict=True)
        columns = {name: np.array(column) for name, column in zip(header, cells, strict=True)}
        named = [_name_columns(name, a.astype(float) if a.ndim == 2 else a) for name, a in columns.items()]
        return {name: column for part in named for name, column in part.items()}
    except (ValueError, csv.Error) as error:
        raise _unreadable(file, error) from None


def _flatten(arrays: Mapping[str, Any], start: str = "") -> dict[str, Any]:
    """Arrays in nested structures, by names with those of the structures."""
    result: dict[str, Any] = {}
    for name, value in arrays.items():
        result |= _flatten(value, f"{start}{name}_") if isinstance(value, dict) else {f"{start}{name}": value}
    return result


def _content(file: SomeFile) -> bytes:
    return read_bytes(file.path, "a file of arrays", DataError)


def _unreadable(file: SomeFile, error: Exception) -> DataError:
    reason = " ".join(str(error).split())
    return DataError(f"{file.path}: cannot be read ({reason:.120}); save it again, with arrays of numbers alone")


def _columns(file: SomeFile, arrays: Mapping[str, Any]) -> dict[str, Sequence[object]]:
    """Columns of the numeric arrays whose first axis, or second of two, has the most frequent length.

    Texts of that length, such as names of poses, are columns, too.
    """
    numbers = {name: np.asarray(a) for name, a in arrays.items() if not name.startswith("__")}
    texts = {name: a.tolist() for name, a in numbers.items() if a.ndim == 1 and a.dtype.kind == "U"}
    numbers = {name: a.ravel() if 1 in a.shape and a.ndim == 2 else a for name, a in numbers.items()}
    numbers = {n: a for n, a in numbers.items() if a.ndim in (1, 2, 3) and a.size > 1 and np.isrealobj(a)}
    numbers = {n: a.astype(float) for n, a in numbers.items() if a.dtype.kind in "fiub"}
    lengths = [size for a in numbers.values() for size in {*a.shape[:2]}]
    if not lengths:
        raise DataError(f"{file.path}: holds no arrays of numbers; save one for each column, all of one length")
    most = max(lengths, key=lambda size: (lengths.count(size), size))
    columns: dict[str, Sequence[object]] = {name: column for name, column in texts.items() if len(column) == most}
    for name, array in numbers.items():
        if array.ndim == 2 and array.shape[0] != most:
            array = array.T
        if array.ndim == 3 and array.shape[2] == most:
            array = np.moveaxis(array, 2, 0)
        if array.shape[0] == most:
            columns |= _name_columns(name, array)
    return columns


def _name_columns(name: str, array: np.ndarray) -> dict[str, Sequence[object]]:
    """Columns of one array, (n, ...)."""
    if array.ndim == 1:
        return {name: array.tolist()}
    endings: tuple[str, ...]
    if array.shape[1:] == (3, 3):
        array, endings = array.reshape(-1, 9), tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
    elif array.shape[1:] == (4, 4):
        turned = scipy.spatial.transform.Rotation.from_matrix(array[:, :3, :3]).as_quat()
        array, endings = np.hstack([array[:, :3, 3], turned]), _POSE
    else:
        array = array.reshape(len(array), -1)
        endings = _POSE[:3] if array.shape[1] == 3 else tuple(str(k + 1) for k in range(array.shape[1]))
    return {f"{name}_{ending}": column.tolist() for ending, column in zip(endings, array.T, strict=True)}

"""Named arrays as columns: NumPy's `.npz`, MATLAB's `.mat`, JSON; and the JSON of LeRobot's servos.

A calibration of servos has no measurements, but it says what the numbers in a log of joints mean.
"""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy

from calib.core.base.errors import DataError, require_package
from calib.core.base.files import read_bytes
from calib.core.data.other_formats import SomeFile

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    TypeError,
    RuntimeError,
    MemoryError,
    OverflowError,
    zipfile.BadZipFile,
    csv.Error,
)


def numpy_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a NumPy file.

    Raises:
        DataError: The file cannot be read, or has no arrays of one length.
    """
    with _explain_errors(file):
        loaded = np.load(io.BytesIO(_content(file)), allow_pickle=False)
        return _columns(file, {file.path.stem: loaded} if isinstance(loaded, np.ndarray) else dict(loaded))


def mat5_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a MATLAB file of version 5; for errors see `numpy_columns`."""
    with _explain_errors(file):
        return _columns(file, _flatten(scipy.io.loadmat(io.BytesIO(_content(file)), simplify_cells=True)))


def mat73_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a MATLAB file of version 7.3, whose axes are in reverse order.

    Raises:
        DataError: The package h5py is missing; for others see `numpy_columns`.
    """
    what = f"{file.path}: is a MATLAB file of version 7.3, and the package that reads them is not installed"
    h5py = require_package("h5py", f"{what}: pip install h5py; or save it with -v7", DataError)
    with _explain_errors(file), h5py.File(file.path, "r") as opened:
        return _columns(file, {n: np.asarray(d).T for n, d in opened.items() if isinstance(d, h5py.Dataset)})


def json_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of JSON: arrays by name, or records by name, in a list or one per line.

    Raises:
        DataError: The file is no valid JSON, or holds no arrays or records; for others see `numpy_columns`.
    """
    with _explain_errors(file):
        try:
            content = json.loads("\n".join(file.lines))
        except ValueError:
            content = [json.loads(line) for line in file.lines if line.strip()]
        if isinstance(content, list) and content and all(isinstance(record, dict) for record in content):
            records = [_flatten(record) for record in content]
            content = {name: [record[name] for record in records] for name in records[0]}
        return _columns(file, _flatten(content if isinstance(content, dict) else {file.path.stem: content}))


def has_lists(file: SomeFile) -> bool:
    """Return whether the first row of a table has a list of numbers in a cell."""
    return len(file.first_lines) > 1 and bool(re.search(r'(^|[,"])\[[-+\d.e,\s]+(\]|$)', file.first_lines[1]))


def list_columns(file: SomeFile) -> dict[str, Sequence[object]]:
    """Return the columns of a table with lists in its cells; for errors see `numpy_columns`."""
    with _explain_errors(file):
        header, *rows = (row for row in csv.reader(file.lines) if row)
        cells = zip(*([re.findall(r"[^\s,\[\]]+", c) if c[:1] == "[" else c for c in row] for row in rows), strict=True)
        columns = {name: np.array(column) for name, column in zip(header, cells, strict=True)}
        named = [_name_columns(name, a.astype(float) if a.ndim == 2 else a) for name, a in columns.items()]
        return {name: column for part in named for name, column in part.items()}


def _flatten(arrays: Mapping[str, Any], start: str = "") -> dict[str, Any]:
    """Arrays in nested structures, by names with those of the structures."""
    result: dict[str, Any] = {}
    for name, value in arrays.items():
        result |= _flatten(value, f"{start}{name}_") if isinstance(value, dict) else {f"{start}{name}": value}
    return result


def _content(file: SomeFile) -> bytes:
    return read_bytes(file.path, "a file of arrays", DataError)


@contextmanager
def _explain_errors(file: SomeFile) -> Iterator[None]:
    """Turn errors of reading into `DataError`."""
    try:
        yield
    except KeyError as error:
        raise DataError(f"{file.path}: not every record has {error}; give each the same names") from None
    except _UNREADABLE as error:
        reason = " ".join(str(error).split())
        raise DataError(
            f"{file.path}: cannot be read ({reason:.120}); save it again, with arrays of numbers alone"
        ) from None


def _columns(file: SomeFile, arrays: Mapping[str, Any]) -> dict[str, Sequence[object]]:
    """Columns of the numeric arrays whose first axis, or second of two, has the most frequent length.

    Texts of that length, such as names of poses, are columns, too.
    """
    numbers = {name: _with_gaps(np.asarray(a)) for name, a in arrays.items() if not name.startswith("__")}
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


def _with_gaps(array: np.ndarray) -> np.ndarray:
    """The array; as numbers, if it has nothing but numbers and gaps, which are `null` in JSON."""
    is_numbers = array.dtype == object and all(cell is None or isinstance(cell, (int, float)) for cell in array.ravel())
    return array.astype(float) if is_numbers else array


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


_TICKS = 4096  # ticks in a turn of the servos of LeRobot's arms
_KEYS = ((b'"homing_offset"', b'"range_min"'), (b'"homing_offset"', b'"motor_names"'))  # current and first versions


def is_calibration_of_servos(file: SomeFile) -> bool:
    """Return whether a file is such JSON."""
    return file.head.lstrip()[:1] == b"{" and any(all(key in file.head for key in keys) for keys in _KEYS)


def servo_lines(file: SomeFile) -> list[str]:
    """Raise `DataError` with the lines of `columns` that convert a log's numbers to joint angles."""
    try:
        servos = json.loads("\n".join(file.lines))
        if "motor_names" in servos:
            ranges, signs, names = {}, {}, [str(name) for name in servos["motor_names"]]
        else:
            ranges = {str(name): (int(each["range_min"]), int(each["range_max"])) for name, each in servos.items()}
            signs = {str(name): -1 if each.get("drive_mode") else 1 for name, each in servos.items()}
            names = list(ranges)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise DataError(
            f"{file.path}: looks like a calibration of LeRobot, but cannot be read; save it again"
        ) from None
    named, turn = f"{file.path}: this looks like a calibration of LeRobot's servos, not measurements; ", 360 / _TICKS
    names = [name for name in names if "grip" not in name]
    in_degrees = _line({name: f"{name} [deg]" for name in names})
    if not ranges:
        raise DataError(
            f"{named}logs of this version are in degrees from the stretched arm; write {in_degrees} into the robot"
            " description of so101_old_calib.urdf or so100.urdf; find zeros and signs with a few poses"
            " (docs/howto/hobby_arm.md)"
        )
    of_range = _line({n: f"{signs[n] * (ranges[n][1] - ranges[n][0]) / 200 * turn:.4g} * {n} [deg]" for n in names})
    of_ticks = _line({n: f"{turn:.5g} * {n} - {(ranges[n][0] + ranges[n][1]) / 2 * turn:.6g} [deg]" for n in names})
    raise DataError(
        f"{named}write into the robot description: for a log of -100..100, {of_range}; for degrees, {in_degrees}; for"
        f" raw ticks, {of_ticks}; find zeros and signs with a few poses (docs/howto/hobby_arm.md)"
    )


def _line(entries: dict[str, str]) -> str:
    return "columns: {" + ", ".join(f'{name}.pos: "{text}"' for name, text in entries.items()) + "}"

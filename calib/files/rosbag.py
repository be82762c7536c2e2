"""ROS 2 bags as tables: joint states, and measurements made while the robot stood still.

Joints come from `sensor_msgs/JointState` messages of any topic, by their names. Measurements come from
`geometry_msgs/PointStamped`, `PoseStamped` and `TransformStamped`: the topic `/reflector` gives the columns
`reflector_x`, `_y`, `_z` [m], and poses also `_qx`, `_qy`, `_qz`, `_qw`. A topic `/tracker/ball` is `tracker/ball`;
`columns` of a robot description translates names of others.

Measurements and joint states are joined by time. A measurement counts if the robot stood still: from 0.25 s before to
0.25 s after it there are at least two joint states, on both sides of it, and no joint moves by more than 0.5 mrad
(0.5 mm). Each measurement is a row. Rows of one stop have the same `pose`, and the same joint values: the mean of the
joint states around them, since the flicker of encoders is no motion. Times are those of the headers; if any message has
none, all times are those of the recording. Column `time` counts from the first message.

The package rosbags reads bags without ROS. It is not needed for anything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError, require_package
from calib.core.base.words import count_noun

_WINDOW = 0.25  # before and after a measurement [s]
_STILL = 5e-4  # largest motion of a joint in this window [rad or m]
_JOINTS = "sensor_msgs/msg/JointState"
_PLACES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PointStamped": lambda message: (message.point, None),
    "geometry_msgs/msg/PoseStamped": lambda message: (message.pose.position, message.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda message: (message.transform.translation, message.transform.rotation),
}


_Series = list[tuple[float, ...]]
"""A row for each message: time in its header [s], 0 without one; time of recording [s]; its numbers [m, rad, 1]."""


def read_bag(path: Path | str) -> tuple[list[tuple[str, list[object]]], tuple[str, ...]]:
    """Return header and cells of each column of a bag's table, and remarks.

    `DataError` if rosbags is missing, the bag cannot be read or lacks joint states or measurements, or the robot never
    stood still at one.
    """
    joints, places = _series(path)
    if not joints:
        raise DataError(f"{path}: has no joint states (sensor_msgs/JointState); record their topic too{_topics(path)}")
    if not places:
        raise DataError(
            f"{path}: has no measurements (geometry_msgs/PointStamped, PoseStamped or TransformStamped); record their"
            f" topic too{_topics(path)}"
        )
    in_time = _sorted_by_time([*joints.values(), *places.values()])
    of_joints, measured = in_time[: len(joints)], dict(zip(places, in_time[len(joints) :], strict=True))
    times = np.unique(np.concatenate([at for at, _ in measured.values()]))
    q, spread = _joints_at(times, of_joints)
    still = spread <= _STILL
    if not still.any():
        finite = spread[np.isfinite(spread)]
        moved = f"; at the stillest of them a joint moved by {np.min(finite):.2g} rad or m" if len(finite) else ""
        raise DataError(
            f"{path}: the robot stood still at none of {count_noun(len(times), 'measurement')} (still: there are joint"
            f" states within {_WINDOW} s before and after, which differ by at most {_STILL:g} rad or m){moved}"
        )
    of_stop = stops(q[still])
    means = np.array([q[still][of_stop == stop].mean(axis=0) for stop in range(of_stop[-1] + 1)])
    first = min(at[0] for at, _ in in_time)
    columns: list[tuple[str, list[object]]] = [
        ("pose", [f"stop {number + 1}" for number in of_stop]),
        ("time [s]", list(times[still] - first)),
        *((name, list(means[of_stop, k])) for k, name in enumerate(joints)),
    ]
    for topic, (at, values) in measured.items():
        columns += _place_columns(topic, times[still], at, values)
    left = int(np.sum(~still))
    remark = f"{count_noun(left, 'measurement')} of {len(times)} left out: the robot moved" if left else ""
    return columns, (f"from the bag {path}", *([remark] if remark else []))


def _series(path: Path | str) -> tuple[dict[str, _Series], dict[str, _Series]]:
    """Time series of a bag: of joints by name, of places by topic."""
    joints: dict[str, _Series] = {}
    places: dict[str, _Series] = {}
    source: dict[str, str] = {}
    for topic, kind, recorded, message in _messages(path, (_JOINTS, *_PLACES)):
        if kind != _JOINTS:
            at, turned = _PLACES[kind](message)
            rotation = () if turned is None else (turned.x, turned.y, turned.z, turned.w)
            places.setdefault(topic, []).append((_stamp(message), recorded, at.x, at.y, at.z, *rotation))
            continue
        for name, value in zip(message.name, message.position, strict=False):  # some have names and no positions
            if source.setdefault(name, topic) != topic:
                raise DataError(f"{path}: joint '{name}' is in {source[name]} and in {topic}; keep one of these topics")
            joints.setdefault(name, []).append((_stamp(message), recorded, float(value)))
    for key, series in {**joints, **places}.items():
        if len({len(row) for row in series}) > 1 or not np.isfinite(series).all():
            raise DataError(f"{path}: '{key}' has numbers that are not finite, or messages of two kinds")
    return joints, places


def _stamp(message: Any) -> float:
    """Time in the header of a message [s]."""
    return float(message.header.stamp.sec + message.header.stamp.nanosec / 1e9)


def _sorted_by_time(all_series: list[_Series]) -> list[tuple[FloatArray, FloatArray]]:
    """Times (n,) [s], in order, and values (n, k) of each series: by headers, if all messages have one."""
    tables = [np.array(series, dtype=float) for series in all_series]
    clock = 0 if all(np.all(table[:, 0] > 0) for table in tables) else 1
    tables = [table[np.argsort(table[:, clock], kind="stable")] for table in tables]
    return [(table[:, clock], table[:, 2:]) for table in tables]


def messages_of_bag(path: Path | str, kinds: Sequence[str]) -> Iterator[tuple[str, str, float, Any]]:
    """Yield topic, type, time [s] and message of all messages of some types that have a header.

    The time is the one of the header, or of the recording where the header has none. `DataError` if rosbags is missing,
    or the bag cannot be read.
    """
    for topic, kind, recorded, message in _messages(path, kinds):
        stamp = _stamp(message)
        yield topic, kind, stamp if stamp > 0 else recorded, message


def joints_of_bag(path: Path | str, times: FloatArray) -> tuple[list[str], FloatArray, BoolArray]:
    """Return names of joints, their values at times (n,) [s], (n, n_joints), and whether the robot stood still, (n,).

    `DataError` if rosbags is missing, the bag cannot be read, or a joint is in two topics.
    """
    joints, _ = _series(path)
    q, spread = _joints_at(times, _sorted_by_time(list(joints.values())))
    return list(joints), q, (spread <= _STILL) & bool(joints)


def _topics(path: Path | str) -> str:
    """The topics of a bag with their types, as the end of a message."""
    with _open_bag(path) as reader:
        named = sorted({f"{connection.topic} ({connection.msgtype})" for connection in reader.connections})
    return f"; the bag has {', '.join(named)}" if named else "; the bag has no topics"


def _messages(path: Path | str, kinds: Sequence[str]) -> Iterator[tuple[str, str, float, Any]]:
    """Topic, type, time of recording [s] and message of all messages of some types."""
    with _open_bag(path) as reader:
        connections = [connection for connection in reader.connections if connection.msgtype in kinds]
        for connection, recorded, raw in reader.messages(connections) if connections else ():
            message = reader.deserialize(raw, connection.msgtype)
            yield connection.topic, connection.msgtype, recorded / 1e9, message


@contextmanager
def _open_bag(path: Path | str) -> Iterator[Any]:
    """The reader of a bag; its errors become a `DataError`."""
    missing = f"{path}: is a ROS bag, and the package that reads them is not installed: pip install rosbags"
    bags, types = (require_package(f"rosbags.{name}", missing, DataError) for name in ("highlevel", "typesys"))
    if not Path(path).exists():
        raise DataError(f"{path}: no such file; give a CSV file or a bag")
    try:
        with bags.AnyReader([Path(path)], default_typestore=types.get_typestore(types.Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except DataError:
        raise
    except Exception as error:  # rosbags and SQLite raise many kinds for a broken file
        raise DataError(f"{path}: is not a bag that can be read ({type(error).__name__}: {error})") from None


def _joints_at(times: FloatArray, joints: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Joint values at times (n,), (n, n_joints), and the largest motion of any joint, (n,); inf if not recorded."""
    q, spread = np.full((len(times), len(joints)), np.nan), np.zeros(len(times))
    for j, (at, values) in enumerate(joints):
        first = np.searchsorted(at, times - _WINDOW, side="left")
        last = np.searchsorted(at, times + _WINDOW, side="right")
        middle = np.searchsorted(at, times, side="left")
        for k in range(len(times)):
            inside = values[first[k] : last[k], 0]
            if first[k] < middle[k] < last[k]:
                q[k, j] = inside.mean()
                spread[k] = max(spread[k], float(np.ptp(inside)))
            else:
                spread[k] = np.inf
    return q, spread


def stops(q: FloatArray) -> IntArray:
    """Return the number of the stop of each row (n, n_joints), (n,); a new stop begins where a joint has moved."""
    numbers, begin = np.zeros(len(q), dtype=np.intp), q[0]
    for k, row in enumerate(q):
        left = bool(np.any(np.abs(row - begin) > 2 * _STILL))
        begin = row if left else begin
        numbers[k] = numbers[max(k - 1, 0)] + left
    return numbers


def _place_columns(topic: str, times: FloatArray, at: FloatArray, values: FloatArray) -> list[tuple[str, list[object]]]:
    """Columns of one topic; cells are empty at times without a message of the topic."""
    name, row = topic.removeprefix("/"), dict(zip(at, values, strict=True))
    axes = ("x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw")[: values.shape[1]]
    return [(f"{name}_{axis}", [row[t][k] if t in row else "" for t in times]) for k, axis in enumerate(axes)]

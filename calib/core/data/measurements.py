"""Measurements: the visits of a robot to its poses, and the readings of each instrument there.

A visit is one row: joint values, and what else is known of that moment (context). Rows with one pose name repeat that
pose; nothing is averaged. At a visit, an instrument may have read nothing, and several may have read something.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NoReturn, Self

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import DataError, InputError
from calib.core.base.other_words import HintedObject
from calib.core.base.units import DISPLAY_UNIT, Dimension, quantity_text
from calib.core.base.words import html_with_title, pandas
from calib.core.data.measurement_columns import approach_columns, condition_columns, pose_columns, reading_columns
from calib.core.data.pose_groups import shuffled_poses
from calib.core.instruments.kind import FrameInstrument, Instrument, Readings
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context

_JOINTS_AGREE: dict[Dimension, float] = {"length": 1e-3, "angle": 2e-3}
"""Largest spread of a joint among repeats of one pose [m, rad]; more means that they are different poses."""
_MOVED = 1e-4  # change of a joint between two rows that counts as motion [m, rad]


@dataclass(frozen=True, eq=False, repr=False)
class Poses(ReadOnlyArrays, HintedObject):
    """Joint values of a list of visits.

    Attributes:
        joints: Actuated joints in the robot's order, (n, n_actuated) [m or rad].
        labels: Name of each in messages: file, line and pose name.
        names: The pose names of the file, or their running number; rows of one name repeat one pose.
        path: Their file.
        ignored: Columns of the file that were not used.
        comments: Comments of the file, line by line.
        context: Conditions of each visit, (n,) [SI], by their names in `CONTEXT`; NaN where not known.
        approach: Direction in which each joint moved last before the visit, +1 or -1, 0 where not known,
            (n, n_actuated); None: not given.
        setups: Number of the setup of each visit, as the description counts them, (n,); None: the first.
        planned: Readings that a plan asks for, without values, by instrument. It says nothing of instruments that are
            not named.
        robot: The robot for which the poses were read or made, as it was then; None if not stated.
    """

    _other_words = "measurements and poses"

    joints: FloatArray
    labels: tuple[str, ...]
    names: tuple[str, ...]
    path: str
    ignored: tuple[str, ...]
    comments: tuple[str, ...] = field(default=(), kw_only=True)
    context: Mapping[str, FloatArray] = field(default_factory=dict, kw_only=True)
    approach: FloatArray | None = field(default=None, kw_only=True)
    setups: IntArray | None = field(default=None, kw_only=True)
    planned: Mapping[str, Readings] = field(default_factory=dict, kw_only=True)
    robot: Robot | None = field(default=None, kw_only=True)

    def __len__(self) -> int:
        return len(self.joints)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} from {self.path}: {len(self)} rows, {self.n_poses} poses>"

    def _repr_html_(self) -> str:
        return html_with_title(type(self).__name__, (repr(self)[1:-1], *self.comments), *self._tables())

    def _tables(self) -> tuple[list[dict[str, object]], ...]:
        """Tables that a notebook shows of the measurements."""
        return ()

    def __getitem__(self, which: slice | BoolArray | IntArray | Sequence[int] | int) -> Self:
        """Return some of the visits: a slice, a mask (n,), or indices, as of an array; others are a `DataError`."""
        if isinstance(which, str):
            raise InputError(
                f"{self.path}: brackets take numbers of rows; for a column, write data.to_dataframe()['{which}']"
            )
        try:
            return self.subset(np.atleast_1d(np.arange(len(self))[which]))
        except IndexError as error:
            raise DataError(f"{self.path}: {error}; it has {len(self)} rows") from None

    def __add__(self, other: object) -> NoReturn:
        raise InputError(f"{self.path}: join measurements in a list: calib.fit(robot, [first, 'b.csv'])")

    def __array__(self, *_: object, **__: object) -> NoReturn:
        raise InputError(f"{self.path}: {type(self).__name__} are not an array; give .joints, the joint values alone")

    def __iter__(self) -> Iterator[Self]:
        return (self[k] for k in range(len(self)))

    def _robot(self, robot: Robot | None) -> Robot:
        """The given robot, or else the robot of these poses."""
        known = self.robot if robot is None else robot
        if known is None:
            raise InputError(f"{self.path}: does not have its robot; give the robot as an argument")
        return known

    def to_dict(self, robot: Robot | None = None) -> dict[str, list[object]]:
        """Return a table of the visits, in mm and degrees: the cells below each header, as in files.

        The robot, that of the visits if not given, names joints and instruments.
        """
        robot = self._robot(robot)
        conditions = condition_columns(robot, len(self), self.setups, self.context)
        return pose_columns(robot, self.names, self.joints) | conditions | approach_columns(robot, self.approach)

    def to_dataframe(self, robot: Robot | None = None) -> Any:
        """Return `to_dict` as a pandas table, empty cells as NaN; pandas missing is an `InputError`."""
        columns = self.to_dict(robot)
        return pandas().DataFrame({key: [np.nan if x == "" else x for x in cells] for key, cells in columns.items()})

    def subset(self, index: IntArray) -> Self:
        """Return the visits with these indices (n,), in this order."""
        index = np.asarray(index, dtype=np.intp)
        return replace(
            self,
            joints=self.joints[index],
            labels=tuple([self.labels[k] for k in index]),
            names=tuple([self.names[k] for k in index]),
            context={key: values[index] for key, values in self.context.items()},
            approach=None if self.approach is None else self.approach[index],
            setups=None if self.setups is None else self.setups[index],
            planned={name: readings_of_visits(looks, index) for name, looks in self.planned.items()},
        )

    @cached_property
    def pose_numbers(self) -> IntArray:
        """A number for each visit, the same for those of one pose name, counted as they first appear, (n,)."""
        numbers: dict[str, int] = {}
        return np.array([numbers.setdefault(name, len(numbers)) for name in self.names], dtype=np.intp)

    @property
    def n_poses(self) -> int:
        """Number of different poses."""
        return int(self.pose_numbers.max(initial=-1)) + 1

    @cached_property
    def conditions(self) -> Context:
        """Conditions of the commands, for joint terms; with the direction of approach, if it is given."""
        approach = np.zeros_like(self.joints) if self.approach is None else self.approach
        return Context.from_conditions(approach, self.context, self.setups)


@dataclass(frozen=True, eq=False, repr=False)
class Measurements(Poses):
    """Visits with their readings.

    Attributes:
        readings: Readings of each instrument that read something, by its name; visits are indices into the rows.
        approach_assumed: Whether `approach` was taken from the order of the rows of a larger file.
        order: Place of each visit in the order of measurement, from 0, (n,). If not given: the order of the rows.
    """

    readings: Mapping[str, Readings]
    order: IntArray | None = None
    approach_assumed: bool = False

    def __post_init__(self) -> None:
        kept = {name: own for name, own in self.readings.items() if len(own) or not own.values.shape[1]}
        vars(self)["readings"] = kept  # planned readings have no numbers yet
        super().__post_init__()

    @property
    def n_readings(self) -> int:
        """Number of readings of all instruments."""
        return sum(len(readings) for readings in self.readings.values())

    @property
    def approach_directions(self) -> FloatArray:
        """`approach`, from the order of the rows where it is not given, (n, n_actuated)."""
        return directions_of_motion(self.joints) if self.approach is None else self.approach

    @property
    def states_approach(self) -> bool:
        """Whether the direction of approach is stated, and not assumed from the order of the rows."""
        return self.approach is not None and not self.approach_assumed

    @cached_property
    def conditions(self) -> Context:
        """Conditions of the commands, for joint terms; with the direction of approach."""
        return Context.from_conditions(self.approach_directions, self.context, self.setups)

    @property
    def places(self) -> IntArray:
        """`order`, or the order of the rows, (n,)."""
        return np.arange(len(self)) if self.order is None else self.order

    def _tables(self) -> tuple[list[dict[str, object]], ...]:
        return ([{"instrument": name, "readings": len(readings)} for name, readings in self.readings.items()],)

    def to_dict(self, robot: Robot | None = None) -> dict[str, list[object]]:
        """Return a table of the readings, in mm and degrees: the cells below each header, as in files.

        The robot, that of the visits if not given, names joints and instruments. `DataError` for simulated readings of
        an instrument that reads no numbers.
        """
        robot = self._robot(robot)
        visits, read = reading_columns(robot, len(self), self.readings)
        return {key: [cells[k] for k in visits] for key, cells in super().to_dict(robot).items()} | read

    def subset(self, index: IntArray) -> Self:
        """Return the visits with these indices (n,), in this order, with their readings."""
        index = np.asarray(index, dtype=np.intp)
        return replace(
            super().subset(index),
            order=self.places[index],
            approach=self.approach_directions[index],
            approach_assumed=not self.states_approach,
            readings={name: readings_of_visits(readings, index) for name, readings in self.readings.items()},
        )

    def read_visits(self) -> Self:
        """Return the visits at which something was read; at others, a camera may have seen nothing."""
        read = np.zeros(len(self), dtype=bool)
        for readings in self.readings.values():
            read[readings.visits] = True
        return self.subset(np.flatnonzero(read)) if np.any(read) and not np.all(read) else self

    def with_readings(self, numbers: Mapping[str, IntArray]) -> Self:
        """Return some readings of each instrument, by indices (n,), and their visits; others get none."""
        chosen = {name: self.readings[name].subset(own) for name, own in numbers.items()}
        visits = np.unique(np.concatenate([readings.visits for readings in chosen.values()]))
        return replace(self, readings=chosen).subset(visits)

    def split(self, *, validation: float, seed: int = 0) -> tuple[Measurements, Measurements]:
        """Hold out a random part of the poses for validation; repeats of one pose stay together.

        Args:
            validation: Part of the poses to hold out, between 0 and 1.

        Returns:
            Measurements to identify with, and to validate with, both in file order.

        Raises:
            DataError: No visit is left for one of the two.
        """
        n_held = round(validation * len(self)) if 0 < validation < 1 else 0
        chosen: list[int] = []
        for group in shuffled_poses(self.joints, self.pose_numbers, seed):
            if len(chosen) >= n_held:
                break
            chosen.extend(int(k) for k in group)
        held = np.array(chosen, dtype=np.intp)
        if not 0 < len(held) < len(self):
            raise DataError(
                f"{self.path}: with {validation:g} of {len(self)} poses held out, no pose is left to"
                f" {'fit' if len(held) or validation >= 1 else 'validate with'}; give a fraction between 0 and 1,"
                " or a file"
            )
        return self.subset(np.setdiff1d(np.arange(len(self)), held)), self.subset(np.sort(held))

    def points(self, robot: Robot | None = None) -> FloatArray:
        """Return where each target was seen in the measurement frame, (n, n_targets, 3) [m]; NaN where it was not.

        Only instruments that measure points count; several readings of a target at a visit give their mean. The robot,
        that of the visits if not given, names targets and instruments.
        """
        robot = self._robot(robot)
        names = robot.target_names
        total, count = np.zeros((len(self), len(names), 3)), np.zeros((len(self), len(names), 1))
        for instrument in robot.instruments:
            readings = self.readings.get(instrument.name)
            points = None if readings is None else instrument.points(readings.values)
            if readings is None or points is None or not isinstance(instrument, FrameInstrument):
                continue
            t = names.index(instrument.target)
            np.add.at(total[:, t], readings.visits, points)
            np.add.at(count[:, t], readings.visits, 1.0)
        with np.errstate(invalid="ignore"):
            result: FloatArray = total / count
        return result


def measurements(poses: Poses, readings: Mapping[str, Readings]) -> Measurements:
    """Put poses and readings together."""
    of_poses = {field.name: getattr(poses, field.name) for field in fields(Poses)}
    assumed = isinstance(poses, Measurements) and poses.approach_assumed
    return Measurements(**of_poses, readings=readings, approach_assumed=assumed)


def with_points(robot: Robot, data: Measurements, points: FloatArray) -> Measurements:
    """Return measurements with other measured points of each visit and target, (n, n_targets, 3) [m]."""
    moved = dict(data.readings)
    for name, readings in data.readings.items():
        instrument = robot.instrument(name)
        measured = instrument.points(readings.values)
        if measured is not None and isinstance(instrument, FrameInstrument):
            change = np.zeros((len(readings), instrument.n_rows))
            change[:, :3] = points[readings.visits, robot.target_names.index(instrument.target)] - measured
            moved[name] = replace(readings, values=instrument.with_errors(readings.values, change))
    return replace(data, readings=moved)


def readings_of_visits(readings: Readings, index: IntArray) -> Readings:
    """Return the readings of the visits with these indices (n,), in this order; a visit may come twice."""
    order = np.argsort(readings.visits, kind="stable")
    first, last = (np.searchsorted(readings.visits[order], index, side=side) for side in ("left", "right"))
    counts = last - first
    kept = order[np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(int(counts.sum()))]
    return readings.subset(kept, np.repeat(np.arange(len(index)), counts))


def setup_pairs(robot: Robot, instrument: Instrument, setups: IntArray) -> IntArray:
    """Return the number to add to the pair numbers of an instrument at each visit (n,), for its setup (n,)."""
    return setups * (len(robot.pairs[instrument.name]) // max(1, len(robot.description.setups)))


def states_by_order(robot: Robot, joints: FloatArray) -> dict[str, FloatArray]:
    """Return the states of joint terms by column, (n,) each, computed from the order of commands (n, n_actuated)."""
    commands = dict(zip(robot.joint_names, joints.T, strict=True))  # no one commands passive joints
    states = [term.states_by_order(commands[term.joint]) for term in robot.terms if term.joint in commands]
    return {column: values for own in states for column, values in own.items()}


def directions_of_motion(joints: FloatArray) -> FloatArray:
    """Return the direction in which each joint moved last before each pose: +1, -1, or 0 before its first motion.

    A joint that stands still keeps its direction: that is what backlash depends on. Joint values are in the order of
    measurement, (n_poses, n_actuated) [m or rad].
    """
    steps = np.diff(joints, axis=0, prepend=joints[:1])
    direction = np.where(np.abs(steps) > _MOVED, np.sign(steps), 0.0)
    rows = np.where(direction != 0, np.arange(len(joints))[:, None], 0)
    last_moved = np.maximum.accumulate(rows, axis=0)
    return np.take_along_axis(direction, last_moved, axis=0)


def check_repeats(poses: Poses, robot: Robot) -> None:
    """Raise `DataError` where rows of one pose name have different joint values."""
    limits = np.array([_JOINTS_AGREE[robot.mechanism.dimensions[joint]] for joint in robot.joint_names])
    order = np.argsort(poses.pose_numbers, kind="stable")
    starts = np.flatnonzero(np.diff(poses.pose_numbers[order], prepend=-1))
    spread = np.maximum.reduceat(poses.joints[order], starts) - np.minimum.reduceat(poses.joints[order], starts)
    bad = np.argwhere(spread > limits)
    if len(bad):
        pose = int(bad[0][0])
        joint = int(np.argmax(spread[pose] / limits))
        row = int(order[starts[pose]])
        dimension = robot.mechanism.dimensions[robot.joint_names[joint]]
        raise DataError(
            f"{poses.labels[row]}: joint '{robot.joint_names[joint]}' differs by"
            f" {quantity_text(spread[pose, joint], DISPLAY_UNIT[dimension])} among the rows of pose"
            f" '{poses.names[row]}'; rows with the same pose value must repeat one pose"
        )

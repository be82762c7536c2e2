"""Likely mistakes in measurements without positions: each usual mistake is undone, and the nominal robot compared.

Tried are joints that count the other way; columns of two joints, or of two instruments of one kind, that were swapped;
joint values up to five rows above or below their measurements, mapped to a range such as -100 to 100, or in another
unit; and the other meanings that a kind knows of its numbers. The misfit of a trial is the error of the nominal robot
after `register`, over its error with each joint at its value in some row: a robot that hardly moves explains nothing.
The part of the readings that fits worst must come much nearer than with the data unchanged, and none get worse. Trials
with the smallest misfits of all parts are named.

When it fails. Two mistakes at once are not found, nor those that `register` hides: an unknown sensor on the last joint
hides the sign of that joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from calib.core.base.arrays import evenly_spread
from calib.core.base.errors import CalibrationError
from calib.core.data.measurements import Measurements
from calib.core.fitting.column_maps import USUAL_FACTORS, ColumnMap
from calib.core.instruments.kind import Part
from calib.core.robots.robot import Robot
from calib.core.rows.observed import observe
from calib.core.rows.registration import register

_Errors = dict[tuple[str, Part], float]  # of each instrument and part

_CLOSER = 0.2  # with the mistake undone, the misfit is less than this part of what it was
_AS_GOOD = 1.5  # another mistake explains the data as well if its misfit is at most this many times the least
_FITS = 0.05  # readings with a smaller misfit fit
_LEFT = 0.75  # part of the rows that a trial must keep: few rows fit by chance
_NONE = 1e-6  # smallest misfit: exact readings have none
_FEWEST = 4  # fewer readings may fit by chance
_ENOUGH = 20  # rows with jumbled joints, so that few rows do not stay as they are
_NAMED = 3  # mistakes in a message


def jumbled_errors(robot: Robot, data: Measurements) -> _Errors:
    """Return root mean square errors [SI] with each joint at its value in some row.

    Poses that do not close are left out; nothing is returned where a pose cannot be assembled.
    """
    data = data.subset(np.tile(np.arange(len(data)), -(-_ENOUGH // len(data))))  # few rows may stay as they are
    data = replace(data, joints=np.random.default_rng(0).permuted(data.joints, axis=0))
    if robot.mechanism.loops:
        data = data.subset(np.flatnonzero(robot.close(data.joints, thorough=False).ok))
    return errors_of_parts(robot, data)


def errors_of_parts(robot: Robot, data: Measurements) -> _Errors:
    """Return root mean square errors [SI]; nothing where a pose cannot be assembled."""
    try:
        at = robot.assemble(data.joints, context=data.conditions)
        observed = observe(robot, at, data.readings, derivatives=False)
    except CalibrationError:
        return {}
    errors = {}
    for name, item in observed.items():
        instrument = robot.instrument(name)
        for k, part in enumerate(instrument.parts):
            rows = item.residuals[:, [row_part == k for row_part in instrument.part_of_row]]
            if np.isfinite(rows).any():
                errors[name, part] = float(np.sqrt(np.nanmean(rows**2)))
    return errors


def mistaken_readings(robot: Robot, data: Measurements, name: str = "") -> str:
    """Return the mistake that explains the measurements, in words; empty where none does.

    Args:
        name: An instrument, if only its numbers can be wrong.
    """
    some = some_visits(data)
    now, tried = _misfits(robot, some), []
    worst = max((part for part in now if name in ("", part[0])), key=lambda part: now[part])
    for trial in _meaning_trials(robot, some, name) if name else _trials(robot, data):
        if len(trial.data) < _LEFT * len(some) or not (name or _explains(robot, trial.data, worst, now[worst])):
            continue
        misfits = now | _misfits(robot, trial.data)
        closer = misfits[worst] / now[worst]
        worse = any(misfits[part] > max(_AS_GOOD * misfit, _FITS) for part, misfit in now.items())
        if closer < _CLOSER and not worse:
            tried.append((float(np.linalg.norm(list(misfits.values()))), closer, trial.words))
    if not tried:
        return ""
    least, closer, _ = min(tried)
    likely = ", or ".join([words for left, _, words in sorted(tried) if left <= _AS_GOOD * least][:_NAMED])
    return f"probable mistake: {likely}. Corrected, the nominal robot fits {1 / closer:.0f} times better"


def _explains(robot: Robot, data: Measurements, part: tuple[str, Part], now: float) -> bool:
    """Whether the readings of one instrument come much nearer, placed alone: a quick look."""
    name = part[0]
    if name not in data.readings:
        return False
    return (
        len(data.readings) == 1
        or _misfits(robot, replace(data, readings={name: data.readings[name]}))[part] < _CLOSER * now
    )


def _misfits(robot: Robot, data: Measurements) -> _Errors:
    """Errors of the nominal robot, over those with jumbled joints; 1 where it cannot be placed."""
    nowhere = {(name, part): 1.0 for name in data.readings for part in robot.instrument(name).parts}
    try:
        placed = register(robot, data)
    except CalibrationError:
        return nowhere
    jumbled = jumbled_errors(placed, data)
    now = errors_of_parts(placed, data)
    return nowhere | {part: max(error / jumbled[part], _NONE) for part, error in now.items() if jumbled.get(part)}


def _trials(robot: Robot, measured: Measurements) -> Iterator[Trial]:
    data, n = some_visits(measured), len(robot.joint_names)
    plain = ColumnMap.plain(n)
    signs = (plain.with_factor(j, -1.0) for j in range(n))
    swaps = (plain.with_columns((a, b), (b, a)) for a, b in combinations(range(n), 2))
    for at in (*signs, *swaps):
        yield Trial(at.words(robot), replace(data, joints=at.joints(data.joints)))
    yield from joint_value_trials(robot, measured)
    for name in data.readings:
        yield from _meaning_trials(robot, replace(data, readings={name: data.readings[name]}), name)
    for names in _alike(robot, data):
        for meanings in zip(*(_meaning_trials(robot, data, name) for name in names), strict=True):
            changed = {name: each.data.readings[name] for name, each in zip(names, meanings, strict=True)}
            yield Trial(" and ".join(each.words for each in meanings), replace(data, readings=changed))
        for a, b in combinations(names, 2):
            changed = {a: data.readings[b], b: data.readings[a]}
            yield Trial(f"the columns of {a} and {b} were swapped", replace(data, readings=changed))


def _meaning_trials(robot: Robot, data: Measurements, name: str) -> Iterator[Trial]:
    """The other meanings of an instrument's numbers; incomplete readings are left out."""
    readings = data.readings[name]
    whole = readings.subset(np.flatnonzero(np.isfinite(readings.values).all(axis=1)))
    for words, values in robot.instrument(name).other_meanings(whole.values) if len(whole) >= _FEWEST else ():
        yield Trial(words, replace(data, readings={**data.readings, name: replace(whole, values=values)}))


def _alike(robot: Robot, data: Measurements) -> list[list[str]]:
    """Names of instruments of one kind, two or more, that read a single thing each."""
    kinds: dict[type, list[str]] = {}
    for instrument in (robot.instrument(name) for name in data.readings):
        if instrument.columns() and not instrument.text_columns():
            kinds.setdefault(type(instrument), []).append(instrument.name)
    return [names for names in kinds.values() if len(names) > 1]


_POSES = 20  # poses that suffice to show a gross mistake
_SHIFTS = 5
_FEW = 3  # a shift must leave more rows
_RANGES = ((-100, 100), (0, 100), (-1, 1), (0, 1), (0, 1023), (0, 4095), (0, 65535))


@dataclass(frozen=True, eq=False)
class Trial:
    """A mistake that is undone.

    Attributes:
        data: Some of the measurements without it.
        changes: Number of changes of joints; 0 for a single mistake.
        column_map: The map of columns that undoes it.
    """

    words: str
    data: Measurements
    changes: int = 0
    column_map: ColumnMap | None = None


def some_visits(data: Measurements) -> Measurements:
    """Return visits that suffice to show a gross mistake, evenly spread."""
    return data.subset(evenly_spread(len(data), _POSES))


def joint_value_trials(robot: Robot, measured: Measurements) -> Iterator[Trial]:
    """Yield each mistake in all joint values, undone in some of the measurements."""
    yield from _shifted_trials(measured)
    yield from _rescaled_trials(robot, measured)
    data = some_visits(measured)
    for dimension, factors in USUAL_FACTORS.items():
        own = np.array([robot.mechanism.dimensions[name] == dimension for name in robot.joint_names])
        for factor, words in factors.items() if np.any(own) else ():
            yield Trial(f"joint values were {words}", replace(data, joints=np.where(own, factor, 1.0) * data.joints))


def _shifted_trials(measured: Measurements) -> Iterator[Trial]:
    places = measured.places
    for rows, sign in product(range(1, _SHIFTS + 1), (1, -1)):
        _, of_joints, of_points = np.intersect1d(places + sign * rows, places, return_indices=True)
        if len(of_joints) > _FEW:
            joints = measured.joints[of_joints]
            side = f"{'one row' if rows == 1 else f'{rows} rows'} {'above' if sign > 0 else 'below'}"
            shifted = replace(measured.subset(of_points), joints=joints)
            yield Trial(f"all joint values are {side} their measurements", some_visits(shifted))


def _rescaled_trials(robot: Robot, measured: Measurements) -> Iterator[Trial]:
    """Joint values mapped back from ranges such as 0 to 1 to the joints' limits; the file may have meant any unit."""
    lower, upper = robot.urdf.limits(robot.joint_names)
    if not np.all(np.isfinite(upper - lower)):
        return
    angles = robot.mechanism.turning
    si = measured.joints
    for numbers, (low, high) in product((np.where(angles, np.degrees(si), 1e3 * si), si), _RANGES):
        reach = high - low
        if np.all((numbers > low - 0.1 * reach) & (numbers < high + 0.1 * reach)):
            whole = replace(measured, joints=lower + (numbers - low) / reach * (upper - lower))
            words = f"all joint values were mapped from the joints' limits to the range {low} to {high}"
            yield Trial(words, some_visits(whole))

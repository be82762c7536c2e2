"""Likely mistakes in measurements that no robot fits.

Each usual mistake is undone in turn, and the nominal robot compared:
columns of joint values in another order; joints counted the other way, from a zero that is a quarter or half of a turn
off, or on another scale, several at once (`calib.core.fitting.column_maps`); values mapped to a range such as -100 to
100; joint values up to five rows above or below their measurements; degrees read as radians or radians read as degrees;
positions in another unit, which their size shows; axes of the measurement frame mirrored, or in another order. Readings
of exactly 0, 0, 0 are left out before, and named with the rest. A rigid fit places unknown base and targets. A mistake
is named if undoing it brings the nominal robot much closer to the data, and to within a part of their spread; for
scales, which a fit finds, a fit with them must do so. Columns that are copies of each other are named without a trial.

When it fails. Mistakes of two kinds at once are not found. A robot with a wrong base or tool that the description calls
known is always far off; the verdict looks for that first. Only instruments that measure points are examined here.
Without any, see `photographed_points` for images, else `calib.core.fitting.mistaken_readings`.

Scales. A controller may count in gon, a range may be mapped, or a gear ratio may be wrong. Then the file has x, and the
joint is at q = g x + b. The nominal robot is fitted with a gain of each joint that moved and its own parameters, which
absorb b. A factor is reported if it differs from one by more than one percent and by more than its uncertainty allows.
If a joint is scaled by two, the fit may not converge from the values of the file.

Photographs. Each gives the board's pose in the camera, whatever the joints are. So a robot with a camera is like a
robot whose target, the board's origin, is measured in a frame of unknown place on the link that carries the camera. A
sensor that reads positions of a point itself is like that, too. The depth of a small board is uncertain, and its pose
may be one of two that look alike. Such positions show signs, quarter turns and orders, but do not calibrate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import CalibrationError
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.data.in_memory import plain_readings
from calib.core.data.measurements import Measurements, with_points
from calib.core.data.tables import read_table
from calib.core.fitting.column_maps import ColumnMap, likely_maps
from calib.core.fitting.fit import fit_data
from calib.core.fitting.mistaken_readings import Trial, joint_value_trials, mistaken_readings, some_visits
from calib.core.fitting.pose_checks import uncounted_turns, unmoved_joints
from calib.core.fitting.settings import Settings
from calib.core.instruments.camera import rays, view_poses
from calib.core.instruments.pixel import Pixel
from calib.core.instruments.relation import Relation
from calib.core.robots.description import BaseSection, TargetSection
from calib.core.robots.loading import build
from calib.core.robots.robot import Robot
from calib.core.robots.terms.one_coefficient import Gain
from calib.core.rows.registration import register

LARGE_NOISE = 0.1
"""Nothing fits if the noise is more than this part of the spread of the measured positions."""
_CLOSER = 0.2  # with the mistake undone, the nominal robot misses by less than this part of what it missed before
_HALF = 0.5  # a fit with other scales of joints leaves less than this part of the noise
_AS_GOOD = 1.5  # another mistake explains the data as well if it misses by at most this many times the best miss
_GLANCE = 4  # step through these poses for a first look: do the loops close at all?
_FEW = 3  # rows that may agree by chance
_NO_SIZE = 1e-6  # if reach over measured space is below this, the described target is on a link that does not move
_ANOTHER_UNIT = 0.1  # change of all lengths that is more than a robot's own errors
_READ = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_WRITTEN = dict(_READ, inches=0.0254, feet=0.3048, cm=1e-2) | {"tenths of an inch": 2.54e-3}
"""Units in which the program reads positions, and units in which a file may have them [m]."""
SCALED = 0.01
"""Relative error of a scale that no gear, belt or screw has."""
SURE = 6.0
"""A gain of more standard deviations is not chance."""
_EXPECTED = 0.3  # sigma of the gains


@one_blas_thread
def likely_mistake(robot: Robot, data: Measurements, noise: float = np.inf, *, gross: bool = True) -> str:
    """Return the mistake that explains the measurements, in words; empty where none does.

    Args:
        noise: Noise of a fit to them, per axis [m]; infinite without a fit.
        gross: Whether all mistakes are examined, since nothing fits; else only the scales of joints.
    """
    copied = equal_columns(data, robot)
    if copied:
        return f"probable mistake: column {copied[0][1]} is a copy of {copied[0][0]}; they are equal in every row"
    photographed = photographed_points(robot, data)
    if photographed is not None:
        (robot, data), noise = photographed, np.inf
    elif gross and not any(robot.instrument(name).reads_positions for name in data.readings):
        return mistaken_readings(robot, data)
    data = data.subset(np.flatnonzero(np.isfinite(data.points(robot)).all(axis=(1, 2))))
    zeros = zero_visits(data, robot)
    sound = data.subset(np.setdiff1d(np.arange(len(data)), zeros))
    if len(sound) <= _FEW:
        return ""
    mistake, nearest = _nominal_fits(robot, data, sound, zeros) if gross else ("", None)
    if mistake or not np.isfinite(noise):
        return mistake
    tried = [joint_scales(robot, sound, at) for at in ((None, nearest) if nearest else (None,))]
    scales = min((known for known in tried if known is not None), key=lambda known: known.noise, default=None)
    spread = float(np.sqrt(np.mean(np.var(sound.points(robot), axis=0))))
    if scales is None or not scales.map.is_scaled or scales.noise > min(_HALF * noise, LARGE_NOISE * spread):
        return ""
    left = f"a fit leaves {quantity_text(scales.noise, 'mm')} per axis in place of {quantity_text(noise, 'mm')}"
    return f"probable mistake: {scales.map.words(robot, scales.std)}. Corrected, {left}"


def _nominal_fits(
    robot: Robot, data: Measurements, sound: Measurements, zeros: IntArray
) -> tuple[str, ColumnMap | None]:
    """The mistake without which the nominal robot fits; if there is none, the scales with which it comes nearest."""
    now = min(_misses(robot, [some_visits(data) if len(zeros) == 0 else data])[0], 1.0)  # at most the spread
    where = listing([data.labels[k] for k in zeros])
    empty = f"{count_noun(len(zeros), 'reading')} of exactly 0, 0, 0 ({where}) were empty"
    trials = [Trial(empty, some_visits(sound))] if len(zeros) else []
    misses = _misses(robot, [trial.data for trial in trials])
    prefix = f"{empty}, and " if len(zeros) else ""
    if not trials or misses[0] > _CLOSER * now:
        undone = list(_undone(robot, sound))
        misses += _misses(robot, [trial.data for trial in undone], _AS_GOOD * _CLOSER * now)
        trials += [replace(trial, words=prefix + trial.words) for trial in undone]
    best = max(min(misses), 1e-6)
    if not best < _CLOSER * now:
        scaled = [
            (miss, trial.column_map)
            for miss, trial in zip(misses, trials, strict=True)
            if trial.column_map and trial.column_map.is_scaled
        ]
        return "", min(scaled, key=lambda entry: entry[0], default=(0.0, None))[1]
    good = [trials[k] for k in np.argsort(misses) if misses[k] <= _AS_GOOD * best]
    fewest = min((trial.changes for trial in good if trial.changes), default=0)
    likely = [trial for trial in good if trial.changes in (0, fewest)]
    first, words = likely[0].column_map, [trial.words for trial in likely]
    if first is not None and first.is_scaled:
        scales = joint_scales(robot, sound, first)
        if scales is not None and not scales.map.words(robot):  # nothing is scaled: only some poses did not close
            return "", None
        if scales is not None:
            first, words = scales.map, [prefix + scales.map.words(robot, scales.std)]
        words = words[:1]
    sentence = (
        f"probable mistake: {', or '.join(words[:3])}. Corrected, the nominal robot fits {now / best:.0f} times better"
    )
    if len(words) == 1 and first is not None and not first.still_joints(robot):
        sentence += f". In the description: {first.description_line(robot, _file_units(data))}"
    return sentence, None


def _file_units(data: Measurements) -> dict[str, str | None]:
    try:
        table = read_table(data.path)
    except CalibrationError:
        return {}
    return dict(zip(table.names, table.units, strict=True))


def _misses(robot: Robot, changed: list[Measurements], most: float = np.inf) -> list[float]:
    """Root mean square errors of the nominal robot over the spread of the positions; all loops are closed at once.

    A result above `most` is only a lower bound.
    """
    result = np.full(len(changed), np.inf)
    some = _closed_poses(robot, [data.joints[::_GLANCE] for data in changed])
    left = [k for k, (ok, _) in enumerate(some) if _closes(ok)]
    for k, (ok, passive) in zip(left, _closed_poses(robot, [changed[k].joints for k in left]), strict=True):
        result[k] = _miss_of(robot, changed[k], ok, passive, most)
    return [float(miss) for miss in result]


def _closed_poses(robot: Robot, joints: list[FloatArray]) -> list[tuple[BoolArray, FloatArray]]:
    """Mask of the poses of each list that close, and their passive joints."""
    if not joints:
        return []
    closed = robot.close(np.vstack(joints), thorough=False)
    starts = np.cumsum([len(q) for q in joints])[:-1]
    return list(zip(np.split(closed.ok, starts), np.split(closed.passive, starts), strict=True))


def _closes(ok: BoolArray) -> bool:
    """Whether enough poses close to look for paths to the others."""
    return bool(2 * np.sum(ok) >= len(ok))


def _miss_of(robot: Robot, data: Measurements, ok: BoolArray, passive: FloatArray, most: float) -> float:
    """Error of the robot, with unknown places determined, from the mask of closed poses and their passive joints."""
    if not _closes(ok):
        return float("inf")
    points = data.points(robot)
    spread = np.sum((points - points.mean(axis=0)) ** 2)
    # setups are placed one after the other: the error of one of them says nothing about all
    rough_beyond = np.inf if robot.description.setups else most * np.sqrt(3 * spread / points.size)
    try:
        placed = robot
        if any(p.placement for p in robot.parameters):
            placed = register(robot, data, rough_beyond=rough_beyond)
        errors = placed.positions(data.joints, seed=passive) - points
    except CalibrationError:  # a loop stays open, or nothing can be placed
        return float("inf")
    return float(np.sqrt(np.sum(errors**2) / spread)) if spread > 0 else float("inf")


def _undone(robot: Robot, measured: Measurements) -> Iterator[Trial]:
    data = some_visits(measured)
    q, points = data.joints, data.points(robot)
    for at in likely_maps(robot, data):
        yield Trial(at.words(robot), replace(data, joints=at.joints(q)), at.changes, at)
    yield from joint_value_trials(robot, measured)
    yield from ((Trial(words, with_points(robot, data, size * points))) for words, size in _units(robot, data))
    for order, sign in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        words = _axes_in_words(order, sign)
        if robot.description.base.pose == "unknown":  # all reflections of an unknown frame are equal
            if order != (0, 1, 2) or sign != (1.0, 1.0, -1.0):
                continue
            words = "the measurement frame is left-handed (an axis with the wrong sign, or two axes swapped)"
        if words:
            yield Trial(words, with_points(robot, data, points[..., list(order)] * sign))


def _units(robot: Robot, data: Measurements) -> Iterator[tuple[str, float]]:
    """The units that fit the size of the measured positions, and the factor that corrects lengths."""
    closed = robot.close(data.joints, thorough=False)
    if not _closes(closed.ok):
        return
    reached = robot.positions(data.joints[closed.ok], seed=closed.passive[closed.ok])
    measured = data.points(robot)[closed.ok]
    size = float(np.sqrt(np.sum(np.var(reached, axis=0)) / max(np.sum(np.var(measured, axis=0)), 1e-300)))
    if size < _NO_SIZE or abs(np.log(size)) < _ANOTHER_UNIT:
        return
    ratios: dict[float, str] = {}
    for (read, of_read), (written, of_written) in product(_READ.items(), _WRITTEN.items()):
        ratio = float(f"{of_written / of_read:.6g}")  # equal quotients of units get equal keys
        if abs(np.log(ratio / size)) < _ANOTHER_UNIT:
            ratios.setdefault(ratio, f"positions in {written} were read as {read}")
    yield from ((words, ratio) for ratio, words in ratios.items())
    if not ratios:
        times = f"{1 / size:.3g} times as long as the robot's, which no usual unit explains"
        yield f"measured lengths were {times}", size


def _axes_in_words(order: tuple[int, ...], sign: tuple[float, ...]) -> str:
    columns = ["xyz"[k] for k in order]
    moved = [axis for axis, column in zip("xyz", columns, strict=True) if axis != column]
    turned = " and ".join(column for column, of in zip(columns, sign, strict=True) if of < 0)
    parts = []
    if len(moved) == 2:
        parts.append(f"{' and '.join(moved)} of the measured positions were swapped")
    elif moved:
        where = ", ".join(f"{axis} in the column of {column}" for axis, column in zip("xyz", columns, strict=True))
        parts.append(f"the columns of the measured positions were in another order ({where})")
    if turned:
        parts.append(f"{turned}{'' if moved else ' of the measured positions'} had the wrong sign")
    return " and ".join(parts)


def zero_visits(data: Measurements, robot: Robot) -> IntArray:
    """Return the visits (n,) with a reading that begins with 0, 0, 0, as many programs write without a measurement."""
    numbers = [readings for name, readings in data.readings.items() if robot.instrument(name).columns()]
    three = [readings for readings in numbers if readings.values.shape[1] >= 3]
    visits = [readings.visits[np.all(readings.values[:, :3] == 0.0, axis=1)] for readings in three]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *visits]))


def zeros_in_words(data: Measurements, robot: Robot) -> str:
    """Return the advice on readings of 0, 0, 0 (`zero_visits`); empty if there are none."""
    zeros = zero_visits(data, robot)
    if len(zeros) == 0:
        return ""
    return (
        f"{count_noun(len(zeros), 'pose was', 'poses were')} read at exactly 0, 0, 0, which some programs write when"
        f" they see nothing: {listing([data.labels[k] for k in zeros])}; leave {'it' if len(zeros) == 1 else 'them'}"
        " out"
    )


def equal_columns(data: Measurements, robot: Robot) -> list[tuple[str, str]]:
    """Return pairs of measured columns that vary and yet are equal in every row."""
    columns = {}
    for name, readings in data.readings.items():
        for column, numbers in robot.instrument(name).cells(readings.values).items():
            whole = np.full(len(data), np.nan)
            whole[readings.visits] = numbers
            columns[column] = whole
    varied = [name for name, numbers in columns.items() if len(np.unique(numbers[np.isfinite(numbers)])) > _FEW]
    return [(a, b) for a, b in combinations(varied, 2) if np.array_equal(columns[a], columns[b], equal_nan=True)]


def photographed_points(robot: Robot, data: Measurements) -> tuple[Robot, Measurements] | None:
    """Return the nominal robot, and measurements that state what its first sensor saw as positions [m].

    None is returned for a robot without such a sensor, or with another instrument that reads positions.
    """
    if any(each.reads_positions for each in robot.instruments):
        return None
    for each in (each for each in robot.instruments if each.name in data.readings):
        if isinstance(each, Pixel):
            target = TargetSection(frame=robot.description.targets[each.target].frame, position="unknown")
            return _positioned(robot, data, each.place.link, {each.target: target}, _boards(each, data))
        if isinstance(each, Relation) and each.seen_points(data.readings[each.name].values) is not None:
            return _seen_place(robot, data, each)
    return None


def _boards(camera: Pixel, data: Measurements) -> FloatArray:
    """Origins of the board in the camera, (n, 3) [m]; NaN where it was not seen."""
    readings = data.readings[camera.name]
    visits, view = np.unique(readings.visits, return_inverse=True)
    seen = rays(readings.values, np.array(camera.intrinsics))
    poses, errors = view_poses(camera.body(readings.details), seen, view.reshape(-1), len(visits))
    points = np.full((len(data), 3), np.nan)
    points[visits] = np.where(np.isfinite(errors)[:, None], poses[:, :3, 3], np.nan)
    return points


def _seen_place(robot: Robot, data: Measurements, sensor: Relation) -> tuple[Robot, Measurements]:
    readings = data.readings[sensor.name]
    most = int(np.argmax(np.bincount(readings.pairs)))
    own = readings.subset(np.flatnonzero(readings.pairs == most))
    points, seen = np.full((len(data), 3), np.nan), sensor.seen_points(own.values)
    assert seen is not None  # as `photographed_points` has checked
    points[own.visits] = seen
    place = sensor.own[most]
    target = TargetSection(frame=place.link, xyz=place.xyz, position="unknown")
    return _positioned(robot, data, robot.description.targets[sensor.target].frame, {place.name: target}, points)


def _positioned(
    robot: Robot, data: Measurements, link: str, target: dict[str, TargetSection], points: FloatArray
) -> tuple[Robot, Measurements]:
    changes: dict[str, Any] = {
        "base": BaseSection(frame=link, pose="unknown"),
        "targets": target,
        **{"instruments": {}, "setups": {}, "columns": {}, "held": (), "elimination_order": ()},
        **{"fleet": None, "model": None},
    }
    positioned = build(robot.description.model_copy(update=changes), robot.urdf, robot.path)
    return positioned, replace(data, readings={next(iter(target)): plain_readings(points)}, robot=positioned)


@dataclass(frozen=True)
class JointScales:
    """Scales of joints, from a fit with gains.

    Attributes:
        map: The map that corrects joint values; factors of joints with a right scale are one.
        std: Standard deviations of the factors, (n_actuated,).
        noise: Noise of the fit, per axis [m].
    """

    map: ColumnMap
    std: tuple[float, ...]
    noise: float


def joint_scales(robot: Robot, data: Measurements, at: ColumnMap | None = None) -> JointScales | None:
    """Return the scales of joints; None if the fit fails.

    Args:
        at: Likely map of the columns, from which the fit starts; the plain one if not given.
    """
    names = robot.joint_names
    at = at or ColumnMap.plain(len(names))
    mapped = replace(data, joints=at.joints(data.joints))
    apart = {*unmoved_joints(robot, mapped.joints), *uncounted_turns(robot, mapped.joints)}
    sections = tuple(Gain.section(joint=name, term=Gain.word, sigma=_EXPECTED) for name in names if name not in apart)
    own = tuple(section for section in robot.description.terms if section.term != Gain.word)
    try:
        geared = robot.with_terms((*own, *sections))
        fit = fit_data(geared, Settings(), mapped)
    except CalibrationError:
        return None
    found = fit.robot.values_by_name
    known = dict(zip(fit.free_names, fit.statistics.std, strict=True))
    factors, std = list(at.factors), [0.0] * len(names)
    for j, name in enumerate(names):
        gain = f"{name}.{Gain.word}"
        factor, size = abs(at.factors[j]) * (1.0 + found.get(gain, 0.0)), abs(at.factors[j]) * known.get(gain, 0.0)
        off = abs(factor - 1.0) > max(SCALED, SURE * size)
        factors[j], std[j] = math.copysign(factor if off else 1.0, at.factors[j]), float(size)
    return JointScales(replace(at, factors=tuple(float(factor) for factor in factors)), tuple(std), float(fit.sigma))

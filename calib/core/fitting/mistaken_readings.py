"""Likely mistakes in measurements without positions: each usual mistake is undone, and the nominal robot compared.

Tried are joints that count the other way; columns of two joints, or of two instruments of one kind, that were swapped;
joint values a row above or below their measurements, or all in another unit; and the other meanings that a kind knows
of its numbers. The misfit of a trial is the error of the nominal robot after `register`, over its error with each joint
at its value in some other row: a robot that hardly moves explains nothing. One instrument must come much nearer than
with the data unchanged, and none get worse.

When it fails. Two mistakes at once are not found, nor those that `register` hides: an unknown sensor on the last joint
hides the sign of that joint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError
from calib.core.data.measurements import Measurements
from calib.core.fitting.column_maps import USUAL_FACTORS, ColumnMap
from calib.core.instruments.kind import Readings
from calib.core.robots.robot import Robot
from calib.core.rows.observed import observe
from calib.core.rows.registration import register

_CLOSER = 0.2  # misfit with the mistake undone, over that with the data unchanged
_AS_GOOD = 1.5  # misfit over another one, up to which it is as good
_FITS = 0.05  # misfit up to which an instrument fits
_POSES = 24  # poses that suffice to show a gross mistake
_NAMED = 3


def jumbled_residuals(robot: Robot, data: Measurements) -> dict[str, FloatArray]:
    """Return residuals (n, n_rows) [SI] of each instrument with each joint at its value in some other row.

    Poses that do not close are left out; nothing is returned where a pose cannot be assembled.
    """
    data = replace(data, joints=np.random.default_rng(0).permuted(data.joints, axis=0))
    if robot.mechanism.loops:
        data = data.subset(np.flatnonzero(robot.close(data.joints, thorough=False).ok))
    return _residuals(robot, data)


def mistaken_readings(robot: Robot, data: Measurements) -> str:
    """Return the mistake that explains the measurements, in words; empty where none does."""
    now = _misfits(robot, _some(data))
    tried = [(_relative_misfits(now | _misfits(robot, trial), now), words) for words, trial in _undone(robot, data)]
    closer = sorted((np.mean(parts), min(parts), words) for parts, words in tried if min(parts, default=1.0) < _CLOSER)
    if not closer:
        return ""
    likely = ", or ".join(words for misfit, _, words in closer[:_NAMED] if misfit <= _AS_GOOD * closer[0][0])
    times = 1 / max(closer[0][1], 1e-6)
    return f"probable mistake: {likely}. Corrected, the nominal robot fits {times:.0f} times better"


def _some(data: Measurements) -> Measurements:
    return data.subset(np.unique(np.linspace(0, len(data) - 1, _POSES).astype(np.intp)))


def _relative_misfits(misfits: dict[str, float], now: dict[str, float]) -> list[float]:
    """Misfit of each instrument, divided by its misfit `now`; empty where one of them gets worse."""
    worse = any(misfits[name] > max(_AS_GOOD * misfit, _FITS) for name, misfit in now.items())
    return [] if worse else [misfits[name] / misfit for name, misfit in now.items() if misfit]


def _misfits(robot: Robot, data: Measurements) -> dict[str, float]:
    """Error of each instrument by the nominal robot over that with jumbled joints; infinite where not placed."""
    try:
        placed = register(robot, data)
    except CalibrationError:
        return dict.fromkeys(data.readings, np.inf)
    jumbled = {name: _rms(rows) for name, rows in jumbled_residuals(placed, data).items()}
    now = {name: _rms(rows) for name, rows in _residuals(placed, data).items()}
    return {name: now[name] / jumbled[name] if jumbled.get(name) else np.inf for name in now}


def _residuals(robot: Robot, data: Measurements) -> dict[str, FloatArray]:
    try:
        at = robot.assemble(data.joints, context=data.conditions)
        observed = observe(robot, at, data.readings, derivatives=False)
    except CalibrationError:
        return {}
    return {name: item.residuals for name, item in observed.items() if len(item.residuals)}


def _rms(rows: FloatArray) -> float:
    return float(np.sqrt(np.mean(rows**2)))


def _undone(robot: Robot, measured: Measurements) -> Iterator[tuple[str, Measurements]]:
    """Yield each mistake in words, and some of the measurements without it, of the instruments that it concerns."""
    data, n = _some(measured), len(robot.joint_names)
    q, plain = data.joints, ColumnMap.plain(n)
    signs = [replace(plain, factors=tuple(-1.0 if k == j else 1.0 for k in range(n))) for j in range(n)]
    orders = [
        replace(plain, columns=tuple({a: b, b: a}.get(k, k) for k in range(n))) for a, b in combinations(range(n), 2)
    ]
    for at in (*signs, *orders):
        yield at.words(robot), replace(data, joints=at.joints(q))
    for side, rows in (("above", 1), ("below", -1)):
        shifted = replace(measured, joints=np.roll(measured.joints, -rows, axis=0))
        kept = np.arange(len(measured) - 1) + (rows < 0)
        yield f"all joint values stood one row {side} their measurements", _some(shifted.subset(kept))
    for dimension, factors in USUAL_FACTORS.items():
        own = np.array([robot.mechanism.dimensions[name] == dimension for name in robot.joint_names])
        for factor, words in factors.items() if np.any(own) else ():
            yield f"joint values: {words}", replace(data, joints=np.where(own, factor * q, q))
    for name in data.readings:
        for words, readings in _meanings(robot, data, name):
            yield words, replace(data, readings={name: readings})
    for names in _alike(robot, data):
        for meanings in zip(*(_meanings(robot, data, name) for name in names), strict=True):
            changed = {name: each for name, (_, each) in zip(names, meanings, strict=True)}
            yield " and ".join(words for words, _ in meanings), replace(data, readings=changed)
        for a, b in combinations(names, 2):
            changed = {a: data.readings[b], b: data.readings[a]}
            yield f"the columns of {a} and {b} were swapped", replace(data, readings=changed)


def _meanings(robot: Robot, data: Measurements, name: str) -> Iterator[tuple[str, Readings]]:
    """Yield the other meanings of an instrument's readings, in words."""
    readings = data.readings[name]
    for words, values in robot.instrument(name).other_meanings(readings.values):
        yield words, replace(readings, values=values)


def _alike(robot: Robot, data: Measurements) -> list[list[str]]:
    """Names of instruments of one kind, two or more, that read a single thing each."""
    kinds: dict[type, list[str]] = {}
    for instrument in (robot.instrument(name) for name in data.readings):
        if instrument.columns() and not instrument.text_columns():
            kinds.setdefault(type(instrument), []).append(instrument.name)
    return [names for names in kinds.values() if len(names) > 1]

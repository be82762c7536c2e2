"""Days on which nothing goes wrong, of every sort."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from verdict_lab import Lab, Scenario, Trial, placed

import calib
from calib.core.data.measurements import Measurements
from calib.core.instruments.kind import Readings


def as_drawn(lab: Lab) -> Measurements:
    """A robot without errors."""
    return lab.written(lab.seen(robot=lab.nominal.with_parameters(placed(lab.nominal))) + lab.noise())


def repeated(lab: Lab) -> Measurements:
    """Each pose read three times, approached anew: joints and readings differ."""
    q = np.repeat(lab.joints, 3, axis=0) + lab.rng.uniform(-2e-4, 2e-4, (3 * len(lab.joints), lab.joints.shape[1]))
    anew = replace(lab, joints=q)
    return anew.written(anew.seen() + anew.noise(), names=tuple(str(k // 3) for k in range(len(q))))


def fine_digits(lab: Lab) -> Measurements:
    """An instrument that reads in steps of half its noise."""
    step = lab.sigma / 2
    return lab.written(np.round((lab.seen() + lab.noise()) / step) * step)


def round_commands(lab: Lab) -> Measurements:
    """The robot is sent to whole tenths of a degree and of a millimetre."""
    steps = np.where(np.diag(lab.turns()) > 0, np.radians(0.1), 1e-4)
    there = replace(lab, joints=np.round(lab.joints / steps) * steps)
    return there.good()


def gaps(lab: Lab) -> Measurements:
    """One reading in ten is missing."""
    positions = lab.seen() + lab.noise()
    positions[lab.rng.random(positions.shape[:2]) < 0.1] = np.nan
    return lab.written(positions)


def noisy(lab: Lab) -> Measurements:
    """Ten times the usual noise."""
    return lab.written(lab.seen() + lab.noise(10.0))


def with_time(lab: Lab) -> Measurements:
    """A column time; the rows are shuffled."""
    order = lab.rng.permutation(len(lab.joints))
    data = lab.written(lab.seen() + lab.noise(), time=30.0 * np.arange(len(lab.joints)))
    return replace(data.subset(order), order=None, approach=None)


def along_a_path(lab: Lab) -> Measurements:
    """Poses in an order that saves travel: each is the nearest of those left."""
    left, path = list(range(len(lab.joints))), [0]
    left.remove(0)
    reach = np.ptp(lab.joints, axis=0)
    while left:
        away = np.linalg.norm((lab.joints[left] - lab.joints[path[-1]]) / reach, axis=1)
        path.append(left.pop(int(np.argmin(away))))
    return replace(lab, joints=lab.joints[path]).good()


def validated_apart(lab: Lab) -> Trial:
    """Validated with a file of its own."""
    half = len(lab.joints) // 2
    good = lab.good()
    return Trial(
        good.subset(np.arange(len(lab.joints) - half // 2)), lab.good().subset(np.arange(half // 2 * 3, len(good)))
    )


def two_setups(lab: Lab) -> Measurements:
    """Poses in two blocks, the second of them measured with half the noise; the file says so by nothing."""
    return lab.written(lab.seen() + lab.noise(np.where(lab.after(0.5), 0.8, 1.2)))


def simulated(lab: Lab) -> Measurements:
    """Whatever the description measures."""
    return calib.simulate(lab.truth, lab.joints, seed=lab.rng)


def touched(lab: Lab) -> Measurements:
    """A ball on the flange is held in the sockets of a plate."""
    poses = calib.sample(lab.nominal, len(lab.joints), lab.rng)
    data = calib.simulate(lab.truth, poses, sigma=None, seed=lab.rng)
    off = data.joints + lab.rng.normal(0.0, 3e-5, data.joints.shape)
    return replace(data, joints=off)


def every_other(lab: Lab) -> Measurements:
    """Positions at each pose, distances at every other."""
    data = calib.simulate(lab.truth, lab.joints, seed=lab.rng)
    kept: dict[str, Readings] = {}
    for name, readings in data.readings.items():
        few = readings.visits % 2 == 0 if name != "reflector" else np.ones(len(readings), dtype=bool)
        kept[name] = Readings(
            readings.visits[few], readings.pairs[few], readings.values[few], None, readings.details[few]
        )
    return replace(data, readings=kept)


HEALTHY: dict[str, Scenario] = {
    "errors as expected": Scenario("healthy", Lab.good),
    "errors as expected, nothing held out": Scenario("healthy", Lab.good, validate=0.0),
    "errors as expected, noise not stated": Scenario("healthy", Lab.good, stated=False),
    "no errors: robot as designed": Scenario("healthy", as_drawn),
    "each pose read three times": Scenario("healthy", repeated),
    "readings in steps of half the noise": Scenario("healthy", fine_digits),
    "sent to whole tenths of a degree": Scenario("healthy", round_commands, stated=False),
    "one reading in ten missing": Scenario("healthy", gaps),
    "ten times the usual noise, not stated": Scenario("healthy", noisy, stated=False),
    "a column time, rows shuffled": Scenario("healthy", with_time),
    "poses along a path": Scenario("healthy", along_a_path),
    "validated with another file": Scenario("healthy", validated_apart),
    "cross-validated in five folds": Scenario("healthy", Lab.good, validate=0.0, settings=(("folds", 5),)),
    "a robust loss": Scenario("healthy", Lab.good, settings=(("loss", "huber"),)),
    "noise that changes a little": Scenario("healthy", two_setups),
    "the base known": Scenario("healthy", Lab.good, robots=("arm",), measured="base known"),
    "full poses measured": Scenario("healthy", simulated, robots=("arm",), measured="full poses"),
    "distances measured": Scenario("healthy", simulated, robots=("arm",), measured="distances"),
    "sockets touched": Scenario("healthy", touched, robots=("arm",), measured="touches"),
    "pixels of two cameras measured": Scenario("healthy", simulated, robots=("arm",), measured="pixels"),
    "positions and distances measured": Scenario(
        "healthy", every_other, robots=("arm",), measured="positions and distances"
    ),
}
"""Healthy scenarios, by name."""

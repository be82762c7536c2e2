"""Faults of the instrument: noise, drifts, shifts, outliers, scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from verdict_lab import Array, Lab, Scenario, Trial

import calib
from calib.core.data.measurements import Measurements


def outliers(lab: Lab) -> Measurements:
    """One reading in twenty off by 1 mm or so."""
    positions = lab.seen() + lab.noise()
    bad = lab.rng.permutation(len(positions))[: len(positions) // 20]
    positions[bad] += lab.rng.normal(0.0, 1e-3, (len(bad), *positions.shape[1:]))
    return lab.written(positions)


def run_of_outliers(lab: Lab) -> Measurements:
    """Six readings in a row off by 0.5 mm in one direction, as with something in the beam."""
    positions = lab.seen() + lab.noise()
    first = int(lab.rng.integers(len(positions) - 6))
    positions[first : first + 6] += 5e-4 * lab.direction()
    return lab.written(positions)


def noisy(lab: Lab) -> Measurements:
    """Ten times the noise that was stated."""
    return lab.written(lab.seen() + lab.noise(10.0))


def quiet(lab: Lab) -> Measurements:
    """A third of the noise that was stated."""
    return lab.written(lab.seen() + lab.noise(1 / 3))


def two_instruments(lab: Lab) -> Measurements:
    """A third of the readings come from an instrument with ten times the noise."""
    bad = lab.rng.random((len(lab.joints), 1, 1)) < 1 / 3
    return lab.written(lab.seen() + lab.noise(np.where(bad, 10.0, 1.0)))


def two_frames(lab: Lab) -> Measurements:
    """A third of the readings come from an instrument whose frame lies 0.5 mm elsewhere."""
    other = lab.rng.random((len(lab.joints), 1, 1)) < 1 / 3
    return lab.written(lab.seen() + lab.noise() + 5e-4 * other * lab.direction())


def drift(lab: Lab) -> Measurements:
    """The tracker drifts by ten times its noise in the course of the measurement."""
    return lab.written(lab.seen() + lab.noise() + 10 * lab.sigma * lab.course() * lab.direction())


def tracker_moved(lab: Lab) -> Measurements:
    """The tracker is pushed by 1 mm after half of the poses."""
    return lab.written(lab.seen() + lab.noise() + 1e-3 * lab.after(0.5) * lab.direction())


def _turned(lab: Lab) -> Array:
    """Readings of a tracker that turns about its own place, 3 m away, so that 0.5 mm come of it in the end."""
    seen = lab.seen()
    middle = seen.mean(axis=(0, 1))
    away = lab.direction()
    axis = np.cross(away, lab.direction())
    axis /= np.linalg.norm(axis)
    tracker = middle + 3.0 * away
    return np.asarray(seen + 5e-4 / 3.0 * lab.course() * np.cross(axis, seen - tracker))


def turning(lab: Lab) -> Measurements:
    """The tracker turns slowly."""
    return lab.written(_turned(lab) + lab.noise())


def turning_in_place(lab: Lab) -> Measurements:
    """The frame turns slowly about the robot, until points are off by ten times the noise."""
    seen = lab.seen()
    moved = np.cross(lab.direction(), seen - seen.mean(axis=(0, 1)))
    moved *= 10 * lab.sigma / np.sqrt(np.mean(np.sum(moved**2, axis=-1)))
    return lab.written(seen + lab.course() * moved + lab.noise())


def turning_with_time(lab: Lab) -> Measurements:
    """The tracker turns slowly; rows shuffled, but with the time."""
    data = lab.written(_turned(lab) + lab.noise(), time=30.0 * np.arange(len(lab.joints)))
    return replace(data.subset(lab.rng.permutation(len(lab.joints))), order=None, approach=None)


def turning_shuffled(lab: Lab) -> Measurements:
    """The tracker turns slowly by as much as its noise allows; rows shuffled, no time."""
    data = turning_in_place(lab)
    order = lab.rng.permutation(len(lab.joints))
    return lab.written(data.points(lab.nominal)[order], lab.joints[order])


def slipped_reflector(lab: Lab) -> Measurements:
    """The reflector slips by 0.2 mm on the flange after half of the poses."""
    target = lab.nominal.target_names[0]
    off = 2e-4 * lab.direction()
    moved = lab.seen()
    frames = lab.truth.forward(lab.joints, target)
    base = lab.truth.forward(lab.joints, lab.truth.description.base.frame)
    rotation = np.linalg.solve(base[:, :3, :3], frames[:, :3, :3])
    in_frame = _to_measured(lab, moved[:, 0], rotation @ off)
    moved[:, 0] = np.where(lab.after(0.5)[:, 0], in_frame, moved[:, 0])
    return lab.written(moved + lab.noise())


def _to_measured(lab: Lab, positions: Array, off: Array) -> Array:
    """Positions with what they are off by in the robot's base, (n, 3) [m], turned into the measurement frame."""
    values = dict(zip((p.name for p in lab.truth.parameters), lab.truth.values, strict=True))
    turn = np.eye(3)
    if "base.rz" in values:  # the pose of the base in the measurement frame
        rx, ry, rz = (values[f"base.r{axis}"] for axis in "xyz")
        cx, sx, cy, sy, cz, sz = np.cos(rx), np.sin(rx), np.cos(ry), np.sin(ry), np.cos(rz), np.sin(rz)
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        turn = about_z @ about_y @ about_x
    return np.asarray(positions + off @ turn.T)


def _longer(lab: Lab, by: float | Array) -> Array:
    seen = lab.seen()
    middle = seen.mean(axis=(0, 1))
    return np.asarray(seen + by * (seen - middle))


def wrong_scale(lab: Lab) -> Measurements:
    """Every length is read 300 ppm too long."""
    return lab.written(_longer(lab, 3e-4) + lab.noise())


def warm_robot(lab: Lab) -> Measurements:
    """The robot is warmer than where it will work: 80 ppm longer."""
    return lab.written(_longer(lab, 8e-5) + lab.noise())


def warming_up(lab: Lab) -> Measurements:
    """Robot and instrument warm up: 800 ppm in the course of the measurement."""
    return lab.written(_longer(lab, 8e-4 * lab.course()) + lab.noise())


def known_length(lab: Lab) -> Measurements:
    """Every length of the tracker is 300 ppm too long, and bars from known points are measured, too."""
    data = calib.simulate(lab.truth, lab.joints, seed=lab.rng)
    tracker = data.readings["reflector"]
    return replace(data, readings={**data.readings, "reflector": replace(tracker, values=1.0003 * tracker.values)})


def base_elsewhere(lab: Lab) -> Measurements:
    """The base, which is called known, stands 20 mm elsewhere since last year."""
    return lab.written(lab.seen() + lab.noise() + 20e-3 * lab.direction())


def base_a_little_elsewhere(lab: Lab) -> Measurements:
    """The base is turned by 20 mrad against what was written down."""
    turned = np.cross(lab.direction(), lab.seen())
    return lab.written(lab.seen() + lab.noise() + 20e-3 * turned)


def moved_between(lab: Lab) -> Trial:
    """The tracker stood 1 mm elsewhere when the validation file was measured."""
    good = lab.good()
    other = lab.written(lab.seen() + lab.noise() + 1e-3 * lab.direction())
    return Trial(good.subset(np.arange(60)), replace(other.subset(np.arange(60, len(other))), path="other"))


def other_tool(lab: Lab) -> Measurements:
    """The reflector sits 1 mm elsewhere on the flange after a third of the poses: it was taken off."""
    frames = lab.truth.forward(lab.joints, lab.nominal.target_names[0])
    base = lab.truth.forward(lab.joints, lab.truth.description.base.frame)
    rotation = np.linalg.solve(base[:, :3, :3], frames[:, :3, :3])
    seen = lab.seen()
    moved = _to_measured(lab, seen[:, 0], rotation @ (1e-3 * lab.direction()))
    seen[:, 0] = np.where(lab.after(1 / 3)[:, 0], moved, seen[:, 0])
    return lab.written(seen + lab.noise())


READINGS: dict[str, Scenario] = {
    "5 % outliers": Scenario("faulty", outliers),
    "six outliers in a row": Scenario("faulty", run_of_outliers, stated=False),
    "noise ten times what was stated": Scenario("counted", noisy),
    "noise a third of what was stated": Scenario("counted", quiet),
    "two instruments, one ten times worse": Scenario("faulty", two_instruments, stated=False),
    "two instruments, frames 0.5 mm apart": Scenario("counted", two_frames),
    "the tracker drifts": Scenario("faulty", drift),
    "the tracker is moved half-way": Scenario("faulty", tracker_moved),
    "the tracker turns slowly, noise not stated": Scenario("faulty", turning, stated=False),
    "the frame turns about the robot, noise not stated": Scenario("faulty", turning_in_place, stated=False),
    "the tracker turns, rows shuffled, with time": Scenario("faulty", turning_with_time, stated=False),
    "warming up by 800 ppm, noise not stated": Scenario("faulty", warming_up, stated=False),
    "a tracker's scale, known lengths measured": Scenario(
        "counted", known_length, robots=("arm",), measured="positions and distances"
    ),
    "the reflector slips by 0.2 mm half-way": Scenario("faulty", slipped_reflector, stated=False),
    "the reflector was taken off and put on": Scenario("faulty", other_tool, stated=False),
    "a base called known stands 20 mm elsewhere": Scenario(
        "faulty", base_elsewhere, robots=("arm",), measured="base known"
    ),
    "a base 20 mm elsewhere, which free parameters describe": Scenario("counted", base_elsewhere, robots=("MedRUE",)),
    "a base called known is turned by 20 mrad": Scenario(
        "faulty", base_a_little_elsewhere, robots=("arm",), measured="base known"
    ),
    "tracker moved before validation": Scenario("faulty", moved_between),
    "lengths read 300 ppm too long": Scenario("hidden", wrong_scale, stated=False, named="scale error"),
    "a robot 80 ppm longer by heat": Scenario("hidden", warm_robot, stated=False, named="scale error"),
    "the frame turns, rows shuffled, no time": Scenario("hidden", turning_shuffled, stated=False, named="random order"),
}
"""Sick scenarios of instruments, by name."""

"""Faults of the robot, and of the choice of poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from verdict_lab import Array, Lab, Scenario, Trial

import calib
from calib.core.data.measurements import Measurements, directions_of_motion


def _joint_error(lab: Lab, error: Callable[[Array, Array], Array], count: int = 1) -> Measurements:
    """Joints that move the target are off by error(their values, their directions of approach) [rad]."""
    joints = lab.joints.copy()
    for j in lab.strong_joints()[:count]:
        joints[:, j] += error(lab.joints[:, j], directions_of_motion(lab.joints)[:, j])
    return lab.written(lab.seen(joints) + lab.noise())


def backlash(lab: Lab) -> Measurements:
    """A backlash of 0.1 degrees in one joint."""
    return _joint_error(lab, lambda q, way: np.radians(0.05) * way)


def small_backlash(lab: Lab) -> Measurements:
    """A backlash of 0.04 degrees in one joint."""
    return _joint_error(lab, lambda q, way: np.radians(0.02) * way)


def sag(lab: Lab) -> Measurements:
    """A joint that sags by up to 0.1 degrees with its angle, as under its own weight."""
    return _joint_error(lab, lambda q, way: np.radians(0.1) * np.cos(2.0 * q))


def eccentric_encoder(lab: Lab) -> Measurements:
    """An encoder off its centre: three waves in a turn, 0.05 degrees high."""
    return _joint_error(lab, lambda q, way: np.radians(0.05) * np.sin(3.0 * q))


def two_bad_encoders(lab: Lab) -> Measurements:
    """Two encoders with five waves in a turn, 0.03 degrees high."""
    return _joint_error(lab, lambda q, way: np.radians(0.03) * np.sin(5.0 * q), 2)


def fast_gear(lab: Lab) -> Measurements:
    """A gear with 20 waves in a turn, 0.02 degrees high."""
    return _joint_error(lab, lambda q, way: np.radians(0.02) * np.sin(20.0 * q + 0.5))


def slipped_encoder(lab: Lab) -> Measurements:
    """An encoder that slips by 0.1 degrees after two thirds of the poses."""
    return _joint_error(lab, lambda q, way: np.radians(0.1) * lab.after(2 / 3)[:, 0, 0])


def warm_motor(lab: Lab) -> Measurements:
    """A joint's zero creeps by 0.05 degrees while its motor warms up."""
    return _joint_error(lab, lambda q, way: np.radians(0.05) * (1.0 - np.exp(-4.0 * lab.course()[:, 0, 0])))


def lost_steps(lab: Lab) -> Measurements:
    """A motor loses 0.2 degrees for a quarter of the time, then is sent home."""
    late = lab.after(0.5)[:, 0, 0] & ~lab.after(0.75)[:, 0, 0]
    return _joint_error(lab, lambda q, way: np.radians(0.2) * late)


def loose_joint(lab: Lab) -> Measurements:
    """A joint that comes to rest anywhere within 0.1 degrees."""
    return _joint_error(lab, lambda q, way: np.radians(0.1) * lab.rng.uniform(-0.5, 0.5, len(q)))


def loose_joints(lab: Lab) -> Measurements:
    """Every joint that turns comes to rest anywhere within 0.03 degrees."""
    return _joint_error(lab, lambda q, way: np.radians(0.03) * lab.rng.uniform(-0.5, 0.5, len(q)), count=6)


def one_corner(lab: Lab) -> Measurements:
    """All poses within a few degrees (and millimetres) of each other."""
    return lab.sent(lab.joints[0] + 0.03 * (lab.joints - lab.joints[0])).good()


def still_joint(lab: Lab) -> Measurements:
    """One joint that never moved."""
    j = lab.any_joint()
    return lab.sent(lab.with_joint(j, np.full(len(lab.joints), lab.joints[0, j]))).good()


def little_moved(lab: Lab) -> Measurements:
    """One joint moved through a fiftieth of the range that the others had."""
    return _little_moved(lab).good()


def little_moved_otherwise(lab: Lab) -> Measurements:
    """The same, by instruments that do not measure positions."""
    little = _little_moved(lab)
    return calib.simulate(little.truth, little.joints, seed=little.rng)


def _little_moved(lab: Lab) -> Lab:
    j = int(lab.strong_joints()[0])
    q = lab.joints[:, j]
    return lab.sent(lab.with_joint(j, q[0] + 0.02 * (q - q[0])))


def together(lab: Lab) -> Measurements:
    """All joints moved together, along one line."""
    ends = lab.joints[:2]
    part = lab.rng.random((len(lab.joints), 1))
    return lab.sent(ends[0] + 0.5 * part * (ends[1] - ends[0])).good()


def far_validation(lab: Lab) -> Trial:
    """Calibrated in a twelfth of the range of each joint, validated all over it."""
    near = lab.sent(lab.joints[0] + (lab.joints - lab.joints[0]) / 12.0).good()
    return Trial(near.subset(np.arange(min(60, len(near)))), lab.good().subset(np.arange(60, len(lab.joints))))


def another_on_validation(lab: Lab) -> Trial:
    """Validated with a robot of the same make that was never calibrated."""
    twin = lab.written(lab.seen(robot=_twin(lab)) + lab.noise())
    return Trial(lab.good().subset(np.arange(60)), replace(twin.subset(np.arange(60, len(twin))), path="other"))


def changed_between(lab: Lab) -> Trial:
    """A collision turned one joint's zero by 0.1 degrees before the validation file was measured."""
    later = _joint_error(lab, lambda q, way: np.full(len(q), np.radians(0.1)))
    return Trial(lab.good().subset(np.arange(60)), replace(later.subset(np.arange(60, len(later))), path="other"))


def _twin(lab: Lab) -> calib.Robot:
    nominal = lab.nominal
    values = dict(zip((p.name for p in nominal.parameters), lab.truth.values, strict=True))
    for p, use in zip(nominal.parameters[: nominal.n_origin_parameters], nominal.is_free, strict=False):
        if use and not p.placement:
            values[p.name] = p.nominal_si + p.sigma_si * lab.rng.normal()
    return nominal.with_parameters(values)


def too_few(lab: Lab) -> Measurements:
    """A dozen poses or so: 48 coordinates."""
    return lab.good().subset(np.arange(16 // len(lab.nominal.target_names)))


def handful(lab: Lab) -> Measurements:
    """Six poses."""
    return lab.good().subset(np.arange(6))


ROBOT: dict[str, Scenario] = {
    "backlash of one joint": Scenario("counted", backlash),
    "a small backlash, noise not stated": Scenario("counted", small_backlash, stated=False),
    "a joint that sags": Scenario("counted", sag, robots=("arm",)),
    "an encoder off its centre": Scenario("counted", eccentric_encoder),
    "two bad encoders, noise not stated": Scenario("counted", two_bad_encoders, stated=False),
    "a fast gear error, noise not stated": Scenario("counted", fast_gear, stated=False),
    "an encoder that slips": Scenario("faulty", slipped_encoder),
    "a motor that warms up, noise not stated": Scenario("faulty", warm_motor, stated=False),
    "a motor that loses steps for a while": Scenario("faulty", lost_steps, stated=False),
    "a loose joint": Scenario("counted", loose_joint),
    "all poses in one corner": Scenario("counted", one_corner),
    "a joint that never moved": Scenario("counted", still_joint),
    "a joint that moved too little": Scenario("counted", little_moved),
    "a joint that moved too little, distances measured": Scenario(
        "counted", little_moved_otherwise, robots=("arm",), measured="distances"
    ),
    "a joint that moved too little, pixels measured": Scenario(
        "counted", little_moved_otherwise, robots=("arm",), measured="pixels"
    ),
    "joints that moved together": Scenario("counted", together),
    "calibrated in a small region, validated far away": Scenario("faulty", far_validation),
    "validated with another robot": Scenario("faulty", another_on_validation),
    "a collision before validation": Scenario("faulty", changed_between),
    "too few poses": Scenario("counted", too_few, validate=0.0),
    "six poses": Scenario("faulty", handful, validate=0.0),
    "a joint that sags, over a short range": Scenario("counted", sag, robots=("MedRUE", "3-RRR")),
    "all joints a little loose, noise not stated": Scenario(
        "hidden", loose_joints, stated=False, named="the noise of the instrument was not stated"
    ),
}
"""Sick scenarios of robots and poses, by name."""

"""MedRUE's part of `calib qualify`: the engine against the closed form of the paper, which shares no code with it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import calib
from calib.extend import Check, Phase
from medrue import robot_file
from medrue.closed_form import forward

_POSES = 200
_FAR = 1e-9
"""Largest distance between both positions [m]."""


def checks() -> Iterator[Check]:
    """Compare tool positions of the nominal robot and of robots with drawn errors with the closed form."""
    robot = calib.load(robot_file())
    joints = robot.sample(_POSES, seed=1)
    generator = np.random.default_rng(2)
    sigma = robot.parameters.sigma_si
    for name, values in (
        ("nominal", robot.values),
        ("with drawn errors", robot.values + 0.3 * sigma * generator.standard_normal(len(sigma))),
    ):
        here = robot.with_parameters(values)
        ok = here.close(joints).ok
        expected = forward(joints[ok], values)
        off = float(np.max(np.abs(here.positions(joints[ok])[:, 0] - expected.p_world_tool)))
        requirement = f"tool positions within {1e3 * _FAR:g} mm of the closed form (equations 1 to 17 of the paper)"
        found = f"{1e3 * off:.1e} mm at {int(np.sum(ok))} poses"
        yield Check.from_values(Phase.OPERATION, f"MedRUE, {name}", requirement, found, off <= _FAR)

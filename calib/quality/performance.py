"""Performance qualification: a calibration keeps its claims, on a simulated robot and on the user's own.

On the simulated robot the truth is known: the fit's claim is compared with the error at other poses, and wrong input
must not get PASS. On a robot and measurements of the user, a fifth of the poses is held out and compared with the
claim.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from calib.core.base.errors import CalibrationError
from calib.core.base.units import quantity_text
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.measurements import Measurements
from calib.core.fitting.settings import Settings
from calib.core.judging.claim import MORE
from calib.core.judging.verdict import judge
from calib.core.robots.robot import Robot
from calib.core.rows.simulate import simulate
from calib.quality.operation import draw_robot
from calib.quality.protocol import Check, Outcome, Phase, Work
from calib.quality.references import sample_robots

_PHASE = Phase.PERFORMANCE
_check = partial(Check.from_values, _PHASE)
_POSES, _OTHERS, _HELD_OUT = 60, 300, 0.2
_LEAST = 0.75
"""Least ratio of claim and error, in either direction: a claim must be neither too small nor useless."""


def performance_work(robot: Robot | None, data: Measurements | None) -> Iterator[Work]:
    """Yield the pieces of work of the phase, including the user's robot if given."""
    yield _PHASE, "simulated robot", _check_simulated
    yield _PHASE, "wrong robots", _check_mistakes
    if robot is not None and data is not None:
        yield _PHASE, robot.name, lambda: _check_own_data(robot, data)


def _check_simulated() -> Iterator[Check]:
    """Compare the claim with the known truth."""
    _, robot = next(sample_robots())
    true = draw_robot(robot, seed=11)
    fit = calibrate(robot, simulate(true, true.sample(_POSES, seed=11), seed=11), None, Settings())
    verdict = judge(fit)
    others = true.sample(_OTHERS, seed=12)
    measured = simulate(true, others, seed=12)
    off = fit.robot.positions(others) - np.stack([r.values for r in measured.readings.values()], axis=1)
    error = float(np.sqrt(np.mean(np.sum(off**2, axis=-1))))
    yield _check("verdict on a sound simulated robot", "PASS", verdict.grade, verdict.grade == "PASS")
    claimed = np.nan if verdict.claim is None else verdict.claim.at_measured_poses.rms
    ratio = claimed / error
    expected = f"claim / error at {_OTHERS} other poses: {_LEAST:g} to {1 / _LEAST:.2f}"
    found = f"{ratio:.2f} ({quantity_text(claimed, 'mm', '.3f')} claimed, {quantity_text(error, 'mm', '.3f')} found)"
    yield _check("claim about a simulated robot", expected, found, bool(_LEAST <= ratio <= 1 / _LEAST))


def _check_mistakes() -> Iterator[Check]:
    """Calibrate from input with a wrong sign, scale or order of joints."""
    _, robot = next(sample_robots())
    true = draw_robot(robot, seed=13)
    data = simulate(true, true.sample(_POSES, seed=13), seed=13)
    changes = {
        "the second joint with the wrong sign": data.joints * np.array([1, -1, 1, 1, 1, 1]),
        "the third joint 3 % too large": data.joints * np.array([1, 1, 1.03, 1, 1, 1]),
        "two joints exchanged": data.joints[:, [0, 1, 2, 3, 5, 4]],
    }
    for what, joints in changes.items():
        grade: str
        try:
            grade = judge(calibrate(robot, replace(data, joints=joints), None, Settings(sigma=None))).grade
        except CalibrationError as error:  # refused with a reason, so no wrong number results
            grade = f"refused ({type(error).__name__})"
        yield _check(what, "never PASS", grade, grade != "PASS")


def _check_own_data(robot: Robot, data: Measurements) -> Iterator[Check]:
    """Compare the claim with held-out poses of the user's measurements."""
    used, held_out = data.read_visits().split(validation=_HELD_OUT, seed=0)
    fit = calibrate(robot, used, held_out, Settings())
    verdict = judge(fit)
    yield _check(f"verdict on {robot.name}", "PASS", verdict.grade, verdict.grade == "PASS")
    claim = verdict.claim
    if claim is None or not claim.unused:
        yield Check(_PHASE, f"claim about {robot.name}", "a claim", "the readings do not tell", Outcome.NOTED)
        return
    shown = claim.unused[0].accuracy
    expected = f"{held_out.n_poses} poses that were held out: at most {MORE:g} times as far off as claimed"
    found = f"{shown.in_unit(shown.rms)} RMS, {claim.at_measured_poses.in_unit(claim.at_measured_poses.rms)} claimed"
    yield _check(f"claim about {robot.name}", expected, found, claim.holds)

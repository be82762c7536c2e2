"""Errors that leave no trace in the measurements, so that the verdict does not cover them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.core.base.units import millimetres
from calib.core.data.measurements import Measurements, Poses
from calib.core.fitting.fitted import Fit
from calib.core.judging import findings
from calib.core.judging.effect_kinds import Trait
from calib.core.judging.error_budget import ENOUGH_REPEATS
from calib.core.judging.repeatability import repeatability
from calib.core.judging.row_derivatives import has_time, scales
from calib.core.judging.rules_reach import terms_beyond

NO_MATTER = 0.25
"""A message leaves out an unseen scale error if its effect is below this part of the noise."""
LARGEST = 0.1
"""A larger scale error is not small: a line without a limit says that data of this kind do not show any."""
LIKE_SHUFFLED = 0.8
"""Rows may have been shuffled if neighbours are at least this part as far apart as distant rows."""
_FEW = 10  # the order of fewer rows shows nothing


def not_covered(fit: Fit) -> tuple[str, ...]:
    """Return the errors that the measurements of a fit cannot show, a line each."""
    if fit.computed:
        return ()
    seen_in_order = any(Trait.IN_COURSE in p.kind.traits for p in findings.patterns(fit) if p.significant)
    order = () if seen_in_order else unordered(fit.identification.data)  # such a pattern says that rows are in order
    n_sample, n_poses = (each.identification.data.n_poses for each in (findings.sample_of_poses(fit), fit))
    fewer = f"a pattern that only more poses show: patterns and causes were judged on {n_sample} of {n_poses} poses"
    return (*[fewer] * (n_sample < n_poses), *_scale(fit), *_whose_noise(fit), *order, *terms_beyond(fit))


def _scale(fit: Fit) -> Iterator[str]:
    """Line on an error of all lengths (an instrument's scale, heat) that the measurements would not show."""
    column = scales(findings.setting(fit))[:, :1]
    if not np.any(column):
        return
    linear = findings.linear(fit)
    least = linear.visible(column)
    made = least * float(np.linalg.norm(column)) / np.sqrt(linear.freedom)
    if made > NO_MATTER * linear.factor:
        below = f" below {float(f'{millimetres(least):.2g}'):g} mm in 1 m" if least < LARGEST else ""
        yield f"a scale error{below}, of the instrument or from heat (nothing of known length was measured)"


def _whose_noise(fit: Fit) -> Iterator[str]:
    """Lines on errors that the model leaves out, where the noise was neither stated nor measured by repeats."""
    estimate = fit.first_noise
    measured = repeatability(fit.identification)[1] >= ENOUGH_REPEATS
    if estimate.stated is None and not measured and estimate.group.part.is_position:
        data, by_noise = fit.identification.data, replace(fit.uncertainty, joint_error=0.0)
        frame = replace(fit.reported_uncertainty, uncertainty=by_noise)
        known = frame.predict(data.joints, data.conditions, fit.identification.passive, turns=False)
        predicted = float(np.mean(known.reported_distance**2))
        single = millimetres(float(np.sqrt(predicted + 3.0 * estimate.sigma**2)))
        yield (
            "scatter of the robot (play, changing loads): it looks like the instrument's noise, which was not stated"
            f" (--sigma-mm). If the robot makes all of this scatter, single positions are known to {single:.2g} mm RMS"
        )


def unordered(poses: Poses) -> tuple[str, ...]:
    """Return a line if rows have no time, and their order would not show a drift; else nothing."""
    n = len(poses)
    reach = np.ptp(poses.joints, axis=0)
    if n < _FEW or has_time(poses) or not np.any(reach > 0):
        return ()
    q = poses.joints[:, reach > 0] / reach[reach > 0]
    near = float(np.mean(np.linalg.norm(np.diff(q, axis=0), axis=1)))
    apart = [float(np.mean(np.linalg.norm(q - np.roll(q, n // part, axis=0), axis=1))) for part in (2, 3, 4)]
    if near < LIKE_SHUFFLED * float(np.mean(apart)):
        return ()
    assumed = isinstance(poses, Measurements) and poses.approach_assumed
    stated = poses.approach is not None and not assumed and np.all(np.any(poses.approach != 0, axis=0)[reach > 0])
    unseen = "a drift or a slip" if stated else "a drift, a slip or a backlash"
    return (
        f"the rows have no time and seem to be in random order. If they were not measured in this order, {unseen} does"
        " not show: sort them, or add a column 'time'",
    )

"""Joints whose values are on another scale than stated: their factors, by a fit in which each joint has a gain.

A controller may count in gon, a range may be mapped, or a gear ratio may be wrong. Then the file has x, and the joint
is at q = g x + b. The nominal robot is fitted with a gain of each joint that moved and its own parameters, which
absorb b. A factor is reported if it differs from one by more than one percent and by more than its uncertainty allows.

When it fails. The fit starts from the values of the file, or from those of a search. If a joint is scaled by two, the
fit may not converge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from calib.core.base.errors import CalibrationError
from calib.core.data.measurements import Measurements
from calib.core.fitting.column_maps import ColumnMap
from calib.core.fitting.fit import fit_data
from calib.core.fitting.joint_conventions import uncounted_turns
from calib.core.fitting.pose_checks import unmoved_joints
from calib.core.fitting.settings import Settings
from calib.core.robots.robot import Robot
from calib.core.robots.terms.one_coefficient import Gain

SCALED = 0.01
"""Relative error of a scale that no gear, belt or screw has."""
SURE = 6.0
"""A gain of more standard deviations is not chance."""
_EXPECTED = 0.3  # sigma of the gains


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
    found = dict(zip((p.name for p in fit.robot.parameters), fit.robot.values, strict=True))
    known = dict(zip(fit.free_names, fit.statistics.std, strict=True))
    factors, std = list(at.factors), [0.0] * len(names)
    for j, name in enumerate(names):
        gain = f"{name}.{Gain.word}"
        factor, size = abs(at.factors[j]) * (1.0 + found.get(gain, 0.0)), abs(at.factors[j]) * known.get(gain, 0.0)
        off = abs(factor - 1.0) > max(SCALED, SURE * size)
        factors[j], std[j] = math.copysign(factor if off else 1.0, at.factors[j]), float(size)
    return JointScales(replace(at, factors=tuple(float(factor) for factor in factors)), tuple(std), float(fit.sigma))

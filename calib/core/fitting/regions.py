"""Differences of parameters from region to region: boxes of joint space, and setups, left out in turn.

An error that the model leaves out pulls parameters differently in each region. The fit of all poses is a compromise,
and the scatter of single poses does not show it: `calib.core.numerics.clusters` compares the motion of parameters with
its expectation from noise. Where chance hardly explains it, all uncertainty from the covariance is widened by as much:
intervals of parameters, and the uncertainty of predicted positions. Where chance does not explain it at all, the
verdict says so.

When it fails. An error that is equal everywhere moves nothing. One in twenty fits without such an error gets intervals
that are a little too wide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import IntArray
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import boxes
from calib.core.numerics.chances import HARDLY, UNLIKELY
from calib.core.numerics.clusters import scatter
from calib.core.numerics.statistics import Statistics
from calib.core.rows.rows import Rows

BLOCKS = 8
"""Number of boxes of joint space that are left out in turn."""


@dataclass(frozen=True)
class Regions:
    """Changes of parameters where regions are left out in turn.

    Attributes:
        dependence: Quantity on which the parameters depend, in words.
        ratio: Motion of the parameters over its expectation from noise.
        is_significant: Whether chance does not explain it.
    """

    dependence: str
    ratio: float
    is_significant: bool


def disagreeing(data: Measurements, depths: IntArray, rows: Rows, statistics: Statistics) -> Regions | None:
    """Return the regions by which parameters disagree most; None where they agree as well as noise lets them.

    Args:
        depths: `Mechanism.depths` of the robot, (n_actuated,).
        rows: Whitened rows at the solution, with the weights of a robust loss.
    """
    cuts = {"the measured part of joint space": boxes(data.joints, data.pose_numbers, BLOCKS, depths)}
    if data.setups is not None and np.ptp(data.setups) > 0:
        cuts["the setup"] = data.setups
    layout, noise, apart = rows.layout, np.full(rows.layout.n_rows, statistics.factors.common), list[Regions]()
    for name, regions in cuts.items():
        of_row = regions[layout.visit[layout.reading]]
        moved = scatter(rows.span, rows.residuals, noise, of_row, statistics.freedom)
        poses = statistics.shared_scatter
        ratio, chance = (moved.ratio, moved.chance) if poses is None else moved.ratio_to(poses)
        if chance < HARDLY / len(cuts) and ratio > 1.0:
            apart.append(Regions(name, ratio, chance < UNLIKELY / len(cuts)))
    return max(apart, key=lambda regions: regions.ratio, default=None)

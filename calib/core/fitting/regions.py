"""Differences of parameters from region to region: boxes of joint space, and setups, left out in turn.

A model that leaves something out is pulled one way here and another way there. The fit of all poses then stands between
them, and the scatter of single poses does not show it: `calib.core.numerics.clusters` compares what parameters move by
with what noise explains. Where chance hardly explains it, everything that is made of the covariance is widened by as
much: intervals of parameters, and how well predicted positions are known. Where chance does not explain it at all, the
verdict says so.

When it fails. What is off in the same way everywhere moves nothing. Of a fit in twenty that leaves nothing out,
intervals are a little wider than they need to be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import IntArray
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import boxes
from calib.core.numerics.chances import HARDLY, UNLIKELY
from calib.core.numerics.clusters import Scatter, scatter
from calib.core.numerics.statistics import Statistics
from calib.core.rows.rows import Rows

BLOCKS = 8
"""Number of boxes of joint space that are left out in turn."""


@dataclass(frozen=True)
class Regions:
    """Changes of parameters where regions are left out in turn.

    Attributes:
        dependence: Region on which the parameters depend, in words.
        ratio: How many times as much as noise explains they move.
        is_significant: Whether chance does not explain it.
    """

    dependence: str
    ratio: float
    is_significant: bool


def disagreeing(data: Measurements, depths: IntArray, rows: Rows, statistics: Statistics) -> Regions | None:
    """Return the regions by which parameters disagree most; None where they agree as well as noise lets them.

    Args:
        data: The visits that were used.
        depths: `Mechanism.depths` of the robot, (n_actuated,).
        rows: Whitened rows at the solution, with the weights of a robust loss.
        statistics: Statistics of the parameters.
    """
    block = np.zeros(len(data), dtype=np.intp)
    for k, visits in enumerate(boxes(data.joints, data.pose_numbers, BLOCKS, depths)):
        block[visits] = k
    cuts = {"where in joint space was measured": block}
    if data.setups is not None and np.ptp(data.setups) > 0:
        cuts["the setup"] = data.setups
    ratios = {name: scatter_without_blocks(rows, statistics, blocks) for name, blocks in cuts.items()}
    apart = [
        Regions(name, ratio, chance < UNLIKELY / len(cuts))
        for name, (ratio, chance) in ratios.items()
        if chance < HARDLY / len(cuts) and ratio > 1.0
    ]
    return max(apart, key=lambda regions: regions.ratio, default=None)


def scatter_without_blocks(rows: Rows, statistics: Statistics, block: IntArray) -> tuple[float, float]:
    """Return how many times as much as noise explains parameters move without blocks of visits, and the chance of that.

    Args:
        rows: Whitened rows at the solution, with the weights of a robust loss.
        statistics: Statistics of the parameters.
        block: Block of each visit, (n_visits,).
    """
    layout, factors = rows.layout, statistics.factors
    factor = float(np.sqrt(np.sum(factors.freedom * factors.values**2) / factors.total_freedom))
    of_row = block[layout.visit[layout.reading]]
    noise = np.full(layout.n_rows, factor)
    moved: Scatter = scatter(rows.span, rows.residuals, noise, of_row, statistics.freedom)
    return (
        (moved.ratio, moved.chance) if statistics.shared_scatter is None else moved.ratio_to(statistics.shared_scatter)
    )

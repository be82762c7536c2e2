"""The noise found from residuals: scales of groups, and sizes of families.

All of it follows from the linear model around an evaluation (`calib.core.numerics.variance_components`), where possible
from a few rows with the same J^T J and J^T r as all rows (`Problem.compressed`).
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.numerics.size_search import find_sizes
from calib.core.numerics.variance_components import find_scales


def scales_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the scales of the groups `noise_found`, and factors on the sigmas of families, from the residuals.

    Args:
        evaluation: An evaluation near the minimum.
        groups: Scales to start from, (n_groups,).

    Returns:
        Scales of the groups (n_groups,), factors of the families (n_families,).
    """
    if problem.unknowns.families:
        return _with_sizes(problem, evaluation, groups)
    model = problem.compressed(evaluation, np.ones(len(groups)), problem.unknowns)
    return find_scales(model, groups, problem.noise_found), np.ones(0)


def _with_sizes(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return `scales_found` of a problem with families."""
    unknowns = problem.unknowns
    first = [int(np.argmax(unknowns.family == k)) for k in range(len(unknowns.families))]
    sizes = unknowns.scales[first] / problem.robot.parameters.sigma_si[unknowns.index[first]]
    rows = problem.rows(evaluation, groups, unknowns.rescale_families(1.0 / sizes))
    scales, found = find_sizes(rows, problem.noise_found, unknowns.family, sizes)
    return groups * scales, found / sizes

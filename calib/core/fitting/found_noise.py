"""The noise found from residuals: scales of groups, sizes of families, offsets that readings share.

All of it follows from the linear model around an evaluation (`calib.core.numerics.variance_components`), where possible
from a few rows with the same J^T J and J^T r as all rows (`Problem.compressed`).
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.numerics.size_search import find_sizes
from calib.core.numerics.variance_components import find_components, find_scales


def scales_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the scales of the groups `noise_found`, and factors on the sigmas of families, from the residuals.

    Args:
        evaluation: An evaluation near the minimum.
        groups: Scales to start from, (n_groups,).

    Returns:
        Scales of the groups (n_groups,), factors of the families (n_families,).
    """
    ones, unknowns, plain = np.ones(len(groups)), problem.unknowns, problem.weighing is None
    if unknowns.families:
        return _with_sizes(problem, evaluation, groups)
    model = problem.compressed(evaluation, ones, unknowns) if plain else problem.rows(evaluation, ones)
    return find_scales(model, groups, problem.noise_found).scales, np.ones(0)


def _with_sizes(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return `scales_found` of a problem with families."""
    unknowns = problem.unknowns
    first = [int(np.argmax(unknowns.family == k)) for k in range(len(unknowns.families))]
    sizes = unknowns.scales[first] / problem.robot.parameters.sigma_si[unknowns.index[first]]
    rows = problem.rows(evaluation, groups, unknowns.rescale_families(1.0 / sizes))
    scales, found = find_sizes(rows, problem.noise_found, unknowns.family, sizes)
    return groups * scales, found / sizes


def ratios_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
    """Find offsets that readings of an instrument at a pose share, divided by their group's scale, (n_offsets,)."""
    whitening = problem.whitening
    tried = problem.offset_ratios > 0 if np.any(problem.offset_ratios) else whitening.tells_offsets
    if not np.any(tried):
        return problem.offset_ratios
    known = problem.offset_ratios * whitening.offset_scale(groups)
    rows = whitening.rows(evaluation.observed, np.ones(len(groups)), problem.unknowns, evaluation.robot.values)
    offsets, pose = whitening.offset_columns * tried, whitening.layout.pose_of_row
    components = find_components(rows, groups, problem.noise_found, offsets, pose, known)
    ratios: FloatArray = components.shared / whitening.offset_scale(components.scales)
    return ratios


def left_out_rms(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
    """Return the root mean square error of poses left out in turn, divided by the stated noise, (n_groups,).

    It comes from the linear model around an evaluation at the minimum. Every pose counts the same, however many
    readings it has.

    Args:
        problem, evaluation: The problem and the evaluation.
        groups: Scale of the noise of each group, (n_groups,).
    """
    layout, rows = problem.whitening.layout, problem.rows(evaluation, groups)
    pose = layout.pose_of_row
    errors: FloatArray = rows.residuals + rows.leave_out_blocks(pose).shifts_without_block(rows.residuals)[0]
    errors = errors if problem.weighing is None else problem.weighing.unwhiten(errors)
    squares = (errors * problem.whitening.row_scale(groups)) ** 2
    means = []
    for g in range(len(groups)):
        of_group = layout.group == g
        count = np.bincount(pose[of_group])
        means.append(np.mean((np.bincount(pose[of_group], squares[of_group]) / np.maximum(count, 1))[count > 0]))
    return np.sqrt(means)

"""What the residuals of a fit say of its noise: scales of groups, sizes of families, offsets that readings share.

All of it is told by the linear model around an evaluation (`calib.core.numerics.variance_components`). Of very many
rows, a few take their place that have the same products (`Problem.condensed`).
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.fitting.problem import Evaluation, Problem
from calib.core.numerics.clusters import LeftOut
from calib.core.numerics.prior_sizes import FamilyModel, found_with_families
from calib.core.numerics.variance_components import LinearModel, found_components, found_scales
from calib.core.rows.rows import Rows


def scales_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the scales of the groups `noise_found`, and factors on the sigmas of families, from the residuals.

    Args:
        problem: The problem.
        evaluation: An evaluation near the minimum.
        groups: Scales to start from, (n_groups,).

    Returns:
        Scales of the groups (n_groups,), factors of the families (n_families,).
    """
    ones = np.ones(len(groups))
    if problem.unknowns.families:
        return found_with_families(_with_families(problem, evaluation, ones), groups)
    in_batches = len(evaluation.batches) > 1 and problem.weighing is None
    model = _condensed(problem, evaluation, ones) if in_batches else _model(problem, problem.rows(evaluation, ones))
    return found_scales(model, groups).scales, np.ones(0)


def _model(problem: Problem, rows: Rows) -> LinearModel:
    """What rows whitened by what is stated say of the noise."""
    layout = problem.whitening.layout
    unknowns = problem.unknowns
    return LinearModel(
        rows.residuals,
        rows.jacobian,
        rows.prior,
        rows.deviations,
        layout.group,
        problem.noise_found,
        unknowns.family,
        len(unknowns.families),
    )


def _condensed(problem: Problem, evaluation: Evaluation, ones: FloatArray) -> LinearModel:
    """The same of very many rows, by a few that are worth as much."""
    unknowns, group, n = problem.unknowns, problem.whitening.layout.group, len(problem.unknowns)
    rows, numbers = problem.condensed(evaluation, ones, unknowns)
    families = unknowns.family, len(unknowns.families)
    counts, u = np.bincount(group[group >= 0], minlength=len(ones)), unknowns.deviations(evaluation.robot.values)
    return LinearModel(rows[:, n], rows[:, :n], unknowns.prior, u, numbers, problem.noise_found, *families, counts)


def _with_families(problem: Problem, evaluation: Evaluation, ones: FloatArray) -> FamilyModel:
    """What rows whitened by what is stated say of the noise and of families."""
    if problem.weighing is not None:
        return FamilyModel.of(_model(problem, problem.rows(evaluation, ones)))
    unknowns, products = problem.unknowns, problem.products(evaluation, ones)
    u, families = unknowns.deviations(evaluation.robot.values), (unknowns.family, len(unknowns.families))
    return FamilyModel(products, unknowns.prior, u, problem.noise_found, *families)


def ratios_found(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
    """Find offsets that the readings of an instrument at a pose share, over the scale of their group, (n_offsets,).

    Args:
        problem: The problem.
        evaluation: An evaluation near the minimum.
        groups: Scales to start from, (n_groups,).
    """
    whitening = problem.whitening
    tried = problem.ratios > 0 if np.any(problem.ratios) else whitening.tells_offsets
    if not np.any(tried):
        return problem.ratios
    known = problem.ratios * whitening.offset_scale(groups)
    rows = problem.plain_rows(evaluation, np.ones(len(groups)))
    components = found_components(
        _model(problem, rows), groups, whitening.offset_columns * tried, whitening.layout.pose_of_row, known
    )
    ratios: FloatArray = components.shared / whitening.offset_scale(components.scales)
    return ratios


def left_out(problem: Problem, evaluation: Evaluation, groups: FloatArray) -> FloatArray:
    """Return how far off readings are of poses that are left out in turn: their root mean square, (n_groups,).

    By the linear model around the evaluation, in units of what is stated. Every pose counts the same, however many
    readings it has.

    Args:
        problem: The problem.
        evaluation: An evaluation at the minimum.
        groups: Scale of the noise of each group, (n_groups,).
    """
    layout, rows = problem.whitening.layout, problem.rows(evaluation, groups)
    pose = layout.pose_of_row
    errors = LeftOut(rows.span, pose).foretold(rows.residuals)
    errors = errors if problem.weighing is None else problem.weighing.unwhiten(errors)
    squares = (errors * problem.whitening.row_scale(groups)) ** 2
    means = []
    for g in range(len(groups)):
        of_group = layout.group == g
        count = np.bincount(pose[of_group])
        means.append(np.mean((np.bincount(pose[of_group], squares[of_group]) / np.maximum(count, 1))[count > 0]))
    return np.sqrt(means)

"""Findings about a fit, each made at first use: outliers, systematic patterns in the residuals, and an error budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.core.base.errors import CalibrationError, ComputationError, UnreachablePoseError
from calib.core.base.memoize import memoize
from calib.core.base.threads import one_blas_thread
from calib.core.fitting.error_sets import ErrorSet
from calib.core.fitting.fit import errors_on, fit_of_a_part
from calib.core.fitting.fitted import Fit
from calib.core.fitting.outliers import Outlier, noise_factor, outliers_of, readings_of_outliers, studentise_errors
from calib.core.fitting.settings import Settings
from calib.core.judging import residual_patterns
from calib.core.judging.acceptance_system import System
from calib.core.judging.effect_kinds import Kind, Pattern, Trait
from calib.core.judging.effects import effects
from calib.core.judging.error_budget import ErrorBudget, causes_of, error_budget, joint_causes
from calib.core.judging.promise import Promise
from calib.core.judging.residual_patterns import LinearFit
from calib.core.judging.row_derivatives import EffectSetting
from calib.core.numerics.tall import Span

MOST_POSES = 10_000
"""Patterns, scales and causes are judged on at most this many poses: more take time, and hardly change the answer."""


@memoize
def outliers(fit: Fit) -> tuple[Outlier, ...]:
    """Return used readings further off than noise explains, worst first."""
    return outliers_of(studentise_errors(fit), fit.identification, fit.rows.layout)


@memoize
def validation_outliers(fit: Fit) -> tuple[Outlier, ...]:
    """Return validation readings further off than noise and uncertainty explain, worst first."""
    layout = None if fit.validation_rows is None else fit.validation_rows.layout
    if fit.validation is None or layout is None:
        return ()
    rows = System.from_promise(Promise.from_calibration(fit), fit.validation.data, same_setup=True).rows
    span, unused = Span(rows.jacobian, np.eye(rows.jacobian.shape[1])), np.zeros(rows.layout.n_readings)
    scale = studentise_errors(fit).scale / noise_factor(fit)
    return outliers_of(rows.studentise(span, unused, fit.statistics.freedom, scale), fit.validation, layout)


@memoize
def excluded_errors(fit: Fit) -> ErrorSet | None:
    """Return the errors of left-out outliers by the fit without them; None without any, or if a loop stays open."""
    if fit.with_all is None:
        return None
    gone = readings_of_outliers(fit.excluded, fit.with_all.rows.layout)
    try:
        return errors_on(fit.placed, fit.robot, fit.with_all.identification.data.with_readings(gone))
    except (UnreachablePoseError, ComputationError):
        return None


def sample_of_poses(fit: Fit) -> Fit:
    """Return the fit by which patterns, scales and causes are judged: of `MOST_POSES` poses where there are more."""
    return fit if fit.identification.data.n_poses <= MOST_POSES else _fit_of_sample(fit)


@memoize
def _fit_of_sample(fit: Fit) -> Fit:
    """The fit of `MOST_POSES` poses, one from each of equally long stretches; the fit itself where it cannot be made.

    A regular step could meet the same row of a grid again and again.
    """
    data = fit.identification.data
    ends = np.arange(MOST_POSES + 1) * data.n_poses // MOST_POSES
    poses = np.random.default_rng(fit.seed).integers(ends[:-1], ends[1:])
    try:
        sample = fit_of_a_part(fit, Settings(fit.sigma_given, fit.loss, seed=fit.seed))(
            data[np.isin(data.pose_numbers, poses)], None
        )
    except CalibrationError:
        return fit
    return replace(sample, terms=fit.terms)


@memoize
def setting(fit: Fit) -> EffectSetting:
    """Return the data from which effects are computed, of the judged poses."""
    return EffectSetting(sample_of_poses(fit))


@memoize
def linear(fit: Fit) -> LinearFit:
    """Return the fit of the judged poses as a linear model, for tests of effects."""
    fit = sample_of_poses(fit)
    rows, known = fit.weighted_rows, fit.statistics
    pose_freedom = np.inf if known.shared_scatter is None else known.shared_scatter.freedom
    return LinearFit(rows, rows.span, known.freedom, known.factors.common, pose_freedom, known.factors.confirmed)


@memoize
@one_blas_thread
def patterns(fit: Fit) -> tuple[Pattern, ...]:
    """Return the systematic patterns that were tested in the residuals, most significant first."""
    return () if fit.computed else residual_patterns.patterns(linear(fit), setting(fit))


@memoize
@one_blas_thread
def changes(fit: Fit) -> tuple[Pattern, ...]:
    """Return significant changes in the course of the measurement, tested beside effects that follow joint values.

    Where poses were measured in the order of their joint values, an error that follows a joint looks like a change.
    """
    in_course = [kind for kind in Kind if Trait.IN_COURSE in kind.traits]
    if not any(pattern.significant and pattern.kind in in_course for pattern in patterns(fit)):
        return ()
    columns = [
        effect.columns(number)
        for effect in effects(setting(fit))
        if Trait.FOLLOWS_JOINTS in effect.kind.traits
        for number in range(len(effect.details))
    ]
    model = linear(fit).with_parameters(np.hstack(columns)) if columns else linear(fit)
    return tuple(p for p in residual_patterns.patterns(model, setting(fit), in_course) if p.significant)


@memoize
@one_blas_thread
def budget(fit: Fit) -> ErrorBudget | None:
    """Return the error budget of the validation readings; of the judged poses if there are no validation readings.

    None if the robot cannot be assembled at a step between before and after.
    """
    return _budget(fit, causes_of(fit.robot))


@memoize
@one_blas_thread
def joint_budget(fit: Fit) -> ErrorBudget | None:
    """Return the error budget with the joints as causes; None in the same cases as `budget`."""
    return _budget(fit, joint_causes(fit.robot))


def _budget(fit: Fit, causes: Sequence[str]) -> ErrorBudget | None:
    try:
        return error_budget(sample_of_poses(fit) if fit.validation is None else fit, causes)
    except UnreachablePoseError:
        return None

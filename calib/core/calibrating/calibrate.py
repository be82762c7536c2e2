"""Calibration: a fit, its verdict, and further fits that the verdict requires.

Order of work: (1) joint terms, if requested, as large as readings show (`calib.core.fitting.terms.term_sizes`); a
section of the description, such as that on a fleet, is left out where the readings contradict it; (2) the fit
(`calib.core.fitting.fit`), already done in step 1 where no term was added, and without terms where the readings are too
few for those of `--terms auto`; (3) if requested, both again without outliers; (4) poses left out in turn for
cross-validation, if requested, or where noise is so far above its statement that nothing else can prove the result.

Outliers to leave out are found with a robust loss, so that they cannot hide behind each other. A single reading is left
out where the others of its visit agree, and a whole visit where they are off together (`calib.core.fitting.outliers`).
The rest is tested again after each fit, up to five times, because a gross error may have hidden others. Both results
are kept: that of all readings, and that without outliers.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from calib.core.base.errors import (
    CalibrationError,
    ComputationError,
    InputError,
    NotIdentifiableError,
    UnreachablePoseError,
)
from calib.core.base.registry import list_entry_points
from calib.core.base.threads import one_blas_thread
from calib.core.base.workers import Progress, Steps, Workers
from calib.core.data.measurements import Measurements
from calib.core.fitting.fit import Minimum, fit_at, fit_data, fit_of_a_part, minimum_of, unseen
from calib.core.fitting.fitted import Fit
from calib.core.fitting.likely_mistakes import likely_mistake, zeros_in_words
from calib.core.fitting.outliers import Outlier, readings_of_outliers
from calib.core.fitting.settings import Settings
from calib.core.fitting.terms.candidate_terms import TermChoice, missing_terms
from calib.core.fitting.terms.term_sizes import size_terms
from calib.core.fitting.validation import cross_validate, n_folds
from calib.core.judging import findings
from calib.core.judging.rules_noise import unproven
from calib.core.judging.verdict import JudgedFit
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import parse_terms

PROVING = 5
"""Number of folds if none is requested, and only cross-validation can prove the result."""
_OF_ONE_FIT = 3  # number of reported steps of a fit: base and targets placed, the minimum found, the verdict reached
_EXCLUSION_ROUNDS = 5


@one_blas_thread
def calibrate(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    executor: Executor | int | None = None,
    progress: Progress | None = None,
) -> JudgedFit:
    """Calibrate a robot.

    Args:
        validation: Measurements to validate the result with, or None.
        executor: Executor of the fits of other starts and of folds: any `concurrent.futures` executor, or a number of
            processes on this machine; this process if not given.
        progress: Function that is called after each step with the number of finished and of known steps. Steps are:
            base and targets placed, the minimum found, its uncertainty and errors known; the sizes of terms, with their
            own fit; each further start; each fold; each fit without outliers.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Too few measurements, or measurements that are not finite.
        InputError: An unknown term, a number of folds that makes no sense, or data that are no measurements.
        NotIdentifiableError: The poses do not determine the free parameters.
        NotConvergedError: Base and targets cannot be placed, or the noise cannot be found.
    """
    started = time.perf_counter()
    _require_measurements(data, validation)
    with Workers(executor, max(settings.starts - 1, n_folds(data, settings.folds))) as workers:
        fit = _run_steps(robot, data, validation, settings, workers, Steps(progress))
    return JudgedFit.from_fit(replace(fit, seconds=time.perf_counter() - started))


def _run_steps(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    workers: Executor | None,
    steps: Steps,
) -> Fit:
    n_steps = _OF_ONE_FIT + settings.starts - 1 + n_folds(data, settings.folds)
    n_steps += (_OF_ONE_FIT + 1) * (settings.terms == "auto")
    steps.expect(n_steps)

    def fit_readings(some: Measurements) -> Fit:
        fit_once = partial(_fit_with_terms, robot, some, validation, settings, workers, steps)
        try:
            return fit_once()
        except NotIdentifiableError:
            if settings.terms != "auto":
                raise
            steps.restart(n_steps)
            return fit_once(adds_terms=False)

    try:
        fit = fit_readings(data)
    except (UnreachablePoseError, ComputationError) as error:
        mistake = likely_mistake(robot, data) or zeros_in_words(data, robot)
        raise type(error)(f"{error}{'; ' if mistake else ''}{mistake}") from None
    plain = replace(settings, starts=1)
    if settings.exclude_outliers:

        def fit_kept(kept: Measurements) -> Fit:
            steps.expect(n_steps - n_folds(data, settings.folds))
            return fit_readings(kept)

        def fit_robustly() -> Fit:
            steps.expect(_OF_ONE_FIT)
            return fit_data(fit.nominal, replace(plain, loss="tukey"), data, validation, workers, steps)

        fit = _without_outliers(fit, fit_robustly, fit_kept)
    leave_out = partial(
        cross_validate, fit.identification.data, seed=settings.seed, fit=fit_of_a_part(fit, plain), executor=workers
    )
    if settings.folds:
        fit = replace(fit, folds=leave_out(settings.folds, progress=steps.advance))
    elif unproven(fit):
        steps.expect(PROVING)
        with suppress(CalibrationError):  # too few poses to leave some out: then nothing is proven
            fit = replace(fit, folds=leave_out(PROVING, progress=steps.advance))
    return fit


def _fit_with_terms(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    workers: Executor | None,
    steps: Steps,
    *,
    adds_terms: bool = True,
) -> Fit:
    """The fit with the requested joint terms; with `auto`, `adds_terms` says whether any may be added."""
    robot, choice, minimum = _with_terms(robot, data, validation, settings, steps, adds_terms)
    for entry in list_entry_points("calib.contradicted"):  # loaded only for a robot that has such a section
        if (section := getattr(robot.description, entry.name)) is not None:
            robot = entry.load()(robot, data, settings, section)
    if minimum is None or minimum.robot is not robot or settings.starts > 1 or unseen(robot, data, validation):
        minimum = minimum_of(robot, settings, data, validation, workers, steps)
    else:  # the fit without further terms is the minimum
        steps.advance()
        steps.advance()
    return replace(fit_at(minimum, settings, validation, steps), terms=choice)


def _with_terms(
    robot: Robot,
    data: Measurements,
    validation: Measurements | None,
    settings: Settings,
    steps: Steps,
    adds_terms: bool,
) -> tuple[Robot, TermChoice | None, Minimum | None]:
    """The robot with the requested joint terms; and its minimum, if it is known."""
    described, terms = robot.description.terms, settings.terms
    if terms is None:
        return robot, None, None
    if terms == "none":
        choice = TermChoice(terms, ())
    elif terms == "auto":
        first = replace(settings, starts=1)
        minimum = minimum_of(robot, first, data, validation, steps=steps)
        choice = size_terms(fit_at(minimum, first, steps=steps), adds_terms=adds_terms)
        steps.advance()
        if choice.sections == described:
            return robot, choice, minimum
    else:
        choice = TermChoice(terms, (*described, *missing_terms(robot, parse_terms(terms))))
    return robot.with_terms(choice.sections), choice, None


def _require_measurements(data: object, validation: object) -> None:
    """Raise an error that states the expected types, for callers without type checks."""
    for name, given in (("data", data), ("validation", validation)):
        if not isinstance(given, Measurements) and not (given is None and name == "validation"):
            raise InputError(
                f"{name}: expected Measurements, not {type(given).__name__}; make them with calib.read_measurements"
                " or calib.as_measurements"
            )


def _without_outliers(first: Fit, robust: Callable[[], Fit], again: Callable[[Measurements], Fit]) -> Fit:
    """Return the fit without outliers; `first` itself if there are none.

    Args:
        first: The fit of all readings.
        robust: Function that fits all readings with a robust loss.
        again: Function that fits some of the readings with the same options.
    """
    data = first.identification.data
    layout = first.rows.layout
    kept = {name: np.arange(len(readings)) for name, readings in data.readings.items()}
    excluded: list[Outlier] = []
    current = first if first.loss == "tukey" else robust()
    for _ in range(_EXCLUSION_ROUNDS):
        outliers = findings.outliers(current)
        if not outliers:
            break
        now = current.rows.layout
        for outlier in outliers:
            number = kept[outlier.target][outlier.reading - now.readings_of(outlier.target).start]
            own = data.readings[outlier.target].visits
            reading = layout.readings_of(outlier.target).start + int(number)
            excluded.append(replace(outlier, reading=reading, pose=int(own[number])))
        for name, gone in readings_of_outliers(outliers, now).items():
            left = np.delete(kept[name], gone)
            kept[name] = left[np.argsort(data.readings[name].visits[left], kind="stable")]  # by visits
        current = again(data.with_readings(kept))
    if not excluded:
        return first
    return replace(current, excluded=tuple(excluded), with_all=first)

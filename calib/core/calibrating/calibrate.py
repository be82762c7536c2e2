"""Calibration: a fit, its verdict, and further fits that the verdict requires.

Order of work: (1) joint terms, if requested, as large as readings show (`calib.core.fitting.terms.term_sizes`); a
section of the description, such as that on a fleet, is left out where the readings contradict it; (2) the fit
(`calib.core.fitting.fit`), already done in step 1 where no term was added; (3) if requested, both again without
outliers; (4) poses left out in turn for cross-validation, if requested, or where noise is so far above its statement
that nothing else can prove the result.

Outliers to leave out are found with a robust loss, so that they cannot hide behind each other. The rest is tested again
after each fit, up to five times, because a gross error may have hidden others.
"""

from __future__ import annotations

import time
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.core.base.errors import (
    CalibrationError,
    ComputationError,
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
    """Calibrate a robot; see `calib.fit`.

    Args:
        progress: Function that is called after each step with the number of finished and of known steps. Steps are:
            base and targets placed, the minimum found, its uncertainty and errors known; the sizes of terms, with their
            own fit; each further start; each fold; each fit without outliers.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Too few measurements, or measurements that are not finite.
        InputError: An unknown term, or a number of folds that makes no sense.
        NotIdentifiableError: The poses do not determine the free parameters.
        NotConvergedError: Base and targets cannot be placed, or the noise cannot be found.
    """
    started = time.perf_counter()
    folds = n_folds(data, settings.folds)
    with Workers(executor, max(settings.starts - 1, folds)) as workers:
        fit = _Calibration(robot, validation, settings, folds, workers, Steps(progress)).run(data)
    return JudgedFit.from_fit(replace(fit, seconds=time.perf_counter() - started))


@dataclass(frozen=True)
class _Calibration:
    """The order of work of one call."""

    robot: Robot
    validation: Measurements | None
    settings: Settings
    n_folds: int
    workers: Executor | None
    steps: Steps

    @property
    def n_steps(self) -> int:
        """Number of steps without folds."""
        return _OF_ONE_FIT + self.settings.starts - 1 + (_OF_ONE_FIT + 1) * (self.settings.terms == "auto")

    def run(self, data: Measurements) -> Fit:
        """Do all of it."""
        settings, steps = self.settings, self.steps
        steps.expect(self.n_steps + self.n_folds)
        try:
            fit = self.fit_readings(data)
        except (UnreachablePoseError, ComputationError) as error:
            mistake = likely_mistake(self.robot, data) or zeros_in_words(data, self.robot)
            raise type(error)(f"{error}{'; ' if mistake else ''}{mistake}") from None
        if settings.exclude_outliers:
            fit = self.without_outliers(fit)
        leave_out = partial(cross_validate, seed=settings.seed, fit=fit_of_a_part(fit, settings), executor=self.workers)
        if settings.folds:
            fit = replace(fit, folds=leave_out(fit.identification.data, settings.folds, progress=steps.advance))
        elif unproven(fit):
            steps.expect(PROVING)
            with suppress(CalibrationError):  # too few poses to leave some out: then nothing is proven
                fit = replace(fit, folds=leave_out(fit.identification.data, PROVING, progress=steps.advance))
        return fit

    def fit_readings(self, data: Measurements) -> Fit:
        """Fit some readings, without further terms where they are too few for those of `auto`."""
        try:
            return self.fit_with_terms(data)
        except NotIdentifiableError:
            if self.settings.terms != "auto":
                raise
            self.steps.restart(self.n_steps + self.n_folds)
            return self.fit_with_terms(data, adds_terms=False)

    def fit_with_terms(self, data: Measurements, *, adds_terms: bool = True) -> Fit:
        """Fit with the requested joint terms; with `auto`, `adds_terms` says whether any may be added."""
        settings, steps, validation = self.settings, self.steps, self.validation
        robot, choice, minimum = self.with_terms(data, adds_terms)
        for entry in list_entry_points("calib.contradicted"):  # loaded only for a robot that has such a section
            if (section := getattr(robot.description, entry.name)) is not None:
                robot = entry.load()(robot, data, settings, section)
        if minimum is None or minimum.robot is not robot or settings.starts > 1 or unseen(robot, data, validation):
            minimum = minimum_of(robot, settings, data, validation, self.workers, steps)
        else:  # the fit without further terms is the minimum
            steps.advance()
            steps.advance()
        return replace(fit_at(minimum, settings, validation, steps), terms=choice)

    def with_terms(self, data: Measurements, adds_terms: bool) -> tuple[Robot, TermChoice | None, Minimum | None]:
        """Return the robot with the requested joint terms; and its minimum, if it is known."""
        robot, terms = self.robot, self.settings.terms
        if terms is None:
            return robot, None, None
        if terms == "none":
            choice = TermChoice(terms, ())
        elif terms == "auto":
            first = replace(self.settings, starts=1)
            minimum = minimum_of(robot, first, data, self.validation, steps=self.steps)
            choice = size_terms(fit_at(minimum, first, steps=self.steps), adds_terms=adds_terms)
            self.steps.advance()
            if choice.sections == robot.description.terms:
                return robot, choice, minimum
        else:
            choice = TermChoice(terms, (*robot.description.terms, *missing_terms(robot, parse_terms(terms))))
        return robot.with_terms(choice.sections), choice, None

    def without_outliers(self, first: Fit) -> Fit:
        """Return the fit without the outliers of the fit of all readings; that one itself if there are none."""
        data, layout, current = first.identification.data, first.rows.layout, first
        kept = {name: np.arange(len(readings)) for name, readings in data.readings.items()}
        excluded: list[Outlier] = []
        if first.loss != "tukey":
            self.steps.expect(_OF_ONE_FIT)
            robust = replace(self.settings, starts=1, loss="tukey")
            current = fit_data(first.nominal, robust, data, self.validation, self.workers, self.steps)
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
            self.steps.expect(self.n_steps)
            current = self.fit_readings(data.with_readings(kept))
        return replace(current, excluded=tuple(excluded), with_all=first) if excluded else first

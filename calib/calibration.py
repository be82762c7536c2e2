"""The fit that users hold: it reports on itself and saves itself. Everything below knows only plain functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from calib import pictures
from calib.core.base.errors import InputError
from calib.core.base.units import ERROR_UNIT, sigma_in_si
from calib.core.base.words import html_with_title, listing
from calib.core.base.workers import Progress, Workers
from calib.core.calibrating.calibrate import calibrate
from calib.core.calibrating.file_robots import with_files
from calib.core.data.in_memory import MeasurementsLike, as_measurements, with_sigma
from calib.core.fitting.error_sets import Folds, error_table
from calib.core.fitting.fit import fit_of_a_part
from calib.core.fitting.settings import RequestedOptions, Settings
from calib.core.fitting.validation import cross_validate, n_folds
from calib.core.instruments.kind import Readings
from calib.core.judging.verdict import JudgedFit
from calib.core.numerics.losses import find_loss
from calib.core.results.loaded_result import CalibratedRobot
from calib.core.results.report_text import summary, text_report, verdict_lines
from calib.core.results.results import save, to_dict
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.terms.terms import terms_text
from calib.pictures import Plots

if TYPE_CHECKING:
    from calib.studies.study_result import Study


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(JudgedFit, CalibratedRobot):
    """A finished fit, with verdict, reports and files; `calib.core.fitting.fitted.Fit` lists what it holds."""

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        errors: list[dict[str, object]] = [
            {
                "rows": label,
                "state": state,
                "instrument": instrument.name,
                "part": part.name,
                "unit": ERROR_UNIT[part.dimension],
            }
            | {key: value for key, value in error_table(values[:, rows], part).items() if isinstance(value, float)}
            for label, error_set in self.error_sets.items()
            for state, residuals in (("before", error_set.before), ("after", error_set.after))
            for instrument, part, rows in error_set.parts()
            for values in (residuals[instrument.name],)
        ]
        return html_with_title(self.nominal.name, verdict_lines(self.verdict), errors, self.parameters.rows())

    @property
    def plot(self) -> Plots:
        """Figures of the fit as matplotlib axes: `plot.errors()`, `plot.by_pose()` and others.

        Raises:
            InputError: Nothing that draws is installed, or something that it needs is missing.
        """
        return pictures.plots(self)

    def report(self, *, verbose: bool = False) -> str:
        """Return the result as text.

        Args:
            verbose: Whether to return everything; otherwise the answer on one screen.
        """
        return text_report(self, verbose=verbose)

    def summary(self) -> str:
        """Return the verdict with its reasons and the accuracy before and after, as text; `report` has the rest."""
        return summary(self)

    def to_dict(self) -> dict[str, object]:
        """Return everything that was found, in mm and degrees: the content of `result.json`."""
        return to_dict(self)

    def cross_validate(
        self,
        folds: int | Literal["setups"] = 5,
        *,
        seed: int = 0,
        executor: Executor | int | None = None,
        progress: Progress | None = None,
    ) -> Folds:
        """Predict each part of the poses by a fit of the other parts.

        Args:
            folds: Number of parts, by pose; or `setups`: every setup is a part, placed anew.
            seed: Seed of the random choice.
            executor: Executor of the fits; as in `fit`.
            progress: Called after each part with the number of finished parts, and the number of all parts.

        Returns:
            The errors of all poses, each predicted by a fit that did not use it; `.rms` of each part [m].

        Raises:
            InputError: The number of folds is not valid.
            CalibrationError: As `fit`, with fewer poses.
        """
        data = self.identification.data
        fold = fit_of_a_part(self, Settings(self.sigma_given, self.loss, seed=seed))
        with Workers(executor, n_folds(data, folds)) as workers:
            return cross_validate(data, folds, seed, fold, workers, progress)

    def bootstrap(
        self,
        draws: int = 200,
        *,
        seed: int = 0,
        executor: Executor | int | None = None,
        progress: Progress | None = None,
    ) -> Study:
        """Fit poses that are drawn with replacement, as many as there are, `draws` times.

        Args:
            draws: Number of fits.
            seed: Seed of the random choice.
            executor: Executor of the fits; as in `fit`.
            progress: Called with the number of draws done and of all draws.

        Returns:
            How far every parameter scatters, compared with the standard deviation that fits claim
            (`Study.to_dataframe`); see `calib.study`.

        Raises:
            InputError: The number of draws is not valid.
            CalibrationError: As `calib.study`.
        """
        from calib.studies.study import study  # here: who only fits needs no studies

        return study(
            self.nominal,
            self.identification.data,
            draws=draws,
            resample=True,
            sigma=self.sigma_given,
            loss=self.loss,
            seed=seed,
            executor=executor,
            progress=progress,
        )

    def save(
        self, folder: Path | str, *, force: bool = False, pages: bool = True, logo: Path | str | None = None
    ) -> None:
        """Write the result to a folder, report and viewer with it; see `calib.core.results.results.save`.

        Args:
            folder: Folder to write.
            force: Export a failed fit all the same, and replace files that this program did not write.
            pages: Whether to write report.html and viewer.html.
            logo: PNG, JPEG or SVG file to put into the report.
        """
        save(self, folder, force=force, pages=pictures.pages(self, logo) if pages else {})


def fit(
    robot: RobotLike,
    data: MeasurementsLike | ArrayLike,
    readings: ArrayLike | Mapping[str, ArrayLike | Readings] | None = None,
    *,
    validation: MeasurementsLike | float | None = None,
    sigma: float | str | ArrayLike | None = None,
    loss: str = "none",
    exclude_outliers: bool = False,
    starts: int = 1,
    folds: int | Literal["setups"] = 0,
    seed: int = 0,
    terms: str | Sequence[str] | None = None,
    fix: str | Sequence[str] = (),
    free: str | Sequence[str] = (),
    prior: Mapping[str, str] | None = None,
    executor: Executor | int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot; see `calib.core.fitting.fit` for the method, `calib.core.calibrating.calibrate` for its
    errors.

    Args:
        robot: The nominal robot; or its description or URDF.
        data: Measurements to identify with; a file or a data frame of them, as `read_measurements` reads it; or a list
            of these. Or, with `readings`, joint values (n, n_actuated) [m or rad].
        readings: Readings at these joint values, as in `as_measurements`, such as positions (n, 3) [m].
        validation: Measurements to validate the result with, in the same forms; or the part of the poses to hold out,
            between 0 and 1.
        sigma: Standard deviation of measured positions per axis, in place of what the description states: a number [m],
            text such as `0.04 mm`, or one for each row of `data`, (n,) or (n, 3) [m]. Where neither states it, it is
            found from the residuals.
        loss: `none`, or a robust loss: `huber`, `cauchy`, `tukey`.
        exclude_outliers: Leave outliers out and fit again; the result holds both fits. A reading is left
            out alone if the others of its visit agree; if more than half of them are off, the whole visit is left out.
        starts: Number of starting points, the nominal one and perturbed ones.
        folds: Number of folds for cross-validation by pose, 0 for none; `setups`: every setup is one, placed anew.
        seed: Seed of perturbed starts, of folds, and of what is held out.
        terms: Joint terms in place of those of the description: `none`; or in addition to them: `auto` for those that
            predict left-out poses better, or a list such as `curve,elbow=backlash` or `["curve", "elbow=backlash"]`.
        fix: Parameters to leave as they are, in addition to those that the description holds; `all`: every
            parameter except unknown places of base and targets.
        free: Parameters to fit although the description or `fix="all"` holds them.
        prior: Expected errors of parameters, one standard deviation with its unit by name, such as
            `0.1 mm`.
        executor: Executor of the fits of other starts and of folds: any `concurrent.futures` executor, or a number of
            processes on this machine; this process if not given.
        progress: Called after each step with the number of steps done and of all steps known so far: three in a plain
            fit, one more for each start and each fold.
    """
    robot = _with_free(as_robot(robot).fix(fix), free)
    for name, how_far in (prior or {}).items():
        robot = robot.with_prior(name, how_far)
    used, held = as_measurements(robot, data, readings), None
    one_for_all = sigma if sigma is None or isinstance(sigma, (float, str)) or np.ndim(sigma) == 0 else None
    if sigma is not None and one_for_all is None:
        used = with_sigma(robot, used, sigma)
    used = used.read_visits()
    if isinstance(validation, (float, int)):
        used, held = used.split(validation=validation, seed=seed)
    elif validation is not None:
        held = as_measurements(robot, validation).read_visits()
    settings = Settings(
        sigma_in_si(cast("float | str | None", one_for_all)),
        find_loss(loss),
        exclude_outliers,
        starts,
        folds,
        seed,
        None if terms is None else terms_text(terms),
    )
    fitted = with_files(calibrate(robot, used, held, settings, executor, progress), settings, executor)
    fixed, freed = ((given,) if isinstance(given, str) else tuple(given) for given in (fix, free))
    apart = f"{validation:g}" if isinstance(validation, (float, int)) else ""
    apart = str(validation) if isinstance(validation, (str, Path)) else apart
    return Calibration.from_fit(
        replace(fitted, requested_options=RequestedOptions(fixed, freed, dict(prior or {}), apart, folds))
    )


def _with_free(robot: Robot, free: str | Sequence[str]) -> Robot:
    """The robot with these parameters free; `InputError` if all of them are free already."""
    freed = robot.free(free)
    if len(free) and bool(np.all(freed.is_free == robot.is_free)):
        names = free if isinstance(free, str) else listing(free)
        raise InputError(f"free: {names}: free already; to fit nothing else, also give fix='all'")
    return freed

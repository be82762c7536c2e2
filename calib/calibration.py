"""What users hold: a fit that reports on itself and saves itself. Everything below knows only plain functions."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from calib import pictures
from calib.base.units import ERROR_UNIT
from calib.base.words import titled_html
from calib.base.workers import Progress
from calib.calibrating.calibrate import calibrate
from calib.calibrating.file_robots import with_files
from calib.data.measurements import Measurements
from calib.fitting.error_sets import error_table
from calib.fitting.settings import Settings
from calib.joint_terms.terms import terms_text
from calib.judging.judged_fit import JudgedFit
from calib.numerics.losses import checked_loss
from calib.pictures import Plots
from calib.reporting.report_text import text_report, verdict_lines
from calib.reporting.result_content import error_sets
from calib.reporting.results import save
from calib.robots.robot import Robot, require_robot


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(JudgedFit):
    """A finished fit for users: see `calib.fitting.fitted.Fit` for what it holds, `JudgedFit` for what it is worth."""

    def __str__(self) -> str:
        return self.report()

    def _repr_html_(self) -> str:
        errors: list[dict[str, object]] = [
            {
                "rows": label,
                "state": state,
                "instrument": one.name,
                "part": part.name,
                "unit": ERROR_UNIT[part.dimension],
            }
            | {key: value for key, value in error_table(values[:, rows], part).items() if isinstance(value, float)}
            for label, found in error_sets(self)
            for state, residuals in (("before", found.before), ("after", found.after))
            for one, part, rows in found.parts()
            for values in (residuals[one.name],)
        ]
        return titled_html(self.nominal.name, verdict_lines(self.verdict), errors, self.parameters.rows())

    @property
    def plot(self) -> Plots:
        """Its figures as matplotlib axes: `plot.errors()`, `plot.by_pose()` and others.

        Raises:
            InputError: Nothing that draws is installed, or something that it needs is missing.
        """
        return pictures.plots(self)

    def report(self, *, verbose: bool = False) -> str:
        """Return the result as text.

        Args:
            verbose: Everything; otherwise the answer on one screen.
        """
        return text_report(self, verbose=verbose)

    def save(
        self, folder: Path | str, *, force: bool = False, pages: bool = True, logo: Path | str | None = None
    ) -> None:
        """Write the result to a folder, report and viewer with it; see `calib.reporting.results.save`.

        Args:
            folder: Where to.
            force: Export a failed fit all the same, and replace files that this program did not write.
            pages: Whether to write report.html and viewer.html.
            logo: PNG, JPEG or SVG file to put into the report.
        """
        save(self, folder, force=force, pages=pictures.pages(self, logo) if pages else {})


def fit(
    robot: Robot,
    data: Measurements,
    *,
    validation: Measurements | None = None,
    sigma: float | None = None,
    loss: str = "none",
    exclude_outliers: bool = False,
    starts: int = 1,
    folds: int | Literal["setups"] = 0,
    seed: int = 0,
    terms: str | Sequence[str] | None = None,
    executor: Executor | int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a robot; see `calib.fitting.fit` for the method, `calib.calibrating.calibrate` for its errors.

    Args:
        robot: The nominal robot.
        data: Measurements to identify with.
        validation: Measurements to judge the result with.
        sigma: Standard deviation of measured positions per axis [m], in place of what the description states.
        loss: `none`, or a robust loss: `huber`, `cauchy`, `tukey`.
        exclude_outliers: Leave outliers out and fit again.
        starts: Number of starting points.
        folds: Number of folds for cross-validation by pose, 0 for none; `setups`: every setup is one, placed anew.
        seed: Seed of perturbed starts and folds.
        terms: Joint terms in place of those of the description: `none`; or in addition to them: `auto` for those that
            earn their place, or a list such as `curve,elbow=backlash` or `["curve", "elbow=backlash"]`.
        executor: Who does the fits of other starts and of folds: any `concurrent.futures` executor, or a number of
            processes on this machine; this process if not given.
        progress: Called after each step with how many are done, and of how many that are known by then; three steps in
            a plain fit, one more for each start and each fold.
    """
    require_robot(robot)
    named = None if terms is None else terms_text(terms)
    settings = Settings(sigma, checked_loss(loss), exclude_outliers, starts, folds, seed, named)
    found = with_files(calibrate(robot, data, validation, settings, executor, progress), settings, executor)
    return Calibration.of(found)

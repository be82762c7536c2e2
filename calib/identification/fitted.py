"""A finished fit: what was found, and what follows from it on request (outliers, patterns, verdict, uncertainty)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.data.measurements import Measurements
from calib.identification.starts import Starts
from calib.identification.systematic import Pattern, Residuals, patterns
from calib.identification.validation import error_table
from calib.linearisation.determination import Determination
from calib.linearisation.prediction import PositionUncertainty, carried, position_uncertainty
from calib.model.mechanism import BoolArray, FloatArray
from calib.model.robot import Configurations, Robot
from calib.numerics.identifiability import Rank
from calib.numerics.losses import Loss
from calib.numerics.outliers import Outlier, Studentised, outliers, studentised
from calib.numerics.statistics import EXACT, ChiSquare, Statistics, chi_square, prior_shares
from calib.read_only import ReadOnlyArrays
from calib.threads import one_blas_thread

if TYPE_CHECKING:
    from calib.identification.folds import Folds
    from calib.identification.reasons import Verdict

COMPUTED = 1e-7
"""Noise below this [m], and below a hundredth of what was stated, is what priors leave of data without noise."""


@dataclass(frozen=True, eq=False)
class ErrorSet(ReadOnlyArrays):
    """Predicted minus measured positions of one set of poses.

    Attributes:
        data: The measurements.
        before, after: Errors before and after calibration, (n_poses, n_targets, 3) [m].
        singular_value: Each pose's distance to a singularity of the loops; infinite without loops, (n_poses,).
    """

    data: Measurements
    before: FloatArray
    after: FloatArray
    singular_value: FloatArray

    def table(self) -> dict[str, dict[str, object]]:
        """Return the error tables `before` and `after` [mm]."""
        return {"before": error_table(self.before.reshape(-1, 3)), "after": error_table(self.after.reshape(-1, 3))}


@dataclass(frozen=True)
class Convergence:
    """How the iteration ended.

    Attributes:
        converged: Whether the solver met a stopping rule, robust weights stand, and no step is left.
        message: What the solver said.
        step_left: Largest Gauss-Newton step left, over the standard deviation of its parameter.
        parameter: That parameter.
        weights_stand: Whether the weights of a robust loss have settled; True without one.
    """

    converged: bool
    message: str
    step_left: float
    parameter: str
    weights_stand: bool


@dataclass(frozen=True, eq=False)
class Fit(ReadOnlyArrays):
    """A finished identification.

    Attributes:
        nominal: The robot as described.
        placed: The robot `before`: nominal, with base and targets placed where these are not known.
        robot: The calibrated robot.
        identification: Errors on the poses that were used.
        validation: Errors on poses that were not used, if there were any.
        configurations: The assembled poses of `identification`, at the solution.
        free: Which parameters were free, (n_parameters,).
        statistics: Uncertainty of the free ones.
        determination: What poses and priors determine, at `placed`: as `calib check` tells.
        observability: O1 to O5 on scaled columns.
        jacobian: d(positions)/d(free parameters) at the solution, (n_poses, n_targets, 3, n_free).
        sigma_stated: Noise as stated [m], or None.
        message: What the solver said.
        seconds: Duration of the whole computation.
        convergence: How the iteration ended.
        sigma_used: Noise that weighed measurements against priors [m].
        loss: Robust loss.
        weights: Weight of each point, (n_poses, n_targets); 1 without a robust loss.
        starts: Ends of perturbed starts, if they were asked for.
        folds: Cross-validation, if it was asked for.
        excluded: Outliers that were left out, as they were in `with_all`.
        with_all: The fit of all poses, where outliers were left out of this one.
        seed: Seed of every random choice.
    """

    nominal: Robot
    placed: Robot
    robot: Robot
    identification: ErrorSet
    validation: ErrorSet | None
    configurations: Configurations
    free: BoolArray
    statistics: Statistics
    determination: Determination
    observability: dict[str, float]
    jacobian: FloatArray
    sigma_stated: float | None
    message: str
    seconds: float
    convergence: Convergence
    sigma_used: float
    loss: Loss
    weights: FloatArray
    starts: Starts | None = None
    folds: Folds | None = None
    excluded: tuple[Outlier, ...] = ()
    with_all: Fit | None = None
    seed: int = 0

    @property
    def converged(self) -> bool:
        """Whether the iteration reached a minimum."""
        return self.convergence.converged

    @property
    def rank(self) -> Rank:
        """Rank of the free parameters, from the poses alone."""
        return self.determination.free

    @property
    def rank_all(self) -> Rank:
        """Rank of all parameters, held ones included, from the poses alone."""
        return self.determination.everything

    @property
    def free_names(self) -> list[str]:
        """Names of the free parameters."""
        return [p.name for p, use in zip(self.nominal.parameters, self.free, strict=True) if use]

    @property
    def chi_square(self) -> ChiSquare | None:
        """The stated noise against the residuals; None where none was stated."""
        if self.sigma_stated is None:
            return None
        return chi_square(self.statistics.sigma, self.statistics.freedom, self.sigma_stated)

    @property
    def computed(self) -> bool:
        """Whether the data were computed, not measured: no noise, or none beside what was stated to weigh priors."""
        found = self.statistics.sigma
        return found < EXACT or (
            found < COMPUTED and self.sigma_stated is not None and found < 0.01 * self.sigma_stated
        )

    @cached_property
    def assembles(self) -> bool:
        """Whether the calibrated robot can be assembled at all its poses, starting from its home configuration."""
        return bool(np.all(self.robot.close(self.configurations.actuated).ok))

    def uncertainty(self, q: FloatArray) -> PositionUncertainty:
        """Predict positions at actuated joints q (n, n_actuated) [m or rad], with their covariance."""
        found = self.statistics
        return position_uncertainty(self.robot, self.free, found.covariance, found.coverage_factor, q)

    @cached_property
    def identification_uncertainty(self) -> PositionUncertainty:
        """Predicted positions of the poses that were used, with their covariance."""
        spread = carried(self.jacobian, self.statistics.covariance)
        found = self.identification
        return PositionUncertainty(found.data.positions + found.after, spread, self.statistics.coverage_factor)

    @cached_property
    def validation_uncertainty(self) -> PositionUncertainty | None:
        """Predicted positions of the poses that were not used, with their covariance."""
        return None if self.validation is None else self.uncertainty(self.validation.data.joints)

    @cached_property
    def studentised(self) -> Studentised:
        """Every point that was used, judged; see `calib.numerics.outliers`."""
        readings = np.sqrt(self.identification.data.counts)[:, None, None]
        columns = readings[..., None] * self.jacobian * self._scales
        residuals = readings * self.identification.after
        return studentised(residuals, columns, self._inverse, self.weights, self.statistics.freedom)

    @cached_property
    def outliers(self) -> tuple[Outlier, ...]:
        """Points that were used and lie further off than noise explains, worst first."""
        found = self.identification
        return outliers(self.studentised, found.after, found.data.labels, self.robot.target_names)

    @cached_property
    def validation_outliers(self) -> tuple[Outlier, ...]:
        """Points that were not used and lie further off than noise and uncertainty explain, worst first."""
        if self.validation is None or self.validation_uncertainty is None:
            return ()
        found, sigma = self.validation, max(self.statistics.sigma, 1e-30)
        readings = np.sqrt(found.data.counts)[:, None, None]
        root = np.linalg.cholesky(self.validation_uncertainty.covariance / sigma**2 + 1e-12 * np.eye(3))
        judged = studentised(
            readings * found.after,
            readings[..., None] * root,
            np.eye(3),
            np.zeros(found.after.shape[:2]),
            self.statistics.freedom,
            self.studentised.scale,
        )
        return outliers(judged, found.after, found.data.labels, self.robot.target_names)

    @cached_property
    @one_blas_thread
    def patterns(self) -> tuple[Pattern, ...]:
        """Systematic patterns that were looked for in the residuals, most significant first."""
        if self.computed:
            return ()
        data = self.identification.data
        weight = np.sqrt(data.counts[:, None] * self.weights)
        rows = (weight[:, :, None] * self.identification.after).reshape(-1)
        columns = (weight[:, :, None, None] * self.jacobian * self._scales).reshape(len(rows), -1)
        model = Residuals(rows, columns, self._inverse, self.statistics.freedom, self.statistics.sigma)
        return patterns(model, self.robot, self.configurations, data.approach_directions, weight)

    # Three shortcuts for users; what they call knows `Fit`, and is imported when it is called.

    @cached_property
    def verdict(self) -> Verdict:
        """PASS, CHECK or FAIL, with reasons."""
        from calib.identification.verdict import judge

        return judge(self)

    def report(self) -> str:
        """Return the result as text."""
        from calib.reporting.report_text import text_report

        return text_report(self)

    def save(self, folder: Path | str, *, force: bool = False) -> None:
        """Write the result to a folder; see `calib.reporting.results.save`."""
        from calib.reporting.results import save

        save(self, folder, force=force)

    @cached_property
    def _scales(self) -> FloatArray:
        return np.array([p.sigma for p, use in zip(self.nominal.parameters, self.free, strict=True) if use])

    @cached_property
    def _inverse(self) -> FloatArray:
        """R^-1 of `calib.numerics.statistics.prior_shares` at the solution, with the weights of a robust loss."""
        data = self.identification.data
        weight = np.sqrt(data.counts[:, None] * self.weights)
        columns = (weight[:, :, None, None] * self.jacobian * self._scales).reshape(-1, self.jacobian.shape[-1])
        has_prior = np.array([p.prior for p, use in zip(self.nominal.parameters, self.free, strict=True) if use])
        return prior_shares(columns, has_prior, self.sigma_used)[0]

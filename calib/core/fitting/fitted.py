"""A finished fit: its results, and quantities that follow from them alone. `calib.core.judging` gives its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution, Contributions, Uncertainty, contributions_to
from calib.core.base.other_words import HintedObject
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.fitting.error_sets import Errors, ErrorSet, Folds, Residuals
from calib.core.fitting.estimates import Correlation, Covariance, Estimates, estimates
from calib.core.fitting.outliers import Outlier
from calib.core.fitting.regions import Regions, disagreeing
from calib.core.fitting.settings import RequestedOptions
from calib.core.fitting.starts import Starts
from calib.core.fitting.terms.candidate_terms import TermChoice
from calib.core.fitting.unexplained import UnexplainedErrors, unexplained_errors
from calib.core.numerics.chances import EXACT
from calib.core.numerics.identifiability import Rank
from calib.core.numerics.losses import Loss
from calib.core.numerics.statistics import ChiSquare, Statistics, chi_square
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.configurations import Configurations
from calib.core.robots.loops import reached_from_home
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context
from calib.core.rows.determination import Determination
from calib.core.rows.observed import observe
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty, UndecidedTerms
from calib.core.rows.reported_uncertainty import ReportedUncertainty
from calib.core.rows.rows import Group, Rows, Scales
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import Whitening

COMPUTED = 1e-7
"""Noise below this [SI] and below a hundredth of the statement is the effect of priors on data without noise."""


@dataclass(frozen=True)
class Convergence:
    """End of the iteration.

    Attributes:
        converged: Whether the weights of a robust loss have settled, and `step_left` is small enough.
        message: The rule that ended it, or the step left if that shows that it has not converged.
        step_left: Largest Gauss-Newton step left, over the standard deviation of its parameter.
        parameter: The parameter of that step.
        has_settled_weights: Whether the weights of a robust loss have settled; True without one.
        receding_parameters: Parameters whose best values recede, the farthest first: the data do not determine them.
    """

    converged: bool
    message: str
    step_left: float
    parameter: str
    has_settled_weights: bool
    receding_parameters: tuple[str, ...] = ()


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise of one group of rows.

    Attributes:
        sigma: Found standard deviation of one component, typically [SI].
        stated: Stated standard deviation [SI], or None.
        freedom: Degrees of freedom of `sigma`.
    """

    group: Group
    sigma: float
    stated: float | None
    freedom: float


@dataclass(frozen=True, eq=False, repr=False)
class Fit(ReadOnlyArrays, HintedObject):
    """A finished identification.

    Attributes:
        nominal: The robot as described.
        placed: The robot `before`: nominal, with unknown base and targets placed.
        robot: The calibrated robot.
        identification: Errors on the visits that were used.
        validation: Errors on visits that were not used, if there were any.
        configurations: The assembled visits of `identification`, at the solution.
        unknowns: The free parameters.
        statistics: Uncertainty of the free parameters.
        determination: Ranks of poses and priors at `placed`, as in `calib check`.
        observability: O1 to O5 on scaled columns.
        rows: Whitened residuals and Jacobian at the solution, without the weights of a robust loss.
        whitening: Whitening of the rows.
        scales: Assumed scales of the noise.
        seconds: Duration of the whole computation.
        convergence: How the iteration ended.
        loss: Robust loss.
        weights: Weight of each reading, (n_readings,); 1 without a robust loss.
        sigma_given: Noise of positions that replaced the stated one [m], or None.
        starts: Ends of perturbed starts, if requested.
        folds: Cross-validation, if requested.
        excluded: Outliers that were left out, as they were in `with_all`.
        with_all: The fit of all visits, where outliers were left out of this one.
        terms: Requested joint terms, if any, and the result of choosing them.
        reduced: Fits of the same measurements without the joint terms that a kind of file cannot hold, by kind; None if
            no files were requested.
        seed: Seed of every random choice.
        placed_later: Parameters of places that only the validation poses show, and therefore placed.
        requested_options: Further options of the fit.
    """

    _other_words = "a fit"

    nominal: Robot
    placed: Robot
    robot: Robot
    identification: ErrorSet
    validation: ErrorSet | None
    configurations: Configurations
    unknowns: Unknowns
    statistics: Statistics
    determination: Determination
    observability: dict[str, float]
    rows: Rows
    whitening: Whitening
    scales: Scales
    seconds: float
    convergence: Convergence
    loss: Loss
    weights: FloatArray
    sigma_given: float | None
    starts: Starts | None = None
    folds: Folds | None = None
    excluded: tuple[Outlier, ...] = ()
    with_all: Fit | None = None
    terms: TermChoice | None = None
    reduced: Mapping[Holds, Fit] | None = None
    seed: int = 0
    placed_later: tuple[str, ...] = ()
    requested_options: RequestedOptions = field(default_factory=RequestedOptions)

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} of '{self.nominal.name}': {self.identification.data.n_poses} poses,"
            f" {len(self.unknowns)} free parameters>"
        )

    def _own_parameters(self) -> tuple[str, ...]:
        return self.free_names

    @property
    def converged(self) -> bool:
        """Whether the iteration reached a minimum."""
        return self.convergence.converged

    @property
    def message(self) -> str:
        """End of the iteration."""
        return self.convergence.message

    @property
    def rank(self) -> Rank:
        """Rank of the free parameters, from the poses alone."""
        return self.determination.free

    @property
    def rank_all(self) -> Rank:
        """Rank of all parameters, held ones included, from the poses alone."""
        return self.determination.everything

    @property
    def free(self) -> BoolArray:
        """Mask of the free parameters, (n_parameters,)."""
        return np.isin(np.arange(len(self.nominal.parameters)), self.unknowns.index)

    @cached_property
    def parameters(self) -> Estimates:
        """Estimates of the parameters by name: in the unit of each, and in m or rad as `..._si`."""
        known = self.statistics.widen(self.interval_factor)
        if self.undecided is not None:
            known = known.with_more(np.sum(self.undecided.sensitivity_of(self.free_names) ** 2, axis=1))
        by_name = estimates(self.nominal.parameters, self.robot.values, self.free, known)
        later = {name: replace(by_name[name], status="placed") for name in self.placed_later}
        return Estimates({**by_name, **later}, self.contains(Uncertainty.INTERVAL))

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of the free parameters, by name.

        It omits joint terms that `--terms auto` left undecided; intervals of parameters include them.
        """
        values = self.interval_factor**2 * self.statistics.covariance
        return Covariance(self.free_names, values, self.contains(Uncertainty.COVARIANCE))

    @cached_property
    def regions(self) -> Regions | None:
        """Regions that disagree on the parameters; None if they agree."""
        if self.computed:
            return None
        depths = self.robot.mechanism.depths
        return disagreeing(self.identification.data, depths, self.weighted_rows, self.statistics)

    def contains(self, number: Uncertainty) -> Contributions:
        """Return the contributions that a measure of uncertainty of this fit contains.

        The uncertainty of positions adds its own contribution if it is reported in another frame.
        """
        has: dict[Contribution, Callable[[], object]] = {
            Contribution.OFFSETS: lambda: np.any(self.scales.ratios),
            Contribution.SCATTER: lambda: self.statistics.shared_scatter is not None,
            Contribution.SIZES: lambda: np.any(self.unknowns.family >= 0),
            Contribution.REGIONS: lambda: self.interval_factor > 1.0,
            Contribution.UNDECIDED: lambda: self.undecided is not None,
            Contribution.JOINT_ERRORS: lambda: self.joint_error > 0.0,
            Contribution.FRAME: lambda: False,
        }
        return frozenset(own for own in contributions_to(number) if own not in has or has[own]())

    @property
    def interval_factor(self) -> float:
        """Factor by which intervals and the uncertainty of positions are wider than from noise alone."""
        return 1.0 if self.regions is None else self.regions.ratio

    @property
    def correlation(self) -> Correlation:
        """Correlation of the free parameters, by name, between -1 and 1."""
        return self.covariance.correlation

    def to_dataframe(self) -> Any:
        """Return all parameters as a pandas table, in the units of tables; pandas missing is an `InputError`."""
        return self.parameters.to_dataframe()

    @property
    def rms(self) -> float:
        """Root mean square error after calibration [m; rad or px where no positions are measured].

        It is the error at unused poses, if there are any: those of the validation, else those of cross-validation. With
        neither it is the error at the used poses, which is smaller than elsewhere. `errors` has them all.
        """
        folds = None if self.folds is None else self.folds.errors
        return (self.validation or folds or self.identification).rms("after")

    @property
    def errors(self) -> dict[str, dict[str, dict[str, object]]]:
        """Errors `before` and `after` of `identification`, `validation` and `cross_validation`, as far as these exist.

        In mm for positions, as in `result.json`: `errors["validation"]["after"]["rms"]`.
        """
        sets = {"identification": self.identification, "validation": self.validation}
        sets["cross_validation"] = None if self.folds is None else self.folds.errors
        return Errors({name: error_set.table() for name, error_set in sets.items() if error_set is not None})

    @property
    def residuals(self) -> dict[str, FloatArray]:
        """Predicted minus read after calibration, of each instrument, (n_readings, n_rows) [SI]."""
        return Residuals(self.identification.after)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.unknowns.names

    @cached_property
    def noise(self) -> tuple[NoiseEstimate, ...]:
        """Noise of each group of rows, found and stated."""
        factors, totals = self.statistics.factors, self.whitening.totals(self.scales)
        return tuple(
            NoiseEstimate(
                group,
                float(factors.values[g] * totals[g] * group.typical),
                group.typical if group.stated else None,
                float(factors.freedom[g]),
            )
            for g, group in enumerate(self.whitening.groups)
        )

    @property
    def first_noise(self) -> NoiseEstimate:
        """Noise of measured positions; of the first group of rows if no positions are measured."""
        return next((estimate for estimate in self.noise if estimate.group.part.is_position), self.noise[0])

    @property
    def sigma(self) -> float:
        """Found noise of one measured position per axis [m]; of the first kind of rows without positions [SI]."""
        return self.first_noise.sigma

    @property
    def sigma_stated(self) -> float | None:
        """Stated noise of the rows of `sigma`, or None."""
        return self.first_noise.stated

    @property
    def offsets(self) -> dict[str, FloatArray]:
        """Size of the error that readings of one pose share, as the weights assume, (n_rows,) [SI] by instrument."""
        if not np.any(self.scales.ratios):
            return {}
        instruments = self.robot.instruments
        sizes = self.scales.ratios * self.whitening.offset_scale(self.scales.groups)
        ends = np.cumsum([instrument.n_rows for instrument in instruments])[:-1]
        parts = zip(instruments, np.split(sizes, ends), strict=True)
        return {instrument.name: part for instrument, part in parts if np.any(part > 0)}

    @property
    def chi_square(self) -> ChiSquare | None:
        """The stated noise against the residuals; None where some noise was not stated."""
        if not all(group.stated for group in self.whitening.groups):
            return None
        factors = self.statistics.factors
        factor = factors.values * self.whitening.totals(self.scales)
        mean_square = float(np.sum(factors.freedom * factor**2) / factors.total_freedom)
        return chi_square(float(np.sqrt(mean_square)), factors.total_freedom)

    @property
    def computed(self) -> bool:
        """Whether the data were computed, not measured: without noise, or with far less than stated."""
        return all(
            estimate.sigma < EXACT
            or (estimate.sigma < COMPUTED and estimate.stated is not None and estimate.sigma < 0.01 * estimate.stated)
            for estimate in self.noise
        )

    @cached_property
    def assembles(self) -> bool:
        """Whether the calibrated robot can be assembled at all its poses, starting from its home configuration."""
        closed, robot = self.configurations, self.robot
        if reached_from_home(robot.mechanism, robot.mode, closed.actuated, closed.passive):
            return True
        return bool(np.all(robot.close(self.identification.data.joints, columns=closed.term_columns).ok))

    def predict(self, poses: PosesLike, context: Context | None = None) -> PositionUncertainty:
        """Predict positions with their covariance.

        Args:
            poses: Poses, with their conditions; or actuated joints, (n, n_actuated) or (n_actuated,) [m or rad].
            context: Conditions that replace those of the poses; joint terms may depend on them.

        Raises:
            DataError: Joint values of the wrong shape, or not finite.
            UnreachablePoseError: A loop stays open.
        """
        given_poses = as_poses(self.robot, poses)
        return self.uncertainty.predict(
            self.robot, given_poses.joints, given_poses.conditions if context is None else context
        )

    @cached_property
    def reported_uncertainty(self) -> ReportedUncertainty:
        """Uncertainty of positions, in the frame in which it is reported."""
        return ReportedUncertainty.from_robot(self.robot, self.uncertainty, self.identification.data.joints)

    @property
    def uncertainty(self) -> ParameterUncertainty:
        """Uncertainty of the free parameters."""
        factor, contains = self.statistics.coverage_factor, self.contains(Uncertainty.POSITION)
        known = self.covariance.values
        return ParameterUncertainty(self.free, known, factor, self.undecided, self.joint_error, contains)

    @cached_property
    def unexplained(self) -> UnexplainedErrors:
        """Errors that the residuals show in addition to noise."""
        if self.computed:
            return UnexplainedErrors()
        return unexplained_errors(self, sized=self.terms is not None and self.terms.automatic)

    @property
    def joint_error(self) -> float:
        """Error of each joint that residuals show in addition to noise, independent at each pose.

        In rad, for sliding joints in characteristic lengths; 0 where there is none.
        """
        return self.unexplained.joint_error

    @cached_property
    def joint_derivative(self) -> dict[str, FloatArray]:
        """Derivative of the readings by the actuated joints, of each instrument, (n, n_rows, n_actuated) [SI]."""
        observed = observe(self.robot, self.configurations, self.identification.data.readings, joints=True)
        return {name: own.joint_derivative.copy() for name, own in observed.items()}  # the rest takes memory

    @property
    def undecided(self) -> UndecidedTerms | None:
        """Joint terms that the data do not exclude, and that the robot lacks; None if there are none."""
        if self.terms is not None and self.terms.automatic:
            return self.terms.undecided
        return self.unexplained.terms

    @cached_property
    def identification_uncertainty(self) -> PositionUncertainty:
        """Predicted positions of the used visits, with their covariance as reported."""
        data = self.identification.data
        return self.reported_uncertainty.predict(data.joints, data.conditions, self.identification.passive, turns=False)

    @cached_property
    def validation_uncertainty(self) -> PositionUncertainty | None:
        """Predicted positions of the validation visits, with their covariance as reported; None without them."""
        if self.validation is None:
            return None
        data = self.validation.data
        return self.reported_uncertainty.predict(data.joints, data.conditions, self.validation.passive, turns=False)

    def whitened_residuals_and_rows(self, errors: ErrorSet) -> tuple[FloatArray, Rows]:
        """Return whitened residuals before (n_rows,) and rows after calibration, by the found noise, at new visits."""
        data = errors.data
        before, after, whitening, factors = self._whitened(errors)
        configurations = self.robot.assemble(data.joints, errors.passive, data.labels, data.conditions)
        observed = observe(self.robot, configurations, data.readings)
        rows = whitening.rows(observed, factors, self.unknowns, self.unknowns.deviations(self.robot.values))
        return before, replace(rows, residuals=after)

    def whitened_errors(self, errors: ErrorSet) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals before and after calibration, (n_rows,) each, by the noise as found."""
        return self._whitened(errors)[:2]

    def _whitened(self, errors: ErrorSet) -> tuple[FloatArray, FloatArray, Whitening, FloatArray]:
        """Residuals before and after (n_rows,), their whitening, and scales of the groups (n_groups,)."""
        whitening = Whitening(self.robot, errors.data, self.sigma_given)
        known = {
            (estimate.group.name, estimate.group.part.name, estimate.group.stated): estimate for estimate in self.noise
        }
        factors = whitening.start(errors.after)  # noise of instruments that the fit has not seen
        for g, group in enumerate(whitening.groups):
            estimate = known.get((group.name, group.part.name, group.stated))
            if estimate is not None:
                factors[g] = max(estimate.sigma, 1e-30) / estimate.group.typical
        divisor = whitening.row_scale(factors)
        before, after = (whitening.flatten(state) / divisor for state in (errors.before, errors.after))
        return before, after, whitening, factors

    @cached_property
    def validation_rows(self) -> Rows | None:
        """Whitened rows of the validation visits; None without them."""
        return None if self.validation is None else self.whitened_residuals_and_rows(self.validation)[1]

    @cached_property
    def weighted_rows(self) -> Rows:
        """Whitened rows at the solution, with the weights of a robust loss."""
        return self.rows.with_weights(self.weights)

    @property
    def root(self) -> FloatArray:
        """T of `calib.core.numerics.observability` at the solution, with weights of a robust loss, (n_free, rank)."""
        return self.weighted_rows.posterior_information.root

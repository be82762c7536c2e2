"""A finished fit: its uncertainty, and what it predicts. `calib.core.judging` gives its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.contributions import Contribution, Contributions, Uncertainty, contributions_to
from calib.core.base.other_words import HintedObject
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.fitting.error_sets import Errors, ErrorSet, Folds
from calib.core.fitting.estimates import Correlation, Covariance, Estimates, estimates
from calib.core.fitting.outliers import Outlier
from calib.core.fitting.regions import Regions, disagreeing
from calib.core.fitting.settings import RequestedOptions
from calib.core.fitting.solved_fit import SolvedFit
from calib.core.fitting.starts import Starts
from calib.core.fitting.terms.candidate_terms import TermChoice
from calib.core.fitting.unexplained import UnexplainedErrors, unexplained_errors
from calib.core.numerics.statistics import Statistics
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.terms.term import Condition, Context
from calib.core.rows.frames import ReportedUncertainty
from calib.core.rows.prediction import ParameterUncertainty, PositionUncertainty, UndecidedTerms


@dataclass(frozen=True, eq=False, repr=False)
class Fit(SolvedFit, HintedObject):
    """A finished identification. `calib.core.fitting.solved_fit.SolvedFit` lists its values, rows and noise.

    Attributes:
        starts: Ends of perturbed starts, if requested.
        folds: Cross-validation, if requested.
        excluded: Outliers that were left out, as they were in `with_all`.
        with_all: The fit of all visits, where outliers were left out of this one.
        terms: Requested joint terms, if any, and the result of choosing them.
        reduced: Fits of the same measurements without the joint terms that a kind of file cannot hold, by kind; None if
            no files were requested.
        seed: Seed of every random choice.
        placed_later: Parameters of places that only the validation poses show; they were found from these.
    """

    _other_words = "a fit"

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

    @cached_property
    def parameters(self) -> Estimates:
        """Estimates of the parameters by name: in the unit of each, and in m or rad as `..._si`."""
        by_name = estimates(self.nominal.parameters, self.robot.values, self.free, self.interval_statistics)
        later = {name: replace(by_name[name], status="placed") for name in self.placed_later}
        return Estimates({**by_name, **later}, self.contains(Uncertainty.INTERVAL))

    @cached_property
    def interval_statistics(self) -> Statistics:
        """Uncertainty of the free parameters in their intervals: regions left out and undecided terms count, too."""
        more = 0.0 if self.undecided is None else np.sum(self.undecided.sensitivity_of(self.free_names) ** 2, axis=1)
        return self.statistics.widen(self.interval_factor, more)

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
            Contribution.SCATTER: lambda: self.statistics.shared_scatter is not None,
            Contribution.SIZES: lambda: np.any(self.unknowns.family >= 0),
            Contribution.REGIONS: lambda: self.interval_factor > 1.0,
            Contribution.UNDECIDED: lambda: self.undecided is not None,
            Contribution.JOINT_ERRORS: lambda: self.joint_error > 0.0,
            Contribution.SIDES: lambda: any(Condition.APPROACH in term.depends_on for term in self.robot.terms),
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
    def error_sets(self) -> dict[str, ErrorSet]:
        """Errors at `identification`, `validation` and `cross_validation` poses, as far as these exist."""
        folds = None if self.folds is None else self.folds.errors
        sets = {"identification": self.identification, "validation": self.validation, "cross_validation": folds}
        return {name: errors for name, errors in sets.items() if errors is not None}

    @property
    def errors(self) -> dict[str, dict[str, dict[str, object]]]:
        """Tables of `error_sets`, `before` and `after`.

        In mm for positions, as in `result.json`: `errors["validation"]["after"]["rms"]`.
        """
        return Errors({name: errors.table() for name, errors in self.error_sets.items()})

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

    @cached_property
    def uncertainty(self) -> ParameterUncertainty:
        """Uncertainty of the free parameters."""
        factor, contains = self.statistics.coverage_factor, self.contains(Uncertainty.POSITION)
        known = self.covariance.values
        return ParameterUncertainty(self.free, known, factor, self.undecided, self.joint_error, contains)

    @cached_property
    def unexplained(self) -> UnexplainedErrors:
        """Errors that the residuals show in addition to noise."""
        return unexplained_errors(self, sized=self.terms is not None and self.terms.automatic)

    @property
    def reading_noise(self) -> FloatArray:
        """Noise of each group of rows beside errors of joints, (n_groups,) [SI]; `noise` contains these, too."""
        return self.unexplained.reading_noise

    @property
    def joint_error(self) -> float:
        """Error of each joint that residuals show in addition to noise, independent at each pose.

        In rad, for sliding joints in characteristic lengths; 0 where there is none.
        """
        return self.unexplained.joint_error

    @property
    def undecided(self) -> UndecidedTerms | None:
        """Joint terms that the data do not exclude, and that the robot lacks; None if there are none."""
        if self.terms is not None and self.terms.automatic:
            return self.terms.undecided
        if all(group.stated for group in self.whitening.groups):
            return None  # without the work of `unexplained`
        return self.unexplained.terms

    @cached_property
    def identification_uncertainty(self) -> PositionUncertainty:
        """Predicted positions of the used visits, with their covariance as reported."""
        return self._uncertainty_at(self.identification)

    @cached_property
    def validation_uncertainty(self) -> PositionUncertainty | None:
        """Predicted positions of the validation visits, with their covariance as reported; None without them."""
        return None if self.validation is None else self._uncertainty_at(self.validation)

    def _uncertainty_at(self, errors: ErrorSet) -> PositionUncertainty:
        data = errors.data
        return self.reported_uncertainty.predict(data.joints, data.conditions, errors.passive, turns=False)

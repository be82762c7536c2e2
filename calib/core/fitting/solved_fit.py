"""The end of a fit: the values found, whitened rows at them, and the noise that these show.

`calib.core.fitting.fitted` has what follows for the uncertainty of parameters and positions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.fitting.error_sets import ErrorSet, Residuals
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT
from calib.core.numerics.identifiability import Rank, reduce_rows
from calib.core.numerics.losses import Loss
from calib.core.numerics.observability import observability
from calib.core.numerics.statistics import ChiSquare, Statistics, chi_square
from calib.core.numerics.tall import Span, slices
from calib.core.robots.configurations import Configurations
from calib.core.robots.loops import carries_home
from calib.core.robots.robot import Robot
from calib.core.rows.determination import Determination
from calib.core.rows.observed import observe
from calib.core.rows.rows import Group, Rows
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import Whitening

COMPUTED = 1e-7
"""Data have no noise if the found noise is below this [SI] and below a hundredth of the stated noise."""


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
class SolvedFit(ReadOnlyArrays):
    """The end of an identification.

    Attributes:
        nominal: The robot as described.
        placed: The robot `before`: nominal, with unknown base and targets placed.
        identification: Errors on the visits that were used.
        validation: Errors on visits that were not used, if there were any.
        configurations: The assembled visits of `identification`, at the solution.
        statistics: Uncertainty of the free parameters.
        determination: Ranks of poses and priors at `placed`, as in `calib check`.
        rows: Whitened residuals and Jacobian at the solution, without the weights of a robust loss.
        joint_derivative: Derivative of the readings by the actuated joints, (n, n_rows, n_actuated) [SI] by instrument.
        scales: Assumed scale of the noise of each group, (n_groups,).
        seconds: Duration of the whole computation.
        weights: Weight of each reading, (n_readings,); 1 without a robust loss.
        sigma_given: Noise of positions that replaced the stated one [m], or None.
    """

    nominal: Robot
    placed: Robot
    robot: Robot
    identification: ErrorSet
    validation: ErrorSet | None
    configurations: Configurations
    unknowns: Unknowns
    statistics: Statistics
    determination: Determination
    rows: Rows
    joint_derivative: Mapping[str, FloatArray]
    whitening: Whitening
    scales: FloatArray
    seconds: float
    convergence: Convergence
    loss: Loss
    weights: FloatArray
    sigma_given: float | None

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
        result = np.zeros(len(self.nominal.parameters), dtype=bool)
        result[self.unknowns.index] = True
        return result

    @property
    def residuals(self) -> dict[str, FloatArray]:
        """Predicted minus read after calibration, of each instrument, (n_readings, n_rows) [SI]."""
        return Residuals(self.identification.after)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.unknowns.names

    @cached_property
    def observability(self) -> dict[str, float]:
        """O1 to O5 on scaled columns, without those of families: priors decide which of their rows count."""
        units = self.scales * [group.typical if group.stated else 1.0 for group in self.whitening.groups]
        columns, scale = self.unknowns.family < 0, self.whitening.row_scale(units)[:, None]
        few = [reduce_rows(self.rows.jacobian[part, columns] * scale[part]) for part in slices(len(scale))]
        values = linalg.singular_values(np.vstack(few))
        return observability(values[: self.rank.rank], len(self.identification.data))

    @cached_property
    def noise(self) -> tuple[NoiseEstimate, ...]:
        """Noise of each group of rows, found and stated."""
        factors = self.statistics.factors
        return tuple(
            NoiseEstimate(
                group,
                float(factors.values[g] * self.scales[g] * group.typical),
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
    def chi_square(self) -> ChiSquare | None:
        """The stated noise against the residuals; None where some noise was not stated."""
        if not all(group.stated for group in self.whitening.groups):
            return None
        factors = self.statistics.factors
        return chi_square(replace(factors, values=factors.values * self.scales).common, factors.total_freedom)

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
        """Whether the calibrated robot can be assembled at all its poses, starting from its home configuration.

        A fit follows each pose from home at the nominal robot, and closes its loops at every step from there, in the
        assembly mode of home. So its poses are reached from home if home can be carried over to its robot.
        """
        robot, columns = self.robot, self.configurations.term_columns
        if carries_home(robot.mechanism, robot.mode):
            return True
        return bool(np.all(robot.close(self.identification.data.joints, columns=columns).ok))

    def whitened_residuals_and_rows(self, errors: ErrorSet) -> tuple[FloatArray, Rows]:
        """Return residuals before (n_rows,) and rows after calibration at new visits, whitened by the found noise."""
        data, (whitening, factors) = errors.data, self._found_noise(errors)
        configurations = self.robot.assemble(data.joints, errors.passive, data.labels, data.conditions)
        observed = observe(self.robot, configurations, data.readings)
        rows = whitening.rows(observed, factors, self.unknowns, self.robot.values)
        return whitening.whiten(errors.before, factors), replace(
            rows, residuals=whitening.whiten(errors.after, factors)
        )

    def whitened_errors(self, errors: ErrorSet) -> tuple[FloatArray, FloatArray]:
        """Return residuals before and after calibration, (n_rows,) each, whitened by the found noise."""
        whitening, factors = self._found_noise(errors)
        return whitening.whiten(errors.before, factors), whitening.whiten(errors.after, factors)

    def _found_noise(self, errors: ErrorSet) -> tuple[Whitening, FloatArray]:
        """Whitening of errors, and the scales of their groups of rows by the found noise, (n_groups,)."""
        used = errors.data is self.identification.data
        whitening = self.whitening if used else Whitening(self.robot, errors.data, self.sigma_given)
        factors = whitening.start(errors.after)  # noise of instruments that the fit has not seen
        for g, group in enumerate(whitening.groups):
            for own, sigma in ((each.group, each.sigma) for each in self.noise):
                if (own.name, own.part.name, own.stated) == (group.name, group.part.name, group.stated):
                    factors[g] = max(sigma, 1e-30) / own.typical
        return whitening, factors

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

    @property
    def span(self) -> Span:
        """J T of the rows without weights of a robust loss, (n_rows, rank)."""
        return self.rows.span if self.weighted_rows is self.rows else Span(self.rows.jacobian, self.root)

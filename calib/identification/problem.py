"""The least-squares problem of a fit: weighted residuals and their Jacobian as functions of the scaled parameters.

Unknowns u = (p - p_nominal) / s with scales s, the parameters' sigma. Rows are

    sqrt(w_k n_k) (x_k(p) - measured_k) / sigma     for every pose, target and axis, n_k readings averaged
    u                                               for every parameter that has a prior

with w_k = 1, or the weight that a robust loss gives the point (`calib.identification.robust`). Signed components, never
distances: a distance loses its sign, and has no derivative at zero. A trial step that opens a loop is answered with
NaN, on which the solver (`calib.numerics.least_squares`) shortens its step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.data.measurements import Measurements
from calib.errors import ComputationError
from calib.linearisation.jacobian import linearise
from calib.model import loops
from calib.model.mechanism import BoolArray, FloatArray
from calib.model.robot import Configurations, Robot, describe_open
from calib.numerics.least_squares import TOLERANCE, Solution, minimise

_ROUNDING = 1e-14  # a parameter that moves by less stays nominal, to the last digit [m or rad]
_REMEMBERED = 3  # evaluations: the start, where the solver is, and its trial step


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors and Jacobian at one set of parameter values.

    Attributes:
        configurations: The assembled poses.
        errors: Predicted minus measured, (n_poses, n_targets, 3) [m].
        all_columns: d(positions)/d(parameters), (n_poses, n_targets, 3, n_parameters).
        jacobian: The columns of the free parameters.
    """

    configurations: Configurations
    errors: FloatArray
    all_columns: FloatArray
    jacobian: FloatArray


class Problem:
    """Residuals and Jacobian of a fit; remembers the last solution of the loops to start the next from.

    Args:
        robot: Nominal robot.
        data: Measurements.
        free: Which parameters may change, (n_parameters,).
    """

    def __init__(self, robot: Robot, data: Measurements, free: BoolArray) -> None:
        self.robot, self.data, self.free = robot, data, free
        chosen = [parameter for parameter, use in zip(robot.parameters, free, strict=True) if use]
        self.scales = np.array([parameter.sigma for parameter in chosen])
        self.has_prior = np.array([parameter.prior for parameter in chosen], dtype=bool)
        self.moves = np.array([parameter.placement for parameter in chosen], dtype=bool)
        self.nominal = np.array([parameter.nominal for parameter in chosen])
        self._weight = np.sqrt(data.counts)[:, None, None, None]
        self._seed = robot.assemble(data.joints, labels=data.labels).passive
        self._recent: dict[bytes, Evaluation | None] = {}

    def evaluate(self, robot: Robot) -> Evaluation:
        """Evaluate a robot on the data.

        Raises:
            ComputationError: A loop opens.
        """
        found = self._evaluate(robot)
        if found is None:
            closed = robot.close(self.data.joints)
            raise ComputationError(describe_open(robot, self.data.joints, closed, self.data.labels))
        return found

    def _evaluate(self, robot: Robot) -> Evaluation | None:
        """Evaluate a robot on the data; None where a loop opens. The last few answers are remembered."""
        key = robot.values.tobytes()
        if key not in self._recent:
            while len(self._recent) >= _REMEMBERED:
                del self._recent[next(iter(self._recent))]
            self._recent[key] = self._compute(robot)
        return self._recent[key]

    def _compute(self, robot: Robot) -> Evaluation | None:
        closed = loops.close(robot.mechanism, robot.mode, self.data.joints, self._seed)
        if not np.all(closed.ok):
            return None
        self._seed = closed.passive
        configurations = Configurations(self.data.joints, closed.passive, closed.slope)
        linear = linearise(robot, configurations)
        return Evaluation(
            configurations, linear.positions - self.data.positions, linear.jacobian, linear.jacobian[..., self.free]
        )

    def weighted(self, rows: FloatArray, weights: FloatArray | None = None) -> FloatArray:
        """Flatten (n_poses, n_targets, 3, k) to (n_rows, k), each row with the noise of one reading.

        Args:
            rows: What to flatten.
            weights: w_k of the module docstring, (n_poses, n_targets).
        """
        factor = self._weight if weights is None else self._weight * np.sqrt(weights)[:, :, None, None]
        result: FloatArray = (factor * rows).reshape(-1, rows.shape[-1])
        return result

    def scaled_values(self, robot: Robot) -> FloatArray:
        """Return u of a robot's free parameters, (n_free,)."""
        result: FloatArray = (robot.values[self.free] - self.nominal) / self.scales
        return result

    def with_values(self, start: Robot, u: FloatArray, chosen: BoolArray) -> Robot:
        """Return `start` with the chosen (n_free,) free parameters at nominal + scale u, u (n_chosen,)."""
        return start.with_parameters(self._values(start, u, chosen))

    def _values(self, start: Robot, u: FloatArray, chosen: BoolArray) -> FloatArray:
        values = start.values.copy()
        index = np.flatnonzero(self.free)[chosen]
        change = self.scales[chosen] * u
        values[index] = self.nominal[chosen] + np.where(np.abs(change) < _ROUNDING, 0.0, change)
        return values

    def solve(
        self,
        start: Robot,
        sigma: float,
        chosen: BoolArray,
        *,
        priors: bool = True,
        tolerance: float = TOLERANCE,
        weights: FloatArray | None = None,
    ) -> tuple[Robot, Solution]:
        """Minimise over the chosen free parameters, the others staying as in `start`.

        Args:
            start: Where to begin.
            sigma: Noise of one reading per axis [m].
            chosen: Of the free parameters, (n_free,).
            priors: Whether nominal +- sigma counts.
            tolerance: See `calib.numerics.least_squares`.
            weights: Of each point, (n_poses, n_targets).

        Raises:
            ComputationError: A loop is open at the start.
        """
        prior = np.flatnonzero(self.has_prior[chosen] & priors)
        prior_rows = np.eye(int(np.sum(chosen)))[prior]

        def at(u: FloatArray) -> Evaluation | None:
            values = self._values(start, u, chosen)
            known = self._recent.get(values.tobytes())
            return known or self._evaluate(start.with_parameters(values))

        def residuals(u: FloatArray) -> FloatArray:
            found = at(u)
            if found is None:
                return np.full(self.data.positions.size + len(prior), np.nan)
            return np.concatenate([self.weighted(found.errors[..., None], weights)[:, 0] / sigma, u[prior]])

        def jacobian(u: FloatArray) -> FloatArray:
            found = at(u)
            if found is None:  # derivatives are asked for only where the residuals were finite
                raise ComputationError("the solver left the region where the loops close")
            columns = self.weighted(found.jacobian[..., chosen], weights) * (self.scales[chosen] / sigma)
            return np.vstack([columns, prior_rows])

        first = self.scaled_values(start)[chosen]
        self.evaluate(self.with_values(start, first, chosen))  # says which loop is open, if one is
        outcome = minimise(residuals, jacobian, first, tolerance=tolerance)
        return self.with_values(start, outcome.x, chosen), outcome

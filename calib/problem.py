"""The least-squares problem of a fit: weighted residuals and their Jacobian as functions of the scaled parameters.

Unknowns u = (p - p_nominal) / s with scales s, the parameters' sigma. Rows are

    sqrt(n_k) (x_k(p) - measured_k) / sigma     for every pose, target and axis, n_k readings averaged
    u                                           for every parameter that has a prior

Signed components, never distances: a distance loses its sign, and has no derivative at zero. A trial step that opens
a loop is answered with NaN, on which scipy's trust-region solver shortens its step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from calib import loops
from calib.errors import ComputationError, UnreachablePoseError
from calib.jacobian import linearise
from calib.measurements import Measurements
from calib.mechanism import BoolArray, FloatArray
from calib.robot import Configurations, Robot, describe_open

MAX_EVALUATIONS = 200
TOLERANCE = 1e-9
"""Relative change of the cost that ends the iteration: less than a thousandth of a standard deviation."""


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
        closed = robot.close(data.joints)
        if not np.all(closed.ok):
            raise UnreachablePoseError(describe_open(robot, data.joints, closed, data.labels))
        self._seed = closed.passive
        self._last: tuple[bytes, Evaluation | None] = (b"", None)

    def evaluate(self, robot: Robot) -> Evaluation:
        """Evaluate a robot on the data.

        Raises:
            ComputationError: A loop opens.
        """
        closed = loops.close(robot.mechanism, robot.mode, self.data.joints, self._seed)
        if not np.all(closed.ok):
            raise ComputationError(describe_open(robot, self.data.joints, closed, self.data.labels))
        self._seed = closed.passive
        configurations = Configurations(self.data.joints, closed.passive, closed.slope)
        linear = linearise(robot, configurations)
        return Evaluation(
            configurations, linear.positions - self.data.positions, linear.jacobian, linear.jacobian[..., self.free]
        )

    def weighted(self, rows: FloatArray) -> FloatArray:
        """Flatten (n_poses, n_targets, 3, k) to (n_rows, k), each row with the noise of one reading."""
        result: FloatArray = (self._weight * rows).reshape(-1, rows.shape[-1])
        return result

    def with_values(self, start: Robot, u: FloatArray, chosen: BoolArray) -> Robot:
        """Return `start` with the chosen free parameters at nominal + scale u."""
        values = start.values.copy()
        index = np.flatnonzero(self.free)[chosen]
        values[index] = self.nominal[chosen] + self.scales[chosen] * u
        return start.with_parameters(values)

    def solve(
        self, start: Robot, sigma: float, chosen: BoolArray, *, priors: bool = True, tolerance: float = TOLERANCE
    ) -> tuple[Robot, OptimizeResult]:
        """Minimise over the chosen free parameters, the others staying as in `start`."""
        prior = np.flatnonzero(self.has_prior[chosen] & priors)
        prior_rows = np.eye(int(np.sum(chosen)))[prior]

        def at(u: FloatArray) -> Evaluation | None:
            if self._last[0] != u.tobytes():
                try:
                    self._last = (u.tobytes(), self.evaluate(self.with_values(start, u, chosen)))
                except ComputationError:
                    self._last = (u.tobytes(), None)
            return self._last[1]

        def residuals(u: FloatArray) -> FloatArray:
            found = at(u)
            if found is None:
                return np.full(self.data.positions.size + len(prior), np.nan)
            return np.concatenate([self.weighted(found.errors[..., None])[:, 0] / sigma, u[prior]])

        def jacobian(u: FloatArray) -> FloatArray:
            found = at(u)
            if found is None:  # scipy asks for derivatives only where the residuals were finite
                raise ComputationError("the solver left the region where the loops close")
            columns = self.weighted(found.jacobian[..., chosen]) * (self.scales[chosen] / sigma)
            return np.vstack([columns, prior_rows])

        self._last = (b"", None)
        values = start.values[np.flatnonzero(self.free)[chosen]]
        first = (values - self.nominal[chosen]) / self.scales[chosen]
        outcome = least_squares(
            residuals, first, jac=jacobian, ftol=tolerance, xtol=1e-12, gtol=1e-12, max_nfev=MAX_EVALUATIONS
        )
        return self.with_values(start, outcome.x, chosen), outcome

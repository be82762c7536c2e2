"""Data of each draw of a study: simulated measurements, or resampled poses of real measurements.

Simulated. A true robot is measured at the same poses, with new noise in each draw.

Resampled (the bootstrap of poses). Each draw takes as many poses as were measured, at random with replacement. A pose
brings all its visits and their readings; a repeated pose counts as two. Nothing is assumed of the noise, not even that
it is the same everywhere. The scatter over the draws estimates the scatter of the parameters over other sets of poses
of the same kind. It contains the noise, and errors of the model that differ from pose to pose. For many poses, the
covariance over the draws is the sandwich H^-1 (sum over poses of g g^T) H^-1, with g the gradient of a pose's part of
the cost.

When it fails. An error common to all poses (an instrument's scale, a missing joint term with the same effect
everywhere) is in every draw, and does not show. A draw holds about 63 % of the poses, so that with few poses for the
parameters the scatter is too large, and some draws determine nothing. Poses that were chosen by an observability index
are no random sample: the draws are worse sets of poses, and scatter more. A parameter with a strong prior scatters less
than its standard deviation, because the prior is the same in each draw.

Reference: efron1979, white1980.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.data.measurements import Measurements
from calib.core.data.pose_groups import repeated_poses
from calib.core.robots.robot import Robot
from calib.core.rows.observed import predict_readings
from calib.core.rows.simulate import noisy_readings, simulate, unstated_noise
from calib.core.rows.unknowns import Unknowns

Noise = Callable[[Measurements, np.random.Generator], Measurements]
"""Function from exact measurements to measurements with noise."""
Drawn = tuple[Robot, Measurements, FloatArray | None]
"""Data of one draw: the measured robot, the measurements, and passive joints of a similar robot at the visits,
(n, n_passive) [m or rad], or None."""


@dataclass(frozen=True, eq=False)
class SimulatedDraws:
    """Simulated measurements of a true robot.

    Attributes:
        truth: The measured robot.
        data: Measurements of this robot without noise.
        drawn: Matrix D, (n_parameters, n) [m or rad]: a draw adds D z to the true values, with z standard normal.
        noise: Function that adds noise to `data`; None: the noise of the description.
        sigma: Noise of positions in place of the description's [m], or None.
        passive: Passive joints of the truth at the visits, (n, n_passive) [m or rad].
    """

    truth: Robot
    data: Measurements
    drawn: FloatArray
    noise: Noise | None
    sigma: float | None
    passive: FloatArray

    def draw(self, seed: np.random.SeedSequence) -> Drawn:
        """Return the data of one draw."""
        rng, truth, exact = np.random.default_rng(seed), self.truth, self.data
        if np.any(self.drawn):
            truth = truth.with_parameters(truth.values + self.drawn @ rng.standard_normal(self.drawn.shape[1]))
        if any(instrument.touches for instrument in truth.instruments):  # their noise is in the joints
            return truth, simulate(truth, exact, self.sigma, rng), None
        if truth is not self.truth:
            configurations = truth.assemble(exact.joints, self.passive, exact.labels, exact.conditions)
            exact = replace(exact, readings=predict_readings(truth, configurations, exact.readings))
        if self.noise is not None:
            return truth, self.noise(exact, rng), None
        return truth, replace(exact, readings=noisy_readings(truth, exact.readings, self.sigma, rng)), None


@dataclass(frozen=True, eq=False)
class ResampledDraws:
    """Poses of measurements drawn with replacement.

    `truth` is calibrated from all of `data`; `passive` are its passive joints at the visits, (n, n_passive) [m or rad].
    """

    truth: Robot
    data: Measurements
    passive: FloatArray

    def draw(self, seed: np.random.SeedSequence) -> Drawn:
        """Return the data of one draw."""
        groups = repeated_poses(self.data.joints, self.data.pose_numbers)
        chosen = np.random.default_rng(seed).integers(len(groups), size=len(groups))
        visits = [(turn, k) for turn, group in enumerate(chosen) for k in groups[group]]
        index = np.array([k for _, k in visits], dtype=np.intp)
        names = tuple(f"{turn}: {self.data.names[k]}" for turn, k in visits)  # a repeated pose is two poses
        return self.truth, replace(self.data.subset(index), names=names), self.passive[index]


def simulated_draws(
    robot: Robot,
    poses: PosesLike,
    truth: Robot | Literal["priors"] | None,
    sigma: float | None,
    noise: Noise | None,
) -> SimulatedDraws:
    """Return the source of simulated draws of a nominal robot; see `study` for truth, sigma [m] and noise.

    Raises:
        InputError: The truth has other joints, there are no priors to draw it from, or the noise is not stated.
    """
    unstated = [] if noise is not None else unstated_noise(robot, sigma)
    if unstated:
        raise InputError(
            f"{robot.path}: states no noise (sigma) of {', '.join(unstated)}, so that none can be simulated; state it"
            " there, or give sigma, the noise of positions (--sigma-mm), or a function noise"
        )
    if not (truth is None or truth == "priors" or isinstance(truth, Robot)):
        raise InputError(f"truth {truth!r:.60}: must be a robot, or 'priors'")
    true = truth if isinstance(truth, Robot) else robot
    if true.joint_names != robot.joint_names:
        raise InputError(
            f"truth {true.path}: has joints {', '.join(true.joint_names)}, and {robot.path} has"
            f" {', '.join(robot.joint_names)}; give the same robot with other values or more parameters"
        )
    drawn: FloatArray = np.zeros((len(true.parameters), 0))
    if truth == "priors":
        true = robot.with_parameters({p.name: p.mean_si for p in robot.parameters if p.mean_si is not None})
        unknowns, drawn = Unknowns.from_robot(robot), np.zeros((len(robot.parameters), len(robot.parameters)))
        drawn[np.ix_(unknowns.index, unknowns.index)] = unknowns.scales[:, None] * unknowns.prior.root
        if not np.any(drawn):
            raise InputError(f"{robot.path}: has no priors to draw the truth from; give a robot as the truth")
    exact = simulate(true, as_poses(robot, poses), 0.0)
    passive = true.assemble(exact.joints, labels=exact.labels, context=exact.conditions).passive
    return SimulatedDraws(true, exact, drawn, noise, sigma, passive)

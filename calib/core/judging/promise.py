"""What a calibration promises of new readings: its robot, its uncertainty, and the noise of readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.fitting.fitted import Fit
from calib.core.fitting.unseen_errors import left_out_ratio
from calib.core.robots.robot import Robot
from calib.core.rows.prediction import ParameterUncertainty


@dataclass(frozen=True, eq=False)
class Promise:
    """Predictions of a calibration for new readings of its robot.

    Attributes:
        freedom: Degrees of freedom of the found noise.
        sigma: Noise of one component beside errors of joints, by group and part of the instruments [SI].
        shared: Common scatter of the readings of a pose, over that of independent readings (`Scatter.ratio`).
        decided: Number of parameters that the readings decided.
        joints: Poses of the calibration, (n, n_actuated) [m or rad]; none where they are not stored.
        names: Names of these poses, (n,).
    """

    robot: Robot
    uncertainty: ParameterUncertainty
    freedom: float
    sigma: Mapping[tuple[str, str], float]
    shared: float
    decided: float
    joints: FloatArray
    names: tuple[str, ...]

    @staticmethod
    def from_calibration(calibrated: Fit | Promise | HasPromise) -> Promise:
        """Return the promise of a fit or a loaded result, or raise `InputError` for anything else, such as a path."""
        if isinstance(calibrated, Promise):
            return calibrated
        if isinstance(calibrated, Fit):
            noise, statistics = calibrated.reading_noise.tolist(), calibrated.statistics
            groups = zip(calibrated.whitening.groups, noise, strict=True)
            shared, data = statistics.shared_scatter, calibrated.identification.data
            return Promise(
                calibrated.robot,
                calibrated.uncertainty,
                statistics.freedom,
                {(group.name, group.part.name): own for group, own in groups},
                1.0 if shared is None else shared.ratio,
                statistics.effective_parameters,
                data.joints,
                tuple(map(str, data.names)),
            ).widen(left_out_ratio(calibrated))
        if isinstance(calibrated, HasPromise):
            return calibrated.promise
        raise InputError(
            f"calibrated: expected a fit, or a result as calib.load_result(folder) loads it, not"
            f" {type(calibrated).__name__}"
        )

    def widen(self, ratio: float) -> Promise:
        """Return the promise of errors this many times as large."""
        known = self.uncertainty
        known = replace(known, covariance=ratio**2 * known.covariance, joint_error=ratio * known.joint_error)
        return replace(self, uncertainty=known, sigma={key: ratio * size for key, size in self.sigma.items()})

    def with_common_error(self, n_rows: int) -> Promise:
        """Return the promise where unexplained errors may be one common error of n rows, though no larger.

        See *Unlike poses* in `calib.core.judging.acceptance`.
        """
        decided = max(self.decided, 1.0)
        wider = max((self.freedom + self.decided) / decided, 1.0)
        together = max(self.shared, float(np.sqrt(1.0 + n_rows / decided)))
        known = replace(self.uncertainty, covariance=wider * self.uncertainty.covariance)
        return replace(self, uncertainty=known, shared=together)


@runtime_checkable
class HasPromise(Protocol):
    """An object with its own promise, such as a loaded result."""

    @property
    def promise(self) -> Promise:
        """Promise of the calibration."""

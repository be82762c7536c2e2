"""Simulated measurements: what the instruments of a robot with known parameters read, plus normal noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.arrays import FloatArray
from calib.data.in_memory import as_poses, measurements
from calib.data.measurements import Measurements, Poses
from calib.errors import DataError
from calib.linearisation.observed import predicted_readings
from calib.linearisation.whitening import stated_noise
from calib.model.robot import Robot
from calib.observation.kind import Instrument, Readings
from calib.units import millimetres


def simulate(
    robot: Robot,
    poses: Poses | ArrayLike,
    sigma: float | None,
    rng: np.random.Generator,
    *,
    joint_sigma: float = 0.0,
) -> Measurements:
    """Return simulated measurements of a robot at its current parameter values.

    Every instrument reads all that it can at every pose. Noise that nobody states is none.

    Args:
        robot: The robot that plays the truth.
        poses: Where to measure: poses, or joint values alone, (n, n_actuated) [m or rad].
        sigma: Standard deviation of the noise of positions per axis [m]; 0 for no noise of anything; None for what the
            description states.
        rng: Source of the noise.
        joint_sigma: Standard deviation of what the joints are off at each visit, in their commands unseen [rad, or
            characteristic lengths].

    Raises:
        DataError: Sigma is not a number >= 0.
        UnreachablePoseError: A pose cannot be assembled.
    """
    if sigma is not None and not (np.isfinite(sigma) and sigma >= 0):
        raise DataError(f"sigma {sigma:g} m: must be a number, zero or positive")
    where = as_poses(robot, poses)
    actual = where.joints
    if joint_sigma:
        error = joint_sigma * robot.mechanism.joint_scale
        actual = actual + error * rng.standard_normal(where.joints.shape)
    configurations = robot.assemble(actual, labels=where.labels)  # says which pose cannot be
    readings = {
        name: _noisy(robot.instrument(name), found, sigma, rng)
        for name, found in predicted_readings(robot, configurations).items()
    }
    noise = "noise as the description states it" if sigma is None else _said(sigma)
    said = (f"simulated measurements of {robot.name}", noise)
    data = measurements(where, readings)
    return Measurements(
        data.joints,
        data.labels,
        data.names,
        data.path,
        data.ignored,
        data.readings,
        comments=said,
        context=data.context,
    )


def _said(sigma: float) -> str:
    return f"normal noise, sigma {millimetres(sigma):g} mm per axis"


def _noisy(one: Instrument, every: Readings, sigma: float | None, rng: np.random.Generator) -> Readings:
    """Readings with noise, without those of what cannot be seen."""
    seen = np.flatnonzero(~np.isnan(every.values).all(axis=1))
    found = Readings(every.visits[seen], every.pairs[seen], every.values[seen], None, every.details[seen])
    change = np.zeros((len(found), one.n_rows))
    if sigma != 0:
        noise = stated_noise(one, sigma)
        widths = [len(part.axes) for part in one.parts]
        covariance = noise.covariance(one.points(found.values), len(found), widths)
        normal = rng.standard_normal(change.shape)
        change = _rows_with_noise(one, sigma) * _times_root(covariance, normal)
    return Readings(found.visits, found.pairs, one.moved(found.values, change), None, found.details)


def _rows_with_noise(one: Instrument, sigma: float | None) -> FloatArray:
    """1.0 for rows whose noise is known, else 0.0."""
    stated = [part.stated for part in stated_noise(one, sigma).parts]
    return np.array([float(stated[k]) for k in one.part_of_row])


def _times_root(covariance: FloatArray, normal: FloatArray) -> FloatArray:
    result: FloatArray = np.matmul(np.linalg.cholesky(covariance), normal[:, :, None])[:, :, 0]
    return result

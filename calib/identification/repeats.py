"""What repeated readings of a pose say: accuracy and repeatability in the manner of ISO 9283.

For a pose with n readings and e_j what reading j is off the prediction for its own joint values, e their mean, and
l_j = |e_j - e|:

    pose accuracy          AP = |e|
    pose repeatability     RP = mean(l) + 3 std(l)           (std with n - 1)

ISO 9283 asks for 30 readings of five poses, approached anew each time, and takes the commanded position where this
takes the position that the model predicts; what the joints say that they moved between two readings is no scatter. With
fewer readings the numbers are the same, only less sure; readings taken without moving the robot show the tracker alone.

Reference: iso9283, sections 7.2.1 and 7.2.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.identification.errors_found import ErrorSet
from calib.units import millimetres


@dataclass(frozen=True, eq=False)
class Repeats(ReadOnlyArrays):
    """Accuracy and repeatability of the points that were read more than once at a pose.

    Attributes:
        poses: Pose of each, (n,).
        readings: How many readings each has, (n,).
        accuracy_before, accuracy_after: AP, (n,) [m].
        repeatability: RP, (n,) [m].
    """

    poses: IntArray
    readings: IntArray
    accuracy_before: FloatArray
    accuracy_after: FloatArray
    repeatability: FloatArray

    def table(self) -> dict[str, object]:
        """Return mean and largest values [mm]."""

        def both(values: FloatArray) -> dict[str, float]:
            return {"mean": millimetres(float(np.mean(values))), "max": millimetres(float(np.max(values)))}

        return {
            "n_poses": len(np.unique(self.poses)),
            "n_readings": int(np.sum(self.readings)),
            "pose_accuracy": {"before": both(self.accuracy_before), "after": both(self.accuracy_after)},
            "pose_repeatability": both(self.repeatability),
        }


@dataclass(frozen=True, eq=False)
class Scatter:
    """Position errors of one instrument, pose by pose."""

    pose: int
    before: FloatArray
    after: FloatArray


def _repeated(found: ErrorSet) -> list[Scatter]:
    """Position errors (n, 3) of every point that was read more than once at a pose."""
    result = []
    for one, part, rows in found.parts():
        if part.name != "position":
            continue
        readings = found.data.readings[one.name]
        keys = np.stack([found.data.pose_numbers[readings.visits], readings.pairs], axis=1)
        _, number, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        order = np.argsort(number.reshape(-1), kind="stable")
        for group in np.split(order, np.cumsum(count)[:-1]):
            if len(group) > 1:
                before, after = found.before[one.name][group], found.after[one.name][group]
                result.append(Scatter(int(keys[group[0], 0]), before[:, rows], after[:, rows]))
    return result


def repeats(found: ErrorSet) -> Repeats | None:
    """Return accuracy and repeatability; None where no point was read more than once at a pose."""
    several = _repeated(found)
    if not several:
        return None
    spread = []
    for one in several:
        distance = np.linalg.norm(one.after - one.after.mean(axis=0), axis=1)
        spread.append(distance.mean() + 3.0 * distance.std(ddof=1))
    return Repeats(
        np.array([one.pose for one in several], dtype=np.intp),
        np.array([len(one.after) for one in several], dtype=np.intp),
        np.array([np.linalg.norm(one.before.mean(axis=0)) for one in several]),
        np.array([np.linalg.norm(one.after.mean(axis=0)) for one in several]),
        np.array(spread),
    )


def repeatability(found: ErrorSet) -> tuple[float, int]:
    """Return the pooled standard deviation of one reading about its pose's mean, per axis [m], and its freedom.

    NaN and 0 where no point was read more than once at a pose.
    """
    several = _repeated(found)
    freedom = sum(one.after.shape[1] * (len(one.after) - 1) for one in several)
    if freedom == 0:
        return float("nan"), 0
    squares = sum(float(np.sum((one.after - one.after.mean(axis=0)) ** 2)) for one in several)
    return float(np.sqrt(squares / freedom)), freedom


def beyond_repeatability(found: ErrorSet, n_effective: float) -> tuple[float, float]:
    """Return what pose means are off, as noise of one reading, over the scatter of repeats, and the chance of that.

    If the model leaves nothing out, the mean of n readings is off by what one reading scatters over the root of n. NaN
    and 1 where there are no repeats, or where they do not scatter at all.

    Args:
        found: Errors of the visits that were used.
        n_effective: Parameters that they decided.
    """
    scatter, n_free = repeatability(found)
    several = _repeated(found)
    freedom = 3.0 * len(several) - n_effective
    if not (np.isfinite(scatter) and scatter > 0 and freedom >= 1 - 1e-9):
        return float("nan"), 1.0
    squares = sum(len(one.after) * float(np.sum(one.after.mean(axis=0) ** 2)) for one in several)
    ratio = float(np.sqrt(squares / freedom)) / scatter
    return ratio, float(scipy.special.fdtrc(freedom, n_free, ratio**2))

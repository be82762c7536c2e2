"""What repeated readings of a pose say: accuracy and repeatability in the manner of ISO 9283.

For a pose with n readings p_j, mean p, and l_j = |p_j - p|:

    pose accuracy          AP = |p - predicted|
    pose repeatability     RP = mean(l) + 3 std(l)           (std with n - 1)

ISO 9283 asks for 30 readings of five poses, approached anew each time, and takes the commanded position where this
takes the position that the model predicts. Readings are those of `Measurements.at_mean_joints`: where the encoders of
repeats differ, what the robot moved between them is no scatter. With fewer readings the numbers are the same, only less
sure; readings taken without moving the robot show the tracker alone.

Reference: iso9283, sections 7.2.1 and 7.2.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from calib.data.measurements import Measurements
from calib.model.mechanism import FloatArray, IntArray
from calib.read_only import ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Repeats(ReadOnlyArrays):
    """Accuracy and repeatability of the poses that were read more than once.

    Attributes:
        poses: Indices of these poses, (n,).
        readings: How many readings each has, (n,).
        accuracy_before, accuracy_after: AP, (n, n_targets) [m].
        repeatability: RP, (n, n_targets) [m].
    """

    poses: IntArray
    readings: IntArray
    accuracy_before: FloatArray
    accuracy_after: FloatArray
    repeatability: FloatArray

    def table(self) -> dict[str, object]:
        """Return mean and largest values [mm]."""

        def both(values: FloatArray) -> dict[str, float]:
            return {"mean": 1e3 * float(np.mean(values)), "max": 1e3 * float(np.max(values))}

        return {
            "n_poses": len(self.poses),
            "n_readings": int(np.sum(self.readings)),
            "pose_accuracy": {"before": both(self.accuracy_before), "after": both(self.accuracy_after)},
            "pose_repeatability": both(self.repeatability),
        }


def repeats(data: Measurements, before: FloatArray, after: FloatArray) -> Repeats | None:
    """Return accuracy and repeatability; None where no pose was read more than once.

    Args:
        data: The measurements, as a fit holds them.
        before, after: Predicted minus measured mean positions, (n_poses, n_targets, 3) [m].
    """
    several = np.flatnonzero(data.counts > 1) if data.readings else np.zeros(0, dtype=np.intp)
    if len(several) == 0:
        return None
    spread = []
    for k in several:
        readings = data.readings[k]
        distance = np.linalg.norm(readings - readings.mean(axis=0), axis=2)
        spread.append(distance.mean(axis=0) + 3.0 * distance.std(axis=0, ddof=1))
    return Repeats(
        several,
        data.counts[several],
        np.linalg.norm(before[several], axis=2),
        np.linalg.norm(after[several], axis=2),
        np.array(spread),
    )


def beyond_repeatability(data: Measurements, sigma: float, freedom: float) -> tuple[float, float]:
    """Return the found noise over the scatter of repeats, and the chance of so large a ratio if both are the same.

    NaN and 1 where there are no repeats, or where they do not scatter at all.
    """
    scatter = data.repeatability()
    if not (np.isfinite(scatter) and scatter > 0):
        return float("nan"), 1.0
    n_free = 3 * data.positions.shape[1] * int(np.sum(data.counts[data.counts > 1] - 1))
    ratio = sigma / scatter
    return ratio, float(f_distribution.sf(ratio**2, freedom, n_free))

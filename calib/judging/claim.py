"""What a calibration claims of the robot where it was measured, and whether poses that it has not used bear it out.

The claim. Each pose that was used is predicted by the fit of all others (`calib.fitting.unseen_errors`). Of
these errors, 95 in 100 at further poses like them stay below `limit95`, whatever their distribution. They count what
the model leaves out as well as noise; the covariance of the parameters counts noise alone.

Whether it holds. At n poses that had no part in the fit, such as validation poses, the root mean square error may be
`MORE` times that of the claim; more only where n is so small that chance makes it so in one case of a thousand (F, with
as many degrees of freedom as coordinates were read, or as poses where the readings of a pose share errors).

Whether the robot gets better. On poses that were not used, if there are any, by `calib.judging.better_or_worse`; else
by Student's t of what each pose's squared error, left out, is above that of the nominal robot.

When it fails. New poses unlike those measured may be worse: in another region, under another load, at another place of
what was touched. What changes in the course of the measurement goes on changing after it. Poses that are copies of
others foretell each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from calib.base.units import ERROR_UNIT, error_scale
from calib.robots.held import Accuracy


class Gain(Enum):
    """What a calibration does to poses that it has not used."""

    BETTER = "better"
    WORSE = "worse"
    NONE = "neither better nor worse"


@dataclass(frozen=True)
class Claim:
    """What a calibration claims.

    Attributes:
        told: How far off the robot is at poses like those measured.
        shown: The same as seen at poses that had no part in the fit.
        broken: Those of them that the claim does not hold for.
        gain: What becomes of poses that were not used.
        region: Which poses it is about, in words.
    """

    told: Accuracy
    shown: tuple[Accuracy, ...]
    broken: tuple[Accuracy, ...]
    gain: Gain
    region: str

    @property
    def holds(self) -> bool:
        """Whether poses that were not used are as far off as claimed."""
        return not self.broken

    @property
    def words(self) -> str:
        """The claim as a sentence."""
        told = self.told
        within, rms = f"within {told.shown(told.limit95)} of where the model says, 95 % of the time", ""
        if np.isfinite(told.limit95):
            rms = f"{told.shown(told.rms)} RMS; "
        else:
            within = f"off by {told.shown(told.rms)} RMS"
        what = "The tool is" if told.part == "position" else f"Readings ({told.part}) are"
        shown = "".join(f"{one.shown(one.rms)} RMS at {one.where}; " for one in self.shown)
        return f"{what} {within}, {self.region} ({rms}{shown}before: {told.shown(told.before)})"

    def to_dict(self) -> dict[str, object]:
        """Return the entry of `result.json`; errors in the unit of errors."""
        told, scale = self.told, error_scale(self.told.dimension)
        return {
            "part": told.part,
            "unit": ERROR_UNIT[told.dimension],
            "limit95": scale * told.limit95,
            "rms": scale * told.rms,
            "rms_before": scale * told.before,
            "n_poses": told.n_poses,
            "region": self.region,
            "not_used": [
                {"poses": one.poses.name.lower(), "n_poses": one.n_poses, "rms": scale * one.rms} for one in self.shown
            ],
            "holds": self.holds,
            "gain": self.gain.value,
        }

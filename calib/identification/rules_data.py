"""Rules of the verdict about the measurements: poses, outliers, repeats. Each gives at most a few reasons."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.data.repeats import beyond_repeatability
from calib.identification.fitted import Fit
from calib.identification.pose_checks import unmoved_joints
from calib.identification.reasons import Reason, listed
from calib.numerics.outliers import FALSE_ALARM, HIGH_LEVERAGE

FEW = 10.0
"""Degrees of freedom below which intervals are very wide."""
EXCLUDED = 0.1
"""Part of the poses that may be outliers."""
BEYOND_REPEATS = 1.5
"""Found noise over the scatter of repeats from which something systematic is left."""
UNLIKELY = 1e-3
"""Chance below which a test against noise counts."""


def poses_that_say_little(fit: Fit) -> Iterator[Reason]:
    """Look for joints that never moved, and poses near a singularity."""
    data = fit.identification.data
    still = unmoved_joints(fit.nominal, data.joints)
    if len(still) == len(fit.nominal.joint_names):
        yield Reason(
            "FAIL", "poses_equal", "all poses are the same: the parameters rest on their priors; move the robot"
        )
    elif still:
        yield Reason(
            "CHECK",
            "joint_never_moved",
            f"{'joint' if len(still) == 1 else 'joints'} {', '.join(still)} never moved: what depends on"
            f" {'it' if len(still) == 1 else 'them'} rests on priors, and poses that move"
            f" {'it' if len(still) == 1 else 'them'} are not calibrated",
        )
    limit = fit.nominal.description.singularity_limit
    near = [data.labels[k] for k in np.flatnonzero(fit.identification.singular_value < limit)]
    if near:
        yield Reason(
            "CHECK",
            "near_singular",
            f"{len(near)} poses are near a singularity of the loops (smallest singular value below {limit:g}):"
            f" {listed(near)}; leave them out",
        )


def too_few_poses(fit: Fit) -> Iterator[Reason]:
    """Count degrees of freedom."""
    rows, used = fit.identification.after.size, fit.statistics.effective_parameters
    if fit.statistics.freedom < FEW or rows < 2 * used:
        yield Reason(
            "CHECK",
            "too_few_poses",
            f"too few poses: {rows} measured coordinates decide {used:.1f} parameters and leave"
            f" {fit.statistics.freedom:.1f} degrees of freedom; measure several times as many",
        )


def outliers(fit: Fit) -> Iterator[Reason]:
    """List outliers, and count the excluded ones."""
    for where, found in (("", fit.outliers), (" among the poses that were not used", fit.validation_outliers)):
        if found:
            words = listed([str(outlier) for outlier in found], "; ")
            yield Reason(
                "CHECK",
                "outliers",
                f"{len(found)} outliers{where} (chance below {100 * FALSE_ALARM:g} %): {words};"
                " look at these measurements" + ("" if where else "; --exclude-outliers fits without them"),
            )
    if fit.with_all is not None:
        total = len(fit.with_all.identification.data)
        poses = total - len(fit.identification.data)
        if poses > EXCLUDED * total:
            yield Reason(
                "CHECK",
                "many_excluded",
                f"{poses} of {total} poses were excluded: so many are no outliers; the model or the measurements are"
                " wrong",
            )


def repeats(fit: Fit) -> Iterator[Reason]:
    """Compare residuals with the scatter of repeats."""
    ratio, p_value = beyond_repeatability(fit.identification.data, fit.statistics.sigma, fit.statistics.freedom)
    if ratio > BEYOND_REPEATS and p_value < UNLIKELY:
        yield Reason(
            "CHECK",
            "repeatability",
            f"residuals are {ratio:.1f} times what repeats of a pose scatter: the model leaves something out, or the"
            " repeats were read without moving the robot",
        )


def leverage(fit: Fit) -> Iterator[Reason]:
    """List poses that decide their own prediction."""
    high = [fit.identification.data.labels[k] for k, _ in np.argwhere(fit.studentised.largest_leverage > HIGH_LEVERAGE)]
    if high and fit.statistics.freedom >= FEW:
        yield Reason(
            "CHECK",
            "leverage",
            f"{len(high)} poses decide their own prediction, so that an error there would not show: {listed(high)};"
            " measure more poses near them",
        )

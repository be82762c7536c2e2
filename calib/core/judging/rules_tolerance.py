"""The rule of the verdict about a stated tolerance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.core.base.units import millimetres
from calib.core.base.words import counted
from calib.core.data.tolerances import stated_tolerance
from calib.core.fitting.fitted import Fit
from calib.core.judging.claim import Claim
from calib.core.judging.reasons import Answer, Code, Reason


def above_tolerance(fit: Fit, claim: Claim) -> Iterator[Reason]:
    """Compare the claim with the tolerance that the description or the measurements state, the smallest of them."""
    every = [fit.identification.data, *([] if fit.validation is None else [fit.validation.data])]
    stated = {data.path: stated_tolerance(data.comments, data.path) for data in every}
    stated[str(fit.nominal.path)] = fit.nominal.description.tolerance
    known = {path: size for path, size in stated.items() if size is not None}
    if not known:
        return
    path = min(known, key=lambda name: known[name])
    told, allowed = claim.told, f"the tolerance of {millimetres(known[path]):.4g} mm ({path})"
    if not told.is_position or told.dimension != "length":
        yield Code.TOLERANCE.says(
            f"whether the tool is within {allowed} is not known: positions were not measured", answer=Answer.LOOK
        )
    elif not np.isfinite(told.limit95):
        yield Code.TOLERANCE.says(
            f"{counted(told.n_poses, 'pose')} are too few to tell whether the tool is within {allowed}",
            answer=Answer.OTHER_POSES,
        )
    elif told.limit95 > known[path]:
        yield Code.TOLERANCE.says(f"the claim is {told.shown(told.limit95)} (95 % of the time), above {allowed}")

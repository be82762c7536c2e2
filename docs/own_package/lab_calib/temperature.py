"""A reason of the verdict: it became warmer, or colder, while the robot was measured."""

from collections.abc import Iterator

import numpy as np

from calib.extend import Fit, Reason

MOST = 5.0
"""Largest change of the temperature that is no reason [K]."""


def warmed_up(fit: Fit) -> Iterator[Reason]:
    """Compare the range of the temperatures that were read with `MOST`."""
    read = fit.identification.data.context.get("temperature", np.zeros(0))
    change = float(np.ptp(read[np.isfinite(read)])) if np.isfinite(read).any() else 0.0
    if change > MOST:
        yield Reason("CHECK", "warmed_up", f"the temperature changed by {change:.1f} K; measure at an even one")

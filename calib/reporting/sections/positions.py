"""How sure predicted positions are, over the poses that were used and those that were not."""

from __future__ import annotations

from calib.fitting.error_sets import ErrorSet
from calib.fitting.fitted import Fit
from calib.rows.prediction import PositionUncertainty


def position_uncertainty_table(fit: Fit) -> dict[str, object]:
    """Return how sure predicted positions are, over the poses that were used and those that were not [mm]."""
    sets: list[tuple[str, ErrorSet | None, PositionUncertainty | None]] = [
        ("identification", fit.identification, fit.identification_uncertainty),
        ("validation", fit.validation, fit.validation_uncertainty),
    ]
    return {
        name: uncertainty.table() | {"worst_pose": errors.data.names[uncertainty.worst]}
        for name, errors, uncertainty in sets
        if uncertainty is not None and errors is not None
    }


def position_lines(fit: Fit) -> list[str]:
    """Return how well predicted positions are known, one line for each set of poses."""
    lines = []
    sets = [("poses used", fit.identification, fit.identification_uncertainty)]
    if fit.validation is not None and fit.validation_uncertainty is not None:
        sets.append(("poses not used", fit.validation, fit.validation_uncertainty))
    for name, errors, uncertainty in sets:
        summary = uncertainty.summary()
        lines.append(
            f"Predicted positions are known to {summary['mean']:.4f} mm on average, {summary['max']:.4f} mm at worst"
            f" (pose {errors.data.names[uncertainty.worst]}), over the {name},"
            f" {fit.uncertainty.counted}{uncertainty.remark()}"
        )
    return lines

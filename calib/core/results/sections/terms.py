"""Joint terms: what was asked for, what choosing them found, and where curves hold."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, display_scale, error_scale, quantity_text
from calib.core.base.words import listed
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.candidate_terms import not_known
from calib.core.fitting.terms.joint_curves import joint_curves
from calib.core.fitting.terms.term_choice import TELLS
from calib.core.robots.terms.terms import TERMS


def terms_table(fit: Fit) -> dict[str, object]:
    """Return what was asked for, the entries, what choosing them found, and where curves hold."""
    part = fit.identification.main_part
    scale, choice = error_scale(part.dimension), fit.terms
    tried = [] if choice is None else choice.tried
    return {
        "asked": None if choice is None else choice.requested,
        "entries": [section.model_dump(mode="json") for section in fit.robot.description.terms],
        "undecided": [section.model_dump(mode="json") for section in fit.undecided.terms] if fit.undecided else [],
        "unit": ERROR_UNIT[part.dimension],
        "tried": [
            {**asdict(trial), "before": scale * trial.before, "after": scale * trial.after, "proven": trial.proven}
            for trial in tried
        ],
        "curves": [
            {
                "joint": curve.joint,
                "unit": DISPLAY_UNIT[curve.dimension],
                "low": float(curve.command[0] * display_scale(curve.dimension)),
                "high": float(curve.command[-1] * display_scale(curve.dimension)),
                "error_unit": ERROR_UNIT[curve.dimension],
                "rms": curve.rms * error_scale(curve.dimension),
                "rms_std": curve.rms_std * error_scale(curve.dimension),
            }
            for curve in joint_curves(fit)
        ],
    }


def terms_lines(fit: Fit) -> list[str]:
    """Return what choosing joint terms found: what each brought, what was left out and why."""
    if fit.terms is None or not fit.terms.automatic:
        return [] if fit.terms is None else [f"Joint terms asked for: {fit.terms.requested}"]
    added: list[str] = []
    left: list[str] = []
    refused: list[str] = []
    shown: set[str] = set()
    for trial in fit.terms.tried:
        if trial.term in shown:
            continue
        shown |= set(trial.together)
        if np.isnan(trial.evidence):
            refused.append(f"{trial.term} ({trial.why})")
        else:
            dimension = fit.identification.main_part.dimension
            scale, unit = error_scale(dimension), ERROR_UNIT[dimension]
            numbers = (
                f"poses of blocks left out {scale * trial.before:.4f} -> {scale * trial.after:.4f} {unit} RMS,"
                f" log evidence {trial.evidence:+.1f}"
            )
            others = listed([_rival(kind, less) for kind, less in trial.alike.items() if kind not in trial.together])
            alike = f"; its kind is not certain, and may be {others}" if others else ""
            which = "; the data do not show which, so they were added together" if trial.together else ""
            name = " or ".join([trial.term, *trial.together])
            (added if trial.added else left).append(
                f"{name} ({trial.why}{': ' if trial.why else ''}{numbers}{which}{alike})"
            )
    count = len(fit.terms.tried)
    lines = [f"Joint terms added: {listed(added, '; ', count) or 'none, because none improves the prediction'}"]
    lines += [f"Joint terms left out: {listed(left, '; ', count)}"] if left else []
    return lines + ([f"Joint terms that could not be tried: {listed(refused, '; ', count)}"] if refused else [])


def _rival(kind: str, less: float) -> str:
    """What speaks for another kind of term whose log evidence is lower by `less`."""
    evidence = f"log evidence {abs(less):.1f} {'lower' if less > 0 else 'higher'}"
    return f"{kind} ({evidence}{', but blocks are predicted as well' if less >= TELLS else ''})"


def terms_added(fit: Fit) -> list[str]:
    """Return which joint terms were chosen, in a line; none where none were looked for."""
    if fit.terms is None or not fit.terms.automatic:
        return []
    added = [trial for trial in fit.terms.tried if trial.added]
    names = dict.fromkeys(" or ".join(sorted([trial.term, *trial.together])) for trial in added)
    return [f"Joint terms added: {', '.join(names) or 'none, because none improves the prediction of poses left out'}"]


def terms_not_shown(fit: Fit) -> list[str]:
    """Return which joint terms of the robot these measurements cannot show, in a line; none where they show all."""
    data, names = fit.identification.data, dict.fromkeys(section.term for section in fit.robot.description.terms)
    reasons = {name: why for name in names if (why := not_known(TERMS[name], data))}
    words = [f"{name} ({why})" for name, why in reasons.items()]
    return [f"Joint terms that these measurements cannot show: {listed(words, '; ')}"] if words else []


def curve_lines(fit: Fit) -> list[str]:
    """Return how large the error of each joint with a curve is, and where it was measured, one line each."""
    lines = []
    for curve in joint_curves(fit):
        rms, known = quantity_text(curve.rms, curve.dimension), quantity_text(curve.rms_std, curve.dimension, ".2g")
        low, high = (quantity_text(float(curve.command[k]), curve.dimension, ".4g", DISPLAY_UNIT) for k in (0, -1))
        lines.append(
            f"Error curve of {curve.joint}: {rms} RMS, known to {known}; it holds from {low.partition(' ')[0]} to"
            f" {high}, where it was measured"
        )
    return lines

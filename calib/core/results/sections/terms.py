"""Joint terms: the request, the choice, and where curves hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, in_unit, quantity_text
from calib.core.base.words import listing
from calib.core.fitting.fitted import Fit
from calib.core.fitting.terms.candidate_terms import TermTrial, why_term_unknown
from calib.core.fitting.terms.joint_curves import JointCurve, joint_curves
from calib.core.robots.terms.terms import TERMS


def terms_table(fit: Fit) -> dict[str, object]:
    """Return the requested terms, the entries of the description, the choice, and where curves hold."""
    choice = fit.terms
    tried = [] if choice is None else choice.trials
    return {
        "asked": None if choice is None else choice.requested,
        "entries": [section.model_dump(mode="json") for section in fit.robot.description.terms],
        "undecided": [section.model_dump(mode="json") for section in fit.undecided.terms] if fit.undecided else [],
        "tried": [{**asdict(trial), "proven": trial.proven} for trial in tried],
        "curves": [_curve_as_data(curve) for curve in joint_curves(fit)],
    }


def _curve_as_data(curve: JointCurve) -> dict[str, object]:
    unit, of_errors = DISPLAY_UNIT[curve.dimension], ERROR_UNIT[curve.dimension]
    low, high = (in_unit(end, unit) for end in (curve.low, curve.high))
    errors = {key: in_unit(getattr(curve, key), of_errors) for key in ("rms", "rms_std")}
    return {"joint": curve.joint, "unit": unit, "low": low, "high": high, "error_unit": of_errors, **errors}


def terms_lines(fit: Fit) -> list[str]:
    """Return the outcome for each kind of joint term: its size, and whether it is proven."""
    if fit.terms is None or not fit.terms.automatic:
        return [] if fit.terms is None else [f"Joint terms requested: {fit.terms.requested}"]
    tried, count = fit.terms.trials, len(fit.terms.trials)
    added = [_size_in_words(trial) for trial in tried if trial.added]
    left = [_size_in_words(trial) for trial in tried if not (trial.added or trial.refusal)]
    refused = [f"{trial.term} ({trial.refusal})" for trial in tried if trial.refusal]
    lines = [f"Joint terms added: {listing(added, '; ', count) or _why_none(tried)}"]
    lines += [line for trial in tried if trial.added for line in _coefficients(fit, trial.term)]
    others = {"the measurements neither show nor exclude": left, "these data cannot show": refused}
    return lines + [
        f"Joint terms that {what}: {listing(terms, '; ', count)}" for what, terms in others.items() if terms
    ]


def _size_in_words(trial: TermTrial) -> str:
    low, high = trial.size95
    if not trial.added:
        return f"{trial.term} (up to {high:.2g} times the usual size)"
    of = f" of {listing(list(trial.joints))}" if trial.joints else ""
    sure = "surely there" if trial.proven else "probably there"
    size = f"{trial.size:.2g} times what is usual ({low:.2g} to {high:.2g})"
    return f"{trial.term}{of} ({size}, {sure})"


def _coefficients(fit: Fit, kind: str) -> list[str]:
    """Return the coefficients of a kind that has one for each joint, in a line."""
    terms = [term for term in fit.robot.terms if type(term) is TERMS[kind] and len(term.parameters) == 1]
    found = [fit.parameters[term.parameters[0].name] for term in terms]
    clear = [c for c in found if abs(c.value_si) > float(c.half95_si)]
    sizes = [f"{c.name} {c.value:+.2g} {c.unit} ({c.low95:+.2g} to {c.high95:+.2g})" for c in clear]
    open_ = f"{len(found) - len(clear)} more that the measurements do not tell from zero"
    texts = [*sizes, *([open_] if len(clear) < len(found) else [])]
    return [f"Coefficients of {kind}: {listing(texts, '; ', len(texts))}"] if found else []


def terms_added(fit: Fit) -> list[str]:
    """Return the added joint terms in a line; no line if there was no choice."""
    if fit.terms is None or not fit.terms.automatic:
        return []
    added = [trial.term for trial in fit.terms.trials if trial.added]
    return [f"Joint terms added: {', '.join(added) or _why_none(fit.terms.trials)}"]


def _why_none(trials: Sequence[TermTrial]) -> str:
    shown = [trial.term for trial in trials if trial.lacks_measurements]
    if shown:
        return f"none, because these measurements are too few to fit {listing(shown)}; measure more poses"
    return "none, because none improves the prediction of poses left out"


def terms_not_shown(fit: Fit) -> list[str]:
    """Return the joint terms of the robot that these measurements cannot show, in a line; none if they show all."""
    data, names = fit.identification.data, dict.fromkeys(section.term for section in fit.robot.description.terms)
    reasons = {name: why for name in names if (why := why_term_unknown(TERMS[name], data))}
    words = [f"{name} ({why})" for name, why in reasons.items()]
    return [f"Joint terms that these measurements cannot show: {listing(words, '; ')}"] if words else []


def curve_lines(fit: Fit) -> list[str]:
    """Return the size of the error of each joint with a curve, and its measured range, one line each."""
    lines = []
    for curve in joint_curves(fit):
        rms, known = (
            quantity_text(curve.rms, ERROR_UNIT[curve.dimension]),
            quantity_text(curve.rms_std, ERROR_UNIT[curve.dimension], ".2g"),
        )
        low, high = (quantity_text(end, DISPLAY_UNIT[curve.dimension], ".4g") for end in (curve.low, curve.high))
        lines.append(
            f"Error curve of {curve.joint}: {rms} RMS, known to {known}; it holds from {low.partition(' ')[0]} to"
            f" {high}, where it was measured"
        )
    return lines

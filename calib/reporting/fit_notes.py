"""What a reader of a fit must know beside its tables, one line each: for the terminal and for the report page."""

from __future__ import annotations

import numpy as np

from calib.base.units import DISPLAY_UNIT, ERROR_UNIT, display_scale, error_scale, millimetres
from calib.base.words import counted, listed, sentence
from calib.fitting.fitted import Fit
from calib.fitting.outliers import outliers_in_words
from calib.fitting.terms.joint_curves import joint_curves
from calib.fitting.terms.term_choice import TELLS
from calib.judging import findings
from calib.judging.repeatability import repeatability, repeats
from calib.reporting.result_content import correlated


def notes(fit: Fit, *, brief: bool = False) -> list[str]:
    """Return what a reader must know beside the tables, one line each.

    Args:
        fit: The fit.
        brief: Leave out what a page tells in sections of its own: the noise found, what is left, what the poses
            determine, how sure positions are.
    """
    elsewhere = (_noise, _left, _determined, _held, _positions)
    order = (_size, _noise, _scatter, _terms, _left, _curves, _determined, _observability, _held, _positions)
    lines = [
        line
        for notes_of in (*order, _repeats, _options)
        if not (brief and notes_of in elsewhere)
        for line in notes_of(fit)
    ]
    if any(p.placement for p in fit.nominal.parameters):
        lines.append("'before' is the nominal robot, with only its base and targets placed")
    if fit.identification.data.ignored:
        lines.append(f"Columns that were not used: {', '.join(fit.identification.data.ignored)}")
    return lines


def _size(fit: Fit) -> list[str]:
    data, statistics = fit.identification.data, fit.statistics
    return [
        f"{counted(data.n_poses, 'pose')}, {counted(data.n_readings, 'reading')}, {statistics.freedom:.1f} degrees of"
        f" freedom, {fit.seconds:.3f} s"
    ]


def _noise(fit: Fit) -> list[str]:
    lines = []
    for noise in fit.noise:
        scale, unit = error_scale(noise.group.part.dimension), ERROR_UNIT[noise.group.part.dimension]
        of = f" of {noise.group.name}, {noise.group.part.name}" if len(fit.noise) > 1 else ""
        stated = "none was stated" if noise.stated is None else f"stated: {scale * noise.stated:.4g} {unit}"
        lines.append(f"Noise found{of}: {scale * noise.sigma:.4g} {unit} per axis ({stated})")
    return lines


def _scatter(fit: Fit) -> list[str]:
    """Beside the noise: what readings of a visit share, and whether the scatter agrees with what was stated."""
    lines = []
    if fit.statistics.shared is not None:
        lines.append(
            f"Readings of the same pose share errors: poses scatter {fit.statistics.shared.ratio:.2g} times as much as"
            " independent readings would. Intervals include it"
        )
    for name, offsets in fit.offsets.items():
        instrument = fit.nominal.instrument(name)
        axes = [(axis, part) for part in instrument.parts for axis in part.axes]
        sizes = [
            f"{axis} {error_scale(part.dimension) * size:.3g} {ERROR_UNIT[part.dimension]}"
            for (axis, part), size in zip(axes, offsets, strict=True)
        ]
        lines.append(
            f"All readings of {name} at a pose share an error (what the model leaves out): {', '.join(sizes)}."
            " Their weights allow for it, because that predicts poses left out better"
        )
    if fit.chi_square is not None:
        chi = fit.chi_square
        chance = f"chance of a larger value {chi.p_larger:.2g}, of a smaller one {chi.p_smaller:.2g}"
        lines.append(f"Chi-square of the stated noise: {chi.value:.1f} where {chi.freedom:.1f} is expected ({chance})")
    return lines


def _rival(kind: str, less: float) -> str:
    """What speaks for another kind of term whose log evidence is lower by `less`."""
    evidence = f"log evidence {abs(less):.1f} {'lower' if less > 0 else 'higher'}"
    return f"{kind} ({evidence}{', but blocks are predicted as well' if less >= TELLS else ''})"


def _terms(fit: Fit) -> list[str]:
    """What choosing joint terms found: what each brought, what was left out and why."""
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
            scale, unit = _unit(fit)
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


def _left(fit: Fit) -> list[str]:
    budget = findings.budget(fit)
    return [] if budget is None else [f"What is left: {budget.advice}"]


def _curves(fit: Fit) -> list[str]:
    lines = []
    for curve in joint_curves(fit):
        scale, unit = error_scale(curve.dimension), ERROR_UNIT[curve.dimension]
        shown = display_scale(curve.dimension)
        lines.append(
            f"Error curve of {curve.joint}: {scale * curve.rms:.3g} {unit} RMS, known to {scale * curve.rms_std:.2g}"
            f" {unit}; it holds from {shown * curve.command[0]:.4g} to {shown * curve.command[-1]:.4g}"
            f" {DISPLAY_UNIT[curve.dimension]}, where it was measured"
        )
    return lines


def _determined(fit: Fit) -> list[str]:
    return [*fit.determination.lines(), sentence(fit.determination.words())]


def _held(fit: Fit) -> list[str]:
    held = fit.nominal.description.held
    return [f"Held at nominal: {', '.join(held)}"] if held else []


def _observability(fit: Fit) -> list[str]:
    lines = [
        "Observability (scaled columns): "
        + ", ".join(f"{name} {value:.3g}" for name, value in fit.observability.items()),
    ]
    pairs = [f"{row['a']} and {row['b']} ({row['correlation']:+.3f})" for row in correlated(fit)]
    if pairs:
        lines.append(f"Estimates that move together ({counted(len(pairs), 'pair')}): {listed(pairs)}")
    return lines


def _positions(fit: Fit) -> list[str]:
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


def _repeats(fit: Fit) -> list[str]:
    lines = []
    scatter, _ = repeatability(fit.identification)
    if np.isfinite(scatter):
        lines.append(f"Scatter of the repeats: {millimetres(scatter):.4g} mm per axis")
    for name, errors in (("used", fit.identification), ("not used", fit.validation)):
        repeated = None if errors is None else repeats(errors)
        if repeated is not None:
            sizes = (repeated.accuracy_before, repeated.accuracy_after, repeated.repeatability)
            before, after, again = map(millimetres, sizes)
            lines.append(
                f"ISO 9283-style, {counted(len(repeated.poses), 'pose')} {name}: accuracy AP {before.mean():.3f} mm"
                f" before, {after.mean():.3f} after (largest {after.max():.3f}); repeatability RP {again.mean():.3f} mm"
                f" (largest {again.max():.3f})"
            )
    return lines


def _options(fit: Fit) -> list[str]:
    lines = []
    if fit.loss != "none":
        low = int(np.sum(fit.weights < 0.5))
        lines.append(
            f"Robust loss {fit.loss}: {low} of {fit.weights.size} points"
            f" {'has' if low == 1 else 'have'} less than half the weight"
        )
    lines += outliers_left_out(fit)
    if fit.starts is not None:
        scale, unit = _unit(fit)
        minima = [f"RMS {scale * m.rms:.4f} {unit} from {m.count}" for m in fit.starts.minima]
        failed = f", {fit.starts.failed} failed" if fit.starts.failed else ""
        lines.append(f"{counted(fit.starts.total, 'start')} (seed {fit.starts.seed}): {listed(minima, '; ')}{failed}")
    if fit.folds is not None:
        scale, unit = _unit(fit)
        rms = [f"{scale * value:.4f}" for value in fit.folds.rms]
        if fit.folds.setups:
            names = list(fit.nominal.description.setups)
            each = [f"{names[k]} {value}" for k, value in zip(fit.folds.setups, rms, strict=True)]
            lines.append(f"Setups left out in turn, each placed anew: RMS of {', '.join(each)} {unit}")
        else:
            folds = f"{fit.folds.count} folds (seed {fit.folds.seed})"
            lines.append(f"Cross-validation in {folds}: RMS of each {', '.join(rms)} {unit}")
    if fit.placed_later:
        places = dict.fromkeys(name.rpartition(".")[0] for name in fit.placed_later)
        lines.append(f"Placed by the poses that were not used, because only these show them: {listed(list(places))}")
    return lines


def _unit(fit: Fit) -> tuple[float, str]:
    """What an SI error of the main part is multiplied by for tables, and its unit there."""
    dimension = fit.identification.main_part.dimension
    return error_scale(dimension), ERROR_UNIT[dimension]


def outliers_left_out(fit: Fit) -> list[str]:
    """Return which outliers were left out, and the fit with them; no line where none were."""
    if fit.with_all is None:
        return []
    before, after = (either.identification.table()["after"]["rms"] for either in (fit.with_all, fit))
    scale, unit = _unit(fit)
    layout, left = fit.with_all.rows.layout, fit.rows.layout.n_readings
    several = layout.n_readings > len(np.unique(layout.visit))
    count = f" ({layout.n_readings - left} of {layout.n_readings} readings)" if several else ""
    return [
        f"Outliers left out{count}: {listed(outliers_in_words(fit.excluded), '; ')}. With them: RMS"
        f" {before:.4f} {unit}, noise {scale * fit.with_all.sigma:.4g} {unit}; without: RMS {after:.4f} {unit}"
    ]


def terms_added(fit: Fit) -> list[str]:
    """Return which joint terms were chosen, in a line; none where none were looked for."""
    if fit.terms is None or not fit.terms.automatic:
        return []
    added = [trial for trial in fit.terms.tried if trial.added]
    names = dict.fromkeys(" or ".join(sorted([trial.term, *trial.together])) for trial in added)
    return [f"Joint terms added: {', '.join(names) or 'none, because none improves the prediction of poses left out'}"]

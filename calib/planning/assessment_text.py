"""The text of `calib check`, and the same content as data."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from calib.core.base.parameter import Parameter
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import as_data, count_noun, listing, plain_text, sentence, text_table
from calib.core.commands.next_steps import NOISE, words_of
from calib.core.data.measurements import Measurements
from calib.core.numerics.identifiability import Rank
from calib.core.numerics.observability import INDICES
from calib.planning.assessment import CORRELATION_LIMIT, HARDLY, Assessment
from calib.planning.predicted_error import TaskIndex
from calib.shared.candidates import WHITENED
from calib.shared.null_space import UnseenGroup, describe_group, natural_coefficients

_SHOWN = 12  # names in a list
_FEW = 4  # names in the short answer
_LINES = 3  # lines of groups in the short answer
_WIDTH = 120  # characters
_MANY_POSITIONS = 6  # with fewer positions, almost any errors of a robot look like a motion of one body
_MOSTLY_COMMON = 0.5  # the error without a common motion is printed if it is below this part of the whole


def text_report(assessment: Assessment, source: str, *, verbose: bool = False) -> str:
    """Return an assessment of poses from a source, in words, as text; at most 40 lines unless `verbose`."""
    parts: list[str | Table] = [_heading(assessment, source), *_verdict(assessment, verbose), *_accuracy(assessment)]
    parts += ["", _counts(assessment)] if assessment.accuracy.maximum else []
    parts += [*assessment.determination.lines(), "", *_groups(assessment, verbose), ""]
    parts += [_observability(assessment), _parameters(assessment)] if verbose else []
    return plain_text([*parts, *_doubts(assessment, verbose)], _WIDTH, wrap=True).rstrip()


def to_dict(assessment: Assessment) -> dict[str, object]:
    """Return everything as data for JSON, in mm and deg; infinite and unknown numbers are None."""
    a = assessment
    names = [parameter.name for parameter in a.parameters]
    return as_data(
        {
            "n_poses": a.n_poses,
            "n_rows": a.n_rows,
            "sigma_mm": None if a.sigma == WHITENED else millimetres(a.sigma),
            "sigma_assumed": a.sigma_assumed,
            "rank_all": _rank(a.rank_all),
            "rank_free": _rank(a.rank_free),
            "rank_with_priors": a.determination.together.rank,
            "held": _held(a),
            "groups": [_group(a, k) for k in range(len(a.groups))],
            "undetermined": [
                [a.free_parameters[member].name for member in group.members] for group in a.undetermined_groups
            ],
            "elimination": [
                {"name": names[k], "condition": condition}
                for k, condition in zip(a.elimination.dropped, a.elimination.conditions, strict=True)
            ],
            "observability": {"scaled": a.scaled, "raw": a.raw},
            "parameters": _parameter_rows(a),
            "correlations": [{"a": first, "b": second, "r": r} for first, second, r in a.correlated_pairs()],
            "hardly_known": [{"name": name, "part": part} for name, part in a.hardly_known()],
            "accuracy_mm": _task(a.accuracy),
            "beside_common_motion_mm": millimetres(a.rms_without_common),
            "by_count": [
                {"count": row.count, "uniform": _task(row.uniform), "chosen": _task(row.chosen)} for row in a.by_count
            ],
            "near_singular": list(a.near_singular),
            "left_out": list(a.left_out),
        }
    )


def _heading(a: Assessment, source: str) -> str:
    noise = "" if a.sigma == WHITENED else f"; noise {quantity_text(a.sigma, 'mm', 'g')} per axis"
    noise += " (assumed: state it with --sigma-mm or in the description)" if a.sigma_assumed else ""
    return f"{count_noun(a.n_poses, 'pose')} ({source}), {a.n_rows} measured values{noise}"


def _held(a: Assessment) -> list[str]:
    return [parameter.name for parameter, free in zip(a.parameters, a.free, strict=True) if not free]


def _listed(names: Sequence[str], verbose: bool) -> str:
    return ", ".join(names) if verbose else listing(names, shown=_SHOWN)


def _verdict(a: Assessment, verbose: bool) -> list[str]:
    held = _held(a)
    lines = [f"Held at nominal: {_listed(held, verbose)}"] if held else []
    lines.append(sentence(a.determination.words()))
    if a.determination.missing:
        lines.append("Hold one of each of these, or add other poses:")
        lines += _groups_in_words(a.undetermined_groups, a.free_parameters, verbose)
    if a.near_singular:
        lines.append(
            f"Warning: {count_noun(len(a.near_singular), 'pose')} near a singularity of the loops:"
            f" {listing(a.near_singular, shown=_FEW)}"
        )
    return lines


def _groups_in_words(groups: Sequence[UnseenGroup], parameters: Sequence[Parameter], verbose: bool) -> list[str]:
    """Groups in words, in few lines unless `verbose`, with the number of omitted groups."""
    single = [parameters[group.members[0]].name for group in groups if len(group.members) == 1]
    alone = [f"  {', '.join(single)} {'has' if len(single) == 1 else 'have'} no effect"] if single else []
    texts = [describe_group(group, parameters) for group in groups if len(group.members) > 1]
    used = np.cumsum([-(-(len(text) + 2) // (_WIDTH - 4)) for text in texts])
    n_shown = len(texts) if verbose else int(np.sum(used <= _LINES))
    more = len(texts) - n_shown
    shown = [f"  {text}" for text in texts[:n_shown]]
    return [*alone, *shown, *([f"  {count_noun(more, 'more group')} with --verbose"] if more else [])]


def _groups(a: Assessment, verbose: bool) -> list[str]:
    """Groups of parameters that these poses cannot tell apart."""
    if not a.groups:
        return ["Every combination of the parameters shows in the readings."]
    dropped = [a.parameters[k].name for k in a.elimination.dropped]
    hold = f"To determine the rest, hold {_listed(dropped, verbose)}"
    hold += f" (condition number {a.elimination.conditions[-1]:.0f})"
    hold += "; these are held" if set(dropped) == set(_held(a)) else ""
    return ["These poses cannot tell apart:", *_groups_in_words(a.groups, a.parameters, verbose), hold]


def _observability(a: Assessment) -> Table:
    table = text_table(("columns", *INDICES), ("columns",), "Observability of the free parameters, poses alone")
    units = " or ".join(dict.fromkeys(parameter.unit for parameter in a.free_parameters))
    per_sigma, per_unit = ("noise", "noise") if a.sigma == WHITENED else ("m", "mm")
    table.add_row(f"scaled by sigma, {per_sigma}", *(f"{a.scaled[name]:.4g}" for name in INDICES))
    table.add_row(f"not scaled, {per_unit} per {units}", *(f"{a.raw[name]:.4g}" for name in INDICES))
    return table


def _parameters(a: Assessment) -> Table:
    headers = ("name", "unit", "expected error", "std after fit", "part left")
    table = text_table(headers, headers[:2], "Predicted uncertainty of the free parameters")
    for row in _parameter_rows(a):
        std = f"{row['std']:.4f}" if math.isfinite(row["std"]) else "unbounded"
        expected = "-" if math.isnan(row["part"]) else f"{row['sigma']:.4f}"
        part = f"{row['part']:.3f}" if math.isfinite(row["part"]) else "-"
        table.add_row(str(row["name"]), str(row["unit"]), expected, std, part)
    return table


def _doubts(a: Assessment, verbose: bool) -> list[str]:
    most = _SHOWN if verbose else _FEW
    correlated = [f"{first} with {second} {r:+.4f}" for first, second, r in a.correlated_pairs()]
    names = [f"{name} ({100 * part:.0f} %)" if math.isfinite(part) else name for name, part in a.hardly_known()]
    return [
        f"Correlations above {CORRELATION_LIMIT:g}: {listing(correlated, shown=most) if correlated else 'none'}",
        f"Hardly improved by these poses (more than {100 * HARDLY:.0f} % of the expected error is left):"
        f" {listing(names, shown=most) if names else 'none'}",
    ]


def _counts(a: Assessment) -> Table:
    headers = ("poses", "uniform: RMS", "max", "best of these: RMS", "max")
    table = text_table(headers, title="Predicted position error against number of poses, mm")
    for row in a.by_count:
        times = f" ({row.count // a.n_poses}x all)" if row.count > a.n_poses else ""
        table.add_row(f"{row.count}{times}", *_cells(row.uniform), *_cells(row.chosen))
    return table


def _accuracy(a: Assessment) -> list[str]:
    if not a.accuracy.maximum:
        return ["No free parameter moves a position. --verbose prints how well each parameter is determined."]
    if math.isfinite(a.accuracy.rms):
        rms, largest = (quantity_text(value, "mm", ".4f") for value in (a.accuracy.rms, a.accuracy.maximum))
        priors = " and the expected errors of the parameters" if any(p.prior for p in a.free_parameters) else ""
        lines = [
            f"With all {a.n_poses}: position error {rms} RMS, {largest} at worst, from measurement noise{priors}"
            " alone. It does not include what the model leaves out (backlash, bending), which more poses do not reduce."
        ]
    else:
        lines = [f"With all {a.n_poses}: position error unbounded, because what is not determined moves positions."]
    many = a.position_errors.size >= _MANY_POSITIONS
    if many and a.rms_without_common < _MOSTLY_COMMON * a.accuracy.rms:
        lines.append(
            "Most of this error moves all positions as one body, as an unknown place of the base does. Without that"
            f" part, positions at these poses are known to {quantity_text(a.rms_without_common, 'mm', '.4f')} RMS."
        )
    if a.left_out:
        lines.append(f"Not counted: {listing(a.left_out)} (only instruments at unknown places see it).")
    return lines


def _cells(task: TaskIndex | None) -> list[str]:
    """Root mean square and largest error in mm."""
    values = () if task is None else (task.rms, task.maximum)
    return [f"{millimetres(value):.4f}" if math.isfinite(value) else "unbounded" for value in values] or ["-", "-"]


def _task(task: TaskIndex | None) -> dict[str, object] | None:
    """The error in mm; unknown where no parameter moves a position."""
    if task is None:
        return None
    rms, largest = (millimetres(value or math.nan) for value in (task.rms, task.maximum))
    return {"rms": rms, "max": largest, "worst_pose": task.worst_pose}


def _rank(rank: Rank) -> dict[str, object]:
    return vars(rank) | {"singular_values": rank.singular_values.tolist(), "unclear": rank.unclear}


def _group(a: Assessment, k: int) -> dict[str, object]:
    moves = natural_coefficients(a.groups[k], a.parameters)
    return {
        "text": describe_group(a.groups[k], a.parameters),
        "members": [{"name": name, "moves": amount, "unit": unit} for name, amount, unit in moves],
    }


def _parameter_rows(a: Assessment) -> list[dict[str, Any]]:
    rows = zip(a.rows(), a.free_parameters, a.part_left, strict=True)
    return [row | {"prior": parameter.prior, "part": float(part)} for row, parameter, part in rows]


_POSES = ("--sigma-mm", "--parameters", "--result", "--task")
"""Options with the same meaning in all commands about poses."""


def advice_after_check(
    assessment: Assessment, robot: str, poses: object, data: Sequence[str], typed: Mapping[str, Sequence[str]]
) -> str:
    """Return the next step after an assessment; `data` are the poses as typed, empty if they were sampled."""
    if not data:
        words: tuple[str, ...] = ("calib", "sample", robot, "--count", "1000", "--seed", "1", "--out", "poses.csv")
        return f"Next: write poses to choose from: {shlex.join(words)}"
    if assessment.determination.missing:
        hold = "hold parameters that are named above (`held` in the description), or add poses, and check again"
        return f"Next: {hold}: {shlex.join(('calib', 'check', robot, *data, *words_of(typed, tuple(typed))))}"
    if isinstance(poses, Measurements):
        options = (*words_of(typed, NOISE), "--validate", "0.25", "--out", "out/robot")
        words = ("calib", "fit", robot, *data, *options)
        return f"Next: fit these measurements: {shlex.join(words)}"
    words = ("calib", "select", robot, *data, "--count", "40", *words_of(typed, _POSES), "--out", "chosen.csv")
    return f"Next: choose the poses to measure: {shlex.join(words)}"

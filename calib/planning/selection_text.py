"""The output of `calib select`: a table for people, data for programs, and the poses as CSV."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence

from rich.table import Table as Printed

from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import as_data, count_noun, plain_text, text_table
from calib.core.commands.next_steps import NOISE, words_of
from calib.core.data.instrument_cells import columns_in
from calib.core.data.measurements import Poses
from calib.core.data.plan_files import INSTRUMENT, TOGETHER
from calib.core.data.table_writing import format_table
from calib.core.data.tables import Table
from calib.core.numerics.observability import INDICES
from calib.core.robots.robot import Robot
from calib.planning.selection import Run, Selection
from calib.planning.selection_bound import CERTIFIED
from calib.planning.selection_problem import TASK
from calib.shared.candidates import WHITENED

_SHOWN = 8  # skipped candidates
_WIDTH = 120  # characters


def text_report(selection: Selection, poses: Poses) -> str:
    """Return the result of a selection as text."""
    parts: list[str | Printed] = [*_summary(selection, poses), _indices(selection), *_remarks(selection)]
    return plain_text(parts, _WIDTH, wrap=True).rstrip()


def to_dict(selection: Selection, poses: Poses) -> dict[str, object]:
    """Return the result as data for JSON; the task index in mm, unknown and infinite numbers None."""
    s = selection
    return as_data(
        {
            "index": s.index,
            "count": len(s),
            "candidates": len(poses),
            "chosen": [poses.names[k] for k in s.chosen],
            "instruments": list(s.instruments) or None,
            "before": _values(s.before),
            "after": _values(s.after),
            "after_raw": _values(s.raw),
            "measured_only": None if s.measured_only is None else _values(s.measured_only),
            "efficiency": s.efficiency,
            "efficiency_percent": 100 * s.efficiency if s.efficiency is not None else None,
            "bound": None if s.bound is None else _in_table_unit(s.index, s.bound),
            "runs": [_run(run, s, poses) for run in s.runs],
            "travel_joint_ranges": {"candidate_order": s.travel[0], "this_order": s.travel[1]},
            "rank": s.rank.rank,
            "rank_of_poses": s.rank_of_poses.rank,
            "n_parameters": s.rank.n_columns,
            "sigma_mm": None if s.sigma == WHITENED else millimetres(s.sigma),
            "sigma_assumed": s.sigma_assumed,
            "skipped": list(s.skipped),
            "already_measured": s.already_measured,
            "not_free": {poses.names[k]: hit for k, hit in enumerate(s.check.hits) if hit},
            "collisions_unchecked": s.check.unchecked or None,
            "unobstructed": None if s.unobstructed is None else _values(s.unobstructed),
            "seed": s.seed,
            "seconds": s.seconds,
            "selecting_seconds": s.selecting_seconds,
        }
    )


def format_poses(robot: Robot, selection: Selection, poses: Poses, table: Table) -> str:
    """Return the chosen poses as CSV in the order of measurement, with unchanged rows of the candidates' table."""
    comment = f"{_count_sentence(selection, poses)}, chosen by {selection.index}, in order of measurement"
    headers = [
        name if unit is None else f"{name} [{unit}]" for name, unit in zip(table.names, table.units, strict=True)
    ]
    lines = _lines_of(table, [(int(k), poses.names[k]) for k in selection.chosen])
    if selection.groups:
        rows = _plan(robot, selection, poses, table, lines)
    else:
        rows = [table.rows[line] for k in selection.chosen for line in lines[poses.names[k]]]
    columns = [(header, [row[c] for row in rows]) for c, header in enumerate(headers)]
    if selection.groups:
        columns = [(INSTRUMENT, list(selection.instruments)), *(each for each in columns if each[0] != INSTRUMENT)]
    if "pose" not in table.names:
        columns.insert(0, ("pose", [poses.names[k] for k in selection.chosen]))
    return format_table(columns, (comment,))


def _plan(
    robot: Robot, selection: Selection, poses: Poses, table: Table, lines: Mapping[str, Sequence[int]]
) -> list[tuple[str, ...]]:
    """Rows of a plan: one for each pose and its instruments; cells of other instruments are empty."""
    rows = []
    for k, together in zip(selection.chosen, selection.instruments, strict=True):
        instruments = [robot.instrument(name) for name in together.split(TOGETHER)]
        columns_read = {column for instrument in instruments for column in columns_in(instrument, table)}
        others = {column for instrument in robot.instruments for column in columns_in(instrument, table)} - columns_read
        touched = {name for instrument in instruments if instrument.touches for name in instrument.text_columns()}
        cells = (dict(zip(table.names, table.rows[line], strict=True)) for line in lines[poses.names[k]])
        row = next(row for row in cells if all(row[name] for name in touched))
        rows.append(tuple("" if name in others else cell for name, cell in row.items()))
    return rows


def _lines_of(table: Table, poses: Sequence[tuple[int, str]]) -> dict[str, list[int]]:
    """Rows of poses in the file, by name; a measured file may repeat a pose."""
    if "pose" not in table.names:
        return {name: [k] for k, name in poses}
    lines: dict[str, list[int]] = {name: [] for _, name in poses}
    for line, name in enumerate(table.text("pose")):
        if name in lines:
            lines[name].append(line)
    return lines


def _summary(s: Selection, poses: Poses) -> list[str]:
    lines = [f"{_count_sentence(s, poses)}, chosen by {s.index}"]
    if s.efficiency is not None and s.bound is not None:
        reached, least = s.after[s.index], math.floor(1000 * min(s.efficiency, 1.0)) / 10
        lines.append(
            f"Error over the task {quantity_text(reached, 'mm', '.5g')}; no choice of {len(s)} candidates goes below"
            f" {quantity_text(s.bound, 'mm', '.5g')} (certified)"
            if s.index == TASK
            else f"{s.index} = {reached:.5g}: at least {least:.1f} % of the best possible choice (certified)"
        )
    if s.index not in CERTIFIED and len(s.runs) == 1 and len(s) < len(poses):
        lines.append(f"No bound is known for {s.index}, and one start was tried: --starts 5 may find better")
    return lines


def _count_sentence(s: Selection, poses: Poses) -> str:
    """Number of chosen poses, and their instruments, in words."""
    if not s.groups:
        return f"{len(s)} of {len(poses)} poses ({poses.path})"
    with_each = ", ".join(f"{s.instruments.count(group)} with {group}" for group in s.groups)
    different = len(set(s.chosen.tolist()))
    return f"{with_each}; at {different} of {len(poses)} poses ({poses.path})"


def _indices(s: Selection) -> Printed:
    keys = [key for key in (*INDICES, TASK) if key in s.after]
    headers = ("", *(f"{key}, mm" if key == TASK else key for key in keys))
    table = text_table(headers, title="Indices (scaled columns; task: predicted position error)")
    rows = [("uniform", s.before), ("chosen", s.after)]
    if s.measured_only is not None:
        rows.insert(0, ("measured alone", s.measured_only))
    rows.append((f"chosen, not scaled: {'noise' if s.sigma == WHITENED else 'mm'} per unit", s.raw))
    for label, values in rows:
        table.add_row(label, *(f"{_in_table_unit(key, values[key]):.5g}" if key in values else "" for key in keys))
    return table


def _remarks(s: Selection) -> list[str]:
    lines = [f"Targets of any two poses are at least {quantity_text(s.distance, 'mm')} apart"] if s.distance else []
    lines += [
        f"Order of measurement: travel {s.travel[1]:.1f} joint ranges, {s.travel[0]:.1f} in the candidates' order"
    ]
    poses_meant = "candidates" if s.measured_only is None else "candidates and measured poses"
    if s.rank.rank < s.rank.n_columns:
        lines.append(
            f"Warning: all {poses_meant} together determine {s.rank.rank} of {s.rank.n_columns} free parameters;"
            " the indices are about those. `calib check` says which combinations are not determined."
        )
    elif s.rank_of_poses.rank < s.rank.rank:
        lines.append(
            f"All {poses_meant} together determine {s.rank_of_poses.rank} combinations of the {s.rank.n_columns} free"
            " parameters; the indices are about those, and priors hold the rest"
        )
    if s.sigma_assumed:
        lines.append("Unstated noise is assumed; state it with --sigma-mm or in the description")
    if s.already_measured:
        lines.append(f"{count_noun(s.already_measured, 'candidate')} already measured and left out")
    if s.unobstructed is not None:
        lines.append(f"Left out: {s.check.summary()}; the efficiency is that of the free candidates")
        lines.append(
            f"{s.index} is {_in_table_unit(s.index, s.after[s.index]):.5g};"
            f" {_in_table_unit(s.index, s.unobstructed[s.index]):.5g} if"
            f" all candidates were free ({100 * s.after[s.index] / s.unobstructed[s.index]:.1f} %)"
        )
    if s.skipped:
        lines.append(f"{count_noun(len(s.skipped), 'candidate')} skipped:")
        lines += [f"  {reason}" for reason in s.skipped[:_SHOWN]]
        lines += [f"  and {len(s.skipped) - _SHOWN} more"] if len(s.skipped) > _SHOWN else []
    lines.append(f"{s.seconds:.2f} s in all, {s.selecting_seconds:.2f} s for the choice")
    return lines


def _run(run: Run, s: Selection, poses: Poses) -> dict[str, object]:
    return {
        "start": run.start,
        "history": [_in_table_unit(s.index, value) for value in run.history],
        "paper_exchanges": run.n_paper,
        "exchanges": [
            {"added": _candidate(s, poses, added), "removed": _candidate(s, poses, removed)}
            for added, removed in run.exchanges
        ],
    }


def _candidate(s: Selection, poses: Poses, number: int) -> str:
    """Name of a candidate: its pose and, if instruments are chosen too, its group."""
    group, pose = divmod(number, len(poses))
    return f"{poses.names[pose]} ({s.groups[group]})" if s.groups else poses.names[pose]


def _values(values: dict[str, float]) -> dict[str, float]:
    return {key: _in_table_unit(key, value) for key, value in values.items()}


def _in_table_unit(index: str, value: float) -> float:
    """An index in its printed unit: mm for the task index."""
    return millimetres(value) if index == TASK else value


def advice_after_select(robot: str, out: str, typed: Mapping[str, Sequence[str]]) -> str:
    """Return the next step after a choice of poses, written to the file `out`."""
    options = ("--goal", "0.1mm", "--candidates", out, *words_of(typed, NOISE))
    words = ("calib", "watch", robot, "measured.csv", *options)
    return f"Next: measure them, and follow the measurement: {shlex.join(words)}"

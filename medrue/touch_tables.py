"""Tables of the calibrations without a tracker, with the tracker's and the authors' figures, and findings in words."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from scipy.spatial.distance import pdist

from calib.core.base.arrays import FloatArray
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun
from calib.planning.assessment import Assessment
from medrue.result_tables import Cell, ResultTable, TableColumn
from medrue.study import COUNT, SIGMA, STATISTICS, summary
from medrue.touch import BEFORE, TOOL_KNOWN, WAYS, TouchStudy
from medrue.touch_methods import ENCODER_SIGMA, Artefact

AUTHORS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {"mean": {BEFORE: 9.0, "touch": 0.2771}, "max": {BEFORE: 12.0, "touch": 0.320}}
)
"""Errors that the paper's authors print for their simulated calibration by touch (joubair2016) [mm]."""
_HEADINGS = {
    "world": "Position errors in the world, for each way of measuring",
    "shape": "Position errors after the best rigid motion of the predictions, for each way of measuring",
}


def touch_tables(study: TouchStudy) -> tuple[ResultTable, ...]:
    """Return all tables."""
    return (*(error_table(study, way) for way in WAYS), method_table(study), artefact_table(study))


def error_table(study: TouchStudy, way: str) -> ResultTable:
    """Errors at the 420 poses before calibration and after each method, judged in one of `WAYS`."""
    draws, robots = _summaries(study.noise, way), _summaries(study.by_actual, way).mean(axis=1)
    noise, others = f"{count_noun(len(draws), 'draw')} of noise", count_noun(len(robots), "actual robot")
    rows: list[tuple[str, list[Cell]]] = []
    for k, statistic in enumerate(STATISTICS):
        for what, values in ((noise, draws[:, :, k]), (others, robots[:, :, k])):
            rows.append((f"{statistic}, mean over {what}", values.mean(axis=0).tolist()))
            rows.append((f"{statistic}, spread over {what}", values.std(axis=0, ddof=1).tolist()))
        if way == "world" and statistic in AUTHORS:
            rows.append((f"{statistic}, authors", [AUTHORS[statistic].get(name) for name in study.names]))
    columns = [TableColumn("error [mm]", [label for label, _ in rows])]
    for m, name in enumerate(study.names):
        columns.append(TableColumn(name, [values[m] for _, values in rows], 3 if name == BEFORE else 4))
    notes = [
        f"simulated; distance from the true position at all {study.noise.shape[-1]} poses of the target workspace; seed"
        f" {study.seed}",
        f"every method measures {count_noun(COUNT, 'pose')}; draws of noise: for Table I's robot; actual robots:"
        f" drawn within +-2 mm and +-1.5 deg, {count_noun(study.by_actual.shape[1], 'draw')} of noise each;"
        " spread: one standard deviation",
    ]
    if way == "world":
        notes.append("authors: Sensors 2016, 16(6), 798, also simulated, with other touches, noise and poses")
    return ResultTable(way, _HEADINGS[way], tuple(columns), tuple(notes))


def method_table(study: TouchStudy) -> ResultTable:
    """Readings of each method, and its errors with those of theory."""
    names = tuple(method.name for method in study.methods)
    seen = [study.seen[name] for name in names]
    rms = np.sqrt(np.mean(study.noise[:, 1 : 1 + len(names), WAYS.index("world")] ** 2, axis=(0, 2)))
    predicted = [
        None if determined.parameters[0].prior else millimetres(study.selections[name].after["task"])
        for name, determined in zip(names, seen, strict=True)
    ]
    return ResultTable(
        "methods",
        "What each method reads, and what it cannot see",
        (
            TableColumn("method", names),
            TableColumn("rows", [determined.n_rows for determined in seen], 0),
            TableColumn("unknowns", [len(determined.parameters) for determined in seen], 0),
            TableColumn("rank", [determined.rank_all.rank for determined in seen], 0),
            TableColumn("predicted RMS [mm]", predicted, 4),
            TableColumn("RMS over draws [mm]", millimetres(rms), 4),
            TableColumn("cannot see", map(unseen, seen)),
        ),
        (
            f"simulated; noise: {quantity_text(SIGMA, 'um', '.0f')} on each axis,"
            f" {quantity_text(ENCODER_SIGMA, 'urad', '.0f')} of encoders that turn;"
            f" {count_noun(len(study.noise), 'draw')} of it on Table I's robot",
            "predicted: by theory, at nominal parameters, in the world; empty where readings alone do not determine it",
            "cannot see: parameters that have no effect, or an effect only in combination, at nominal",
        ),
    )


def artefact_table(study: TouchStudy) -> ResultTable:
    """How large the artefact with the sockets must be."""
    return ResultTable(
        "artefacts",
        f"Error in the target workspace predicted for the best {COUNT} touches of an artefact",
        (
            TableColumn("sockets of the artefact", map(_size, study.artefacts)),
            TableColumn("predicted RMS [mm]", map(millimetres, study.artefacts.values()), 4),
        ),
        (
            "the first is used; by theory, at nominal parameters, in the world: nothing measured or simulated",
            "empty: its touches do not determine the positions",
        ),
    )


def unseen(seen: Assessment) -> str:
    """Return what readings do not show, in names: `d31; d32; d5 with xt`."""
    groups = [[seen.parameters[member].name for member in group.members] for group in seen.groups]
    return "; ".join(group[0] + (f" with {', '.join(group[1:])}" if group[1:] else "") for group in groups)


def touch_findings(study: TouchStudy) -> tuple[str, ...]:
    """Say in words what the tables show."""
    world, shape = (_means(study, way) for way in WAYS)
    tracker, touch, anywhere, encoders = (method.name for method in study.methods)
    blind = study.seen[encoders]
    alone = [blind.parameters[group.members[0]].name for group in blind.groups if len(group.members) == 1]
    printed, last = AUTHORS["mean"], AUTHORS["max"]
    return (
        f"Touch takes the mean error from {world[BEFORE][0]:.2f} to {world[touch][0]:.4f} mm and the largest from"
        f" {world[BEFORE][1]:.2f} to {world[touch][1]:.4f} mm; the authors' from {printed[BEFORE]:g} to"
        f" {printed['touch']:g} mm and from {last[BEFORE]:g} to {last['touch']:g} mm, with other touches, noise and"
        " poses.",
        f"With as many rows and the same noise, the tracker leaves {world[tracker][0]:.4f} mm, and"
        f" {world[tracker][1]:.4f} mm at most: touch is {world[touch][0] / world[tracker][0]:.2f} times as far off on"
        f" average, {world[touch][1] / world[tracker][1]:.2f} times at the worst pose.",
        f"With the artefact at an unknown place, touch does not show the base ({world[anywhere][0]:.2f} mm in the"
        f" world), but still finds the robot's shape: {shape[anywhere][0]:.4f} mm after the best rigid motion,"
        f" {shape[touch][0]:.4f} mm with the artefact in a known place, {shape[tracker][0]:.4f} mm by the tracker.",
        f"Encoders alone take the mean error from {world[BEFORE][0]:.2f} to {world[encoders][0]:.2f} mm in the world,"
        f" and from {shape[BEFORE][0]:.2f} to {shape[encoders][0]:.2f} mm after the best rigid motion;"
        f" {shape[TOOL_KNOWN][0]:.2f} mm if the tool's place on the probe is known. They see"
        f" {blind.rank_all.rank} combinations of {len(blind.parameters)} unknowns, and nothing at all of"
        f" {', '.join(alone)}.",
        "Errors in these sentences are means over the draws of the noise on Table I's robot.",
    )


def _means(study: TouchStudy, way: str) -> dict[str, FloatArray]:
    """Mean, max, std and RMS over the poses, averaged over the draws on Table I's robot, by name, (4,) [mm]."""
    return dict(zip(study.names, _summaries(study.noise, way).mean(axis=0), strict=True))


def _summaries(distances: FloatArray, way: str) -> FloatArray:
    """Mean, max, std and RMS over the poses in one of `WAYS`, (..., n_names, 4) [mm]."""
    return np.asarray(millimetres(summary(distances[..., WAYS.index(way), :])))


def _size(artefact: Artefact) -> str:
    """How many sockets, and how far apart."""
    n = len(artefact.sockets)
    if n == 1:
        return "one"
    length, width = float(np.ptp(artefact.sockets[:, 0])), float(np.max(pdist(artefact.sockets[:, 1:])))
    return f"{n} on {quantity_text(length, 'mm', '.0f')} by {quantity_text(width, 'mm', '.0f')}"

"""The figures of ISO 9283 from repeated readings of a pose.

ISO 9283 requires 30 readings of five poses, approached anew each time, and uses the commanded position. Here the
position that the model predicts for the reading's own joint values replaces it; a motion that the joints report between
two readings is no scatter. Fewer readings give less certain numbers; readings taken without moving the robot show the
instrument alone. `calib.core.numerics.iso9283` has the equations.

Reference: iso9283.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.units import millimetres
from calib.core.fitting.error_sets import STATES, ErrorSet, repeats
from calib.core.instruments.kind import Instrument
from calib.core.numerics import iso9283
from calib.core.numerics.iso9283 import CYCLES, Figure

CONDITIONS = ("load", "speed", "temperature", "warm-up", "instrument", "certificate", "operator")
"""Conditions of a test that a file states in comments, such as `# load: 5 kg`."""
_FIVE = 5  # poses of the standard
_BLOCK = 10  # cycles of a block of the drift test
_HOURS = 8.0  # duration of the drift test
_SECONDS = 3600.0


@dataclass(frozen=True)
class IsoFigure:
    """One figure of ISO 9283.

    Attributes:
        name: `AP`, `RP`, `vAP`, `AD`, `RD`, `dAP` or `dRP`; for orientations with the axis, such as `AP_rx`.
        poses: The pose, or the two poses of a distance.
        cycles: Number of cycles of the pose that has the fewest.
        figure: Value and interval [m or rad].
    """

    name: str
    poses: str
    cycles: int
    figure: Figure

    @property
    def is_angle(self) -> bool:
        """Whether the figure is an angle."""
        return "_" in self.name


@dataclass(frozen=True, eq=False)
class PoseScatter:
    """Errors of one instrument at one pose, reading by reading."""

    instrument: Instrument
    pose: str
    readings: IntArray
    visits: IntArray
    before: FloatArray
    after: FloatArray


def _pose_scatters(errors: ErrorSet, part_name: str = "") -> list[PoseScatter]:
    """Errors (n, 3) of a part, else of positions, at poses that were read more than once."""
    result = []
    numbers = repeats(errors.data)
    for instrument, part, rows in errors.parts():
        if part.name != part_name if part_name else not part.is_position:
            continue
        name = instrument.name
        all_visits, number = errors.data.readings[name].visits, numbers[name][1]
        count = np.bincount(number)
        several = np.flatnonzero(count[number] > 1)
        several = several[np.argsort(number[several], kind="stable")]
        for group in np.split(several, np.cumsum(count[count > 1])[:-1]) if len(several) else ():
            before, after = (state[name][group][:, rows] for state in (errors.before, errors.after))
            visits = all_visits[group]
            result.append(PoseScatter(instrument, errors.data.names[visits[0]], group, visits, before, after))
    return result


def repeat_table(errors: ErrorSet) -> dict[str, Any] | None:
    """Return mean and largest AP and RP [mm] of points that were read more than once at a pose; None if none was."""
    several = _pose_scatters(errors)
    if not several:
        return None

    def summary(lengths: Iterable[float]) -> dict[str, float]:
        values = millimetres(np.array(list(lengths)))
        return {"mean": float(np.mean(values)), "max": float(np.max(values))}

    return {
        "n_poses": len({scatter.pose for scatter in several}),
        "n_readings": sum(len(scatter.after) for scatter in several),
        "pose_accuracy": {
            state: summary(float(np.linalg.norm(getattr(scatter, state).mean(axis=0))) for scatter in several)
            for state in STATES
        },
        "pose_repeatability": summary(iso9283.repeatability(scatter.after) for scatter in several),
    }


def repeatability(errors: ErrorSet) -> tuple[float, int]:
    """Return the pooled standard deviation of one reading about its pose's mean, per axis [m], and its degrees of
    freedom.

    NaN and 0 where no point was read more than once at a pose.
    """
    several = _pose_scatters(errors)
    freedom = sum(scatter.after.shape[1] * (len(scatter.after) - 1) for scatter in several)
    if freedom == 0:
        return float("nan"), 0
    squares = sum(float(np.sum((scatter.after - scatter.after.mean(axis=0)) ** 2)) for scatter in several)
    return float(np.sqrt(squares / freedom)), freedom


def scatter_within_poses(errors: ErrorSet) -> float:
    """Return the root mean square distance of a pose's positions from their mean [m], over all poses and targets.

    A position that was read once at its pose counts as 0.
    """
    squares = 0.0
    for scatter in _pose_scatters(errors):
        n_read = np.maximum(np.sum(np.isfinite(scatter.after), axis=0), 1)
        away = scatter.after - np.nansum(scatter.after, axis=0) / n_read
        squares += float(np.nansum(away**2 / n_read))
    return float(np.sqrt(squares / max(len(errors.errors("after")), 1)))


def doubtful_repeats(errors: ErrorSet) -> str:
    """Return what repeats may show in place of repeatability, in words; empty if the robot surely left each pose."""
    several = _pose_scatters(errors)
    places = errors.data.places
    if not several or any(np.ptp(places[scatter.visits]) >= len(scatter.visits) for scatter in several):
        return ""
    return (
        "repeats of a pose follow each other in the file: if the robot did not leave the pose between two repeats, RP"
        " is only the scatter of the instrument"
    )


def pose_error_over_repeatability(errors: ErrorSet, n_effective: float) -> tuple[float, float]:
    """Return the ratio of two noises of one reading, by the errors of pose means and by repeats, and its chance.

    Without errors of the model, the mean of n readings scatters by the noise of one reading, divided by the root of n.
    The ratio is NaN and its chance 1 if there are no repeats, or if they do not scatter at all.

    Args:
        n_effective: Number of parameters that they decided.
    """
    deviation, n_free = repeatability(errors)
    several = _pose_scatters(errors)
    freedom = 3.0 * len(several) - n_effective
    if not (np.isfinite(deviation) and deviation > 0 and freedom >= 1 - 1e-9):
        return float("nan"), 1.0
    squares = sum(len(scatter.after) * float(np.sum(scatter.after.mean(axis=0) ** 2)) for scatter in several)
    ratio = float(np.sqrt(squares / freedom)) / deviation
    return ratio, float(scipy.special.fdtrc(freedom, n_free, ratio**2))


def conditions(comments: Sequence[str], keys: Sequence[str] = CONDITIONS) -> dict[str, str]:
    """Return the conditions of the test in comment lines `key: value` of a file, by key."""
    stated = {}
    for line in comments:
        key, _, value = line.partition(":")
        if key.strip().lower() in keys and value.strip():
            stated[key.strip().lower()] = value.strip()
    return stated


def iso_figures(errors: ErrorSet, rng: np.random.Generator) -> tuple[list[IsoFigure], list[str]]:
    """Return the figures of ISO 9283 that the cycles allow, and the missing data for those that the standard requires.

    Args:
        errors: Errors after calibration, prediction minus read.
    """
    several, turned = _pose_scatters(errors), _pose_scatters(errors, "orientation")
    figures: list[IsoFigure] = []
    for scatter in several:
        off = -scatter.after
        figures.append(IsoFigure("AP", scatter.pose, len(off), iso9283.pose_accuracy(off)))
        figures.append(IsoFigure("RP", scatter.pose, len(off), iso9283.pose_repeatability(off, rng)))
    for scatter in turned:
        for axis, off in zip(("rx", "ry", "rz"), -scatter.after.T, strict=True):
            figures += _mean_and_scatter(f"AP_{axis}", f"RP_{axis}", scatter.pose, off)
    figures += [*_distances(errors, several), *_directions(errors, several), *_drifts(errors, several, rng)]
    return figures, _missing(errors, several, turned, figures)


def _mean_and_scatter(accuracy: str, scatter: str, poses: str, off: FloatArray) -> Iterator[IsoFigure]:
    yield IsoFigure(accuracy, poses, len(off), iso9283.mean_of(off))
    yield IsoFigure(scatter, poses, len(off), iso9283.three_deviations(off))


def _distances(errors: ErrorSet, several: list[PoseScatter]) -> Iterator[IsoFigure]:
    """AD and RD of the two poses of one instrument that are furthest apart, cycle by cycle."""
    predicted = [
        (np.mean(points + scatter.after, axis=0), scatter)
        for scatter in several
        if (points := _points(errors, scatter)) is not None
    ]
    pairs = [
        (b - a, start, end) for (a, start), (b, end) in combinations(predicted, 2) if start.instrument is end.instrument
    ]
    apart, start, end = max(pairs, key=lambda pair: np.linalg.norm(pair[0]), default=(np.zeros(3), None, None))
    if start is not None and end is not None and np.any(apart):
        n = min(len(start.after), len(end.after))
        off = iso9283.distances(-start.after[:n], -end.after[:n], apart)
        yield from _mean_and_scatter("AD", "RD", f"{start.pose} to {end.pose}", off)


def _points(errors: ErrorSet, scatter: PoseScatter) -> FloatArray | None:
    """Positions that were read, (n, 3) [m]; None of a kind that does not show them."""
    return scatter.instrument.points(errors.data.readings[scatter.instrument.name].values[scatter.readings])


def _directions(errors: ErrorSet, several: list[PoseScatter]) -> Iterator[IsoFigure]:
    """The vAP of every pose that was reached from several directions, if the file states these."""
    approach = errors.data.approach
    if approach is None:
        return
    for scatter in several:
        _, number = np.unique(approach[scatter.visits], axis=0, return_inverse=True)
        groups = [-scatter.after[number.reshape(-1) == k] for k in range(int(number.max()) + 1)]
        groups = [group for group in groups if len(group) > 1]
        if len(groups) > 1:
            n = min(len(group) for group in groups)
            yield IsoFigure("vAP", scatter.pose, n, iso9283.direction_variation(groups))


def _drifts(errors: ErrorSet, several: list[PoseScatter], rng: np.random.Generator) -> Iterator[IsoFigure]:
    """Both dAP and dRP of every pose with several blocks of cycles, where the file has a time."""
    time = errors.data.context.get("time")
    if time is None or not np.all(np.isfinite(time)):
        return
    for scatter in several:
        n_blocks = len(scatter.after) // _BLOCK
        if n_blocks > 1:
            order = np.argsort(time[scatter.visits], kind="stable")[: n_blocks * _BLOCK]
            figures = iso9283.drift(np.split(-scatter.after[order], n_blocks), rng)
            for name, figure in zip(("dAP", "dRP"), figures, strict=True):
                yield IsoFigure(name, scatter.pose, _BLOCK, figure)


def _missing(
    errors: ErrorSet, several: list[PoseScatter], turned: list[PoseScatter], figures: list[IsoFigure]
) -> list[str]:
    if not several:
        return [
            "no pose was read more than once: AP, RP, AD, RD are not known; give rows that repeat a pose the same name"
        ]
    time, present = errors.data.context.get("time"), {figure.name for figure in figures}
    cycles, hours = min(len(scatter.after) for scatter in several), 0.0 if time is None else np.ptp(time) / _SECONDS
    doubt, stated = doubtful_repeats(errors), conditions(errors.data.comments)
    unstated = ", ".join(key for key in CONDITIONS if key not in stated)
    lines = (
        (len(several) != _FIVE, f"{len(several)} repeated poses where ISO 9283 has five"),
        (cycles < CYCLES, f"{cycles} cycles of a pose where ISO 9283 has {CYCLES}"),
        (doubt, doubt),
        (not turned, "no orientation was read: no AP and RP of angles"),
        (
            "vAP" not in present,
            "no vAP: it needs cycles from several directions, and columns approach_<joint> that state these",
        ),
        (
            "dAP" not in present,
            f"no drift: it needs a column 'time', and {2 * _BLOCK} or more cycles of a pose over {_HOURS:g} h",
        ),
        ("dAP" in present and hours < _HOURS, f"drift over {hours:.1f} h where ISO 9283 has {_HOURS:g} h"),
        (unstated, f"conditions not stated: {unstated} (a comment line such as '# load: 5 kg')"),
    )
    return [text for is_missing, text in lines if is_missing]

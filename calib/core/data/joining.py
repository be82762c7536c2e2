"""Measurements put one after another: visits of several files, or several measurements in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from calib.core.base.errors import DataError
from calib.core.data.measurements import Measurements, Poses, check_repeats, measurements
from calib.core.instruments.kind import Readings
from calib.core.robots.robot import Robot
from calib.core.robots.terms.gravity import COLUMNS as GRAVITY_COLUMNS


def join_measurements(parts: Sequence[Measurements], robot: Robot) -> Measurements:
    """Put measurements one after another, as those of several files.

    If several number their poses from 1, later numbers continue the earlier ones, unless joint values repeat poses.
    `DataError` if a part is given twice, or is of a robot with other joints; or as `read_measurements`.
    """
    for k, again in enumerate(parts):
        if any(again is other for other in parts[:k]):
            raise DataError(f"{again.path}: is given twice, so that every reading would count as two; give it once")
        if again.robot is not None and again.robot.joint_names != robot.joint_names:
            raise DataError(f"{again.path}: is of '{again.robot.name}', whose joints are not those of '{robot.name}'")
    stated = [part.states_approach for part in parts]
    if any(part.approach is not None for part in parts):
        parts = [
            replace(part, approach=None if any(stated) and not known else part.approach_directions)
            for part, known in zip(parts, stated, strict=True)
        ]
    firsts = np.cumsum([0, *map(len, parts)]).tolist()
    shifted = [
        {name: replace(own, visits=own.visits + first) for name, own in part.readings.items()}
        for part, first in zip(parts, firsts, strict=False)
    ]
    names = dict.fromkeys(name for part in parts for name in part.readings)
    readings = {name: join_readings([own[name] for own in shifted if name in own]) for name in names}
    data = replace(measurements(join_poses(parts), readings), approach_assumed=not any(stated))
    try:
        check_repeats(data, robot)
    except DataError:
        numbered = [list(part.names) == [str(k + 1) for k in range(len(part))] for part in parts]
        if sum(numbered) < 2:
            raise
        counted_on = (
            map(str, range(first + 1, first + 1 + len(part))) for part, first in zip(parts, firsts, strict=False)
        )
        named = [own if known else part.names for part, own, known in zip(parts, counted_on, numbered, strict=True)]
        data = replace(data, names=tuple(chain.from_iterable(named)))
        check_repeats(data, robot)
    return data


def join_poses(parts: Sequence[Poses]) -> Poses:
    """Put the visits of several files one after another.

    `DataError` if one file states directions of approach, or of gravity, and another does not.
    """
    if len(parts) == 1:
        return parts[0]
    keys = dict.fromkeys(key for part in parts for key in part.context)
    for key in keys:
        lacking = next((part.path for part in parts if key in GRAVITY_COLUMNS and key not in part.context), None)
        if lacking is not None:
            raise DataError(
                f"{lacking}: has no column '{key}', but another file has it; give it in all files, or in none"
            )
    setups = [np.zeros(len(part), dtype=np.intp) if part.setups is None else part.setups for part in parts]
    approach = [part.approach for part in parts if part.approach is not None]
    if 0 < len(approach) < len(parts):
        silent = next(part.path for part in parts if part.approach is None)
        raise DataError(
            f"{silent}: states no directions of approach, but another file does; give them in all files, or in none"
        )
    return Poses(
        np.concatenate([part.joints for part in parts]),
        tuple(chain.from_iterable(part.labels for part in parts)),
        tuple(chain.from_iterable(part.names for part in parts)),
        ", ".join(part.path for part in parts),
        tuple(dict.fromkeys(chain.from_iterable(part.ignored for part in parts))),
        comments=tuple(dict.fromkeys(chain.from_iterable(part.comments for part in parts))),
        setups=np.concatenate(setups) if any(part.setups is not None for part in parts) else None,
        approach=np.concatenate(approach) if approach else None,
        robot=parts[0].robot,
        context={
            key: np.concatenate([part.context.get(key, np.full(len(part), np.nan)) for part in parts]) for key in keys
        },
    )


def join_readings(parts: Sequence[Readings]) -> Readings:
    """Return the readings of one instrument in several files as one.

    `DataError` if some files state standard deviations, and some do not.
    """
    if len(parts) == 1:
        return parts[0]
    with_covariance = [part.covariance for part in parts if part.covariance is not None]
    if with_covariance and len(with_covariance) < len(parts):
        raise DataError("standard deviations are given in one file and not in another; give them in all, or in none")
    labels = [part.labels for part in parts if part.labels is not None]
    return Readings(
        np.concatenate([part.visits for part in parts]),
        np.concatenate([part.pairs for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate(with_covariance) if with_covariance else None,
        np.concatenate([part.details for part in parts]),
        tuple(chain.from_iterable(labels)) if len(labels) == len(parts) else None,
    )

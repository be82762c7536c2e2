"""Rows of very many readings, batch by batch.

The identification Jacobian of a million readings of positions takes a gigabyte, and what is made of it on the way (by
all parameters, by those that are free, whitened, weighed, times the root of their covariance) one more each time. So
its rows are made for some visits at a time, which stay in the processor's cache, and

    reduced    at every point of an iteration, to the triangular factor of [J r], to products J^T v, and to J d
    kept       numbers of a visit, a reading or a row: joint values, residuals, weights, what is known of noise;
               and J itself once, whitened, at the solution (`calib.core.rows.rows.Rows`), of which findings ask much
    never kept J T, with T the root of the covariance: it is multiplied where it is read
    (`calib.core.numerics.tall.Span`)

Few rows are one batch, and what was computed of them stays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import IntArray, as_slice
from calib.core.instruments.kind import Readings
from calib.core.robots.acceleration import compiled_for, many
from calib.core.robots.configurations import Configurations
from calib.core.robots.robot import Robot
from calib.core.rows.observed import Observed, observe, some_readings
from calib.core.rows.rows import Layout

ROWS_AT_ONCE = 1 << 14


@dataclass(frozen=True, eq=False)
class Batch:
    """Some visits, and where the readings made there are.

    Attributes:
        visits: The visits, one after another.
        readings: Their places among all readings of each instrument, by name, (n_of_batch,).
        rows: Places of their rows among all rows, instrument by instrument, (n_rows_of_batch,).
    """

    visits: slice
    readings: Mapping[str, IntArray | slice]
    rows: IntArray | slice


def batches_of(layout: Layout) -> tuple[Batch, ...]:
    """Cut rows into batches of whole visits; few rows are one."""
    n_visits = int(layout.visit.max(initial=-1)) + 1
    if layout.n_rows <= ROWS_AT_ONCE:
        return (Batch(slice(0, n_visits), dict.fromkeys(layout.instruments, slice(None)), slice(None)),)
    ends = np.cumsum(np.bincount(layout.visit[layout.reading], minlength=n_visits))
    cuts = np.searchsorted(ends, np.arange(ROWS_AT_ONCE, layout.n_rows, ROWS_AT_ONCE)) + 1
    edges = np.unique(np.concatenate([[0], cuts, [n_visits]]))
    orders = {name: np.argsort(layout.visit[layout.readings_of(name)], kind="stable") for name in layout.instruments}
    places = {
        name: np.searchsorted(layout.visit[layout.readings_of(name)][order], edges) for name, order in orders.items()
    }
    batches = []
    for k in range(len(edges) - 1):
        readings = {name: orders[name][places[name][k] : places[name][k + 1]] for name in layout.instruments}
        rows = np.concatenate([layout.rows_of_readings(name, chosen) for name, chosen in readings.items()])
        own = {name: as_slice(chosen) for name, chosen in readings.items()}
        batches.append(Batch(slice(int(edges[k]), int(edges[k + 1])), own, as_slice(rows)))
    return tuple(batches)


def observed_in(
    robot: Robot,
    configurations: Configurations,
    readings: Mapping[str, Readings],
    batches: Sequence[Batch],
    *,
    joints: bool = False,
    derivatives: bool = True,
    index: IntArray | None = None,
) -> Iterator[tuple[Batch, dict[str, Observed]]]:
    """Compare readings with what the robot predicts, batch by batch; see `calib.core.rows.observed.observe`.

    Args:
        robot, configurations, readings, joints, derivatives, index: As there.
        batches: Which there are.
    """
    if len(batches) == 1:
        yield batches[0], observe(robot, configurations, readings, joints=joints, derivatives=derivatives, index=index)
        return
    for batch in batches:
        own = {
            name: some_readings(readings[name], chosen, batch.visits.start) for name, chosen in batch.readings.items()
        }
        at = configurations.at(batch.visits)
        with compiled_for(len(configurations.actuated), many(robot.mechanism)):
            observed = observe(robot, at, own, joints=joints, derivatives=derivatives, index=index)
        yield batch, observed

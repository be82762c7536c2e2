"""Rows of many robots that differ in values alone, at the same visits: one after another, by compiled code.

What does not depend on values is computed once: which joints count, what moves which rows, joint values without those
that loops decide. What is left of a robot are its origins and their twists, in arrays with one more axis, and calls of
compiled functions: no `Robot` is made, and no `Problem`. The numbers are those of `calib.core.rows.observed`.

When it fails. A robot of which a loop does not close at once has no rows here. Instruments with unknown numbers of
their own, those that read joints, those that look along several pairs of frames, and joint terms are left to
`calib.core.rows.observed` (`ManyRobots.of` gives None).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.instruments.kind import Comparison, FrameInstrument, Readings, View
from calib.core.robots import kinematics
from calib.core.robots.acceleration import kernels
from calib.core.robots.continuation import compiled_loops
from calib.core.robots.mechanism import RelativeFrame, before_origins
from calib.core.robots.parameters import OfManyValues
from calib.core.robots.robot import Robot
from calib.core.rows.whitening import Whitening


@dataclass(frozen=True, eq=False)
class ManyRobots:
    """Compares many robots with readings of the same visits; `of` makes one.

    Attributes:
        robot: One of them.
        index: By which parameters to differentiate, (k,).
        whitening: Of all readings.
        driven: Joints that are given, (n, n_driven) [m or rad].
        pairs: What each instrument looks along, by name.
    """

    robot: Robot
    index: IntArray
    whitening: Whitening
    driven: FloatArray
    pairs: Mapping[str, RelativeFrame]

    @staticmethod
    def of(
        robot: Robot, driven: FloatArray, readings: Mapping[str, Readings], index: IntArray, whitening: Whitening
    ) -> ManyRobots | None:
        """Prepare many robots; None where that is not possible, or nothing compiled is to be used.

        Args:
            robot: One of them.
            driven: Joints that are given, at all visits, (n, n_driven) [m or rad].
            readings: Of each instrument, by name.
            index: By which parameters to differentiate, (k,).
            whitening: Of the readings.
        """
        every, pairs = np.arange(len(driven)), dict[str, RelativeFrame]()
        if (
            kernels(robot.mechanism, len(driven)) is None
            or len(robot.parameters) > robot.n_origin_parameters
            or len(whitening.batches) > 1
        ):
            return None
        for name, own in readings.items():
            instrument = robot.instrument(name)
            once = np.array_equal(own.visits, every) and len(np.unique(own.pairs)) == 1
            if not (once and isinstance(instrument, FrameInstrument)):
                return None
            pairs[name] = robot.pairs(instrument)[own.pairs[0]]
        return ManyRobots(robot, index, whitening, driven, pairs)

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key not in ("shared", "closing")}

    @cached_property
    def shared(self) -> kinematics.Shared:
        """What the frames that are looked at share."""
        return self._around(tuple(dict.fromkeys(self.pairs.values())) + self.robot.nominal.loops)

    @cached_property
    def closing(self) -> kinematics.Shared:
        """The same of the loops alone."""
        return self._around(self.robot.nominal.loops)

    def _around(self, pairs: tuple[RelativeFrame, ...]) -> kinematics.Shared:
        mechanism = self.robot.nominal
        return kinematics.Shared(mechanism, pairs, kernels(mechanism, len(self.driven)))

    def rows(
        self, values: FloatArray, passive: FloatArray, readings: Sequence[Mapping[str, Readings]]
    ) -> Iterator[tuple[FloatArray, FloatArray] | None]:
        """Yield whitened residuals (n_rows,) and their derivative (n_rows, k) [per m or rad] of each robot.

        Args:
            values: Of all parameters of each, (n_robots, n_parameters).
            passive: Passive joints to start from, (n_robots, n, n_passive); these become those of closed loops.
            readings: What was read of each, by instrument.

        Yields:
            None where a loop does not close at once.
        """
        shared, counts = self.shared, self.shared.reduced.joints
        placements, twists = self._origins(values)
        closed = self._close(placements, passive)
        before = before_origins(placements[:, counts], twists[:, counts])
        places, columns = np.nonzero(np.any(before != 0.0, axis=(0, 2)))
        along = before[:, places, :, columns].transpose(1, 0, 2)
        order = np.argsort(np.any(along[:, :, 3:] != 0.0, axis=(0, 2)), kind="stable")
        places, columns, along = places[order], columns[order], np.ascontiguousarray(along[:, order])
        for k in range(len(values)):
            tree = shared.tree._replace(origins=placements[k][counts])
            yield self._row(tree, passive[k], (places, columns, along[k]), readings[k]) if closed[k] else None

    def _row(
        self,
        tree: Any,
        passive: FloatArray,
        entries: tuple[IntArray, IntArray, FloatArray],
        readings: Mapping[str, Readings],
    ) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals and derivative of one robot."""
        shared, mechanism, n = self.shared, self.robot.nominal, len(passive)
        swept = kinematics.compiled_sweep(shared, mechanism.all_joints(self.driven, passive), tree)
        residuals, columns = {}, {}
        for name, pair in self.pairs.items():
            instrument = self.robot.instrument(name)
            comparison = instrument.compare(View(*kinematics.seen_frame(swept, pair)), np.zeros(0), readings[name])
            assert isinstance(comparison, Comparison)  # of a kind that looks at frames
            each = 6 if np.any(comparison.by_twist[:, :, 3:]) else 3
            places, moves, signs = _looked_along(shared, pair, each)
            motion, direct = np.empty((n, each, len(self.index))), np.zeros((each, len(mechanism.passive)))
            shared.functions.motion(tree, shared.loops, swept.compiled, places, signs, direct, moves, entries, motion)
            by_twist = comparison.by_twist[:, :, :each]
            whole = by_twist.shape[1] != each or np.any(by_twist != np.eye(each))
            residuals[name], columns[name] = comparison.residuals, np.matmul(by_twist, motion) if whole else motion
        return self.whitening.flatten(residuals), self.whitening.flatten(columns, in_place=True)

    def _origins(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origins of each robot, (n_robots, n_joints, 12), and their twists by the parameters."""
        mechanism, parametrisation = self.robot.nominal, self.robot.parametrisation
        placements = np.repeat(mechanism.placements[None], len(values), axis=0)
        twists = np.zeros((len(values), mechanism.n_joints, 6, len(self.index)))
        if isinstance(parametrisation, OfManyValues):
            poses, moved = parametrisation.of_many(values)
            for name, pose in poses.items():
                place = mechanism.origin_names.index(name)
                placements[:, place], twists[:, place] = pose, moved[name][:, :, self.index]
            return placements, twists
        for k, own in enumerate(values):
            for name, pose in parametrisation.placements(own).items():
                place = mechanism.origin_names.index(name)
                placements[k, place, :9], placements[k, place, 9:] = pose.rotation.T.ravel(), pose.translation
            for name, twist in parametrisation.twists(own).items():
                twists[k, mechanism.origin_names.index(name)] = twist[:, self.index]
        return placements, twists

    def _close(self, placements: FloatArray, passive: FloatArray) -> BoolArray:
        """Close the loops as `calib.core.robots.continuation.newton` does, passive joints in place; which did."""
        mechanism, mode, closing, n = self.robot.nominal, self.robot.mode, self.closing, len(self.driven)
        if not mechanism.loops:
            return np.ones(len(placements), dtype=bool)
        fast, counts, n_passive = closing.functions, closing.reduced.joints, passive.shape[2]
        loops, rest, scale, limits = compiled_loops(fast, mechanism, mode, self.driven, checked=False)
        found = np.zeros((0, n_passive, n_passive)), np.zeros((0, n_passive, self.driven.shape[1]))
        ok = np.zeros((len(placements), n), dtype=bool)
        for k, own in enumerate(placements):
            tree = closing.tree._replace(origins=own[counts])
            fast.close(tree, *loops, rest, passive[k], scale, *limits, *found, ok[k])
        return np.all(ok, axis=1)


def _looked_along(shared: kinematics.Shared, pair: RelativeFrame, each: int) -> tuple[IntArray, IntArray, FloatArray]:
    """What compiled code needs of rows along a pair: places (4, n_rows), joints that move alike, and signs."""
    mechanism, index = shared.mechanism, shared.reduced.places
    signs = np.repeat(mechanism.between(pair)[None], each, axis=0)
    along = shared.along(None, signs)
    places = np.array([(index[pair.a], index[pair.b], row % 3, row // 3) for row in range(each)]).T.copy()
    return places, along.alike, np.ascontiguousarray(along.signs)

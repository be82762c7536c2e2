"""Straight moves for a controller with the nominal model, cut so that the real robot goes straight.

A controller gets positions. For every point on the straight line between two of them, it computes joint values by its
nominal inverse kinematics. With T the position of the tool at given joint values, the real tool is then at

    g(p) = T_calibrated( T_nominal^-1 (p) )

The compensated position p' with g(p') = p is exact at the waypoints. Between waypoints the controller moves straight in
p', and the tool follows the image of this line under g, which deviates by half the curvature of g^-1 times the square
of the length. The deviation is computed, not estimated: g is compared with the programmed position in the middle of
every piece and at three or more other points, one in every 2 mm. These points are spaced unevenly, so that no error
that repeats along the path (a screw, a belt) hides between them. A move that deviates by more than the tolerance is cut
into more pieces, and all of them are computed again.

Frame. Points are in the frame of the program (`calib.programs.reaching.correction_frames`), with the description's
tool, which is the controller's tool too. Calibrated positions of reflector and tracker move no point. Real and nominal
robot are compared at the reflector on their links. Backlash counts as the mean of both directions, since a path may
turn anywhere. If the verdict finds nothing to correct, all moves stay unchanged.

When it fails. Near a singular pose g bends so much that no pieces are short enough: an error names the move.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import ComputationError, DataError, InputError, UnreachablePoseError
from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.robots.parametrisation import result_use
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Condition
from calib.core.rows.frames import KnownRobot
from calib.programs.reaching.compensation import compensate_in
from calib.programs.reaching.correction_frames import Calibrated, CorrectionFrame, known_robot, program_frame
from calib.programs.reaching.expected_errors import FramedErrors, words_of
from calib.programs.reaching.goals import Goals
from calib.programs.reaching.inverse import TOLERANCE, problem
from calib.programs.reaching.joint_commands import commands_for
from calib.programs.reaching.reaching import GoalConfigurations, descend

_MEASURED_EVERY = 2e-3  # distance of checked points along a piece [m]
_AT_LEAST = 3  # checked points of a piece on each side of its middle
_GOLDEN = 0.6180339887498949  # fractional parts of its multiples fill an interval evenly
_SHORTEST = 5e-5  # length of a piece [m]
_RESERVE = 1.1  # factor on the number of pieces that a parabola would need
_CHUNK = 4096  # points at once


@dataclass(frozen=True, eq=False)
class StraightMoves(ReadOnlyArrays):
    """Straight moves of a program.

    Attributes:
        starts: Start of each move in the description's measurement frame, (n, 3) [m]; NaN where unknown.
        ends: End of each move, (n, 3) [m].
        labels: Name of each move in messages.
    """

    starts: FloatArray
    ends: FloatArray
    labels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class CompensatedMoves(FramedErrors):
    """Commands for the controller.

    Attributes:
        waypoints: Points of each move, joined by straight lines; the last is its end, (n_pieces, 3) [m].
        before: Errors of the tool at the ends of moves without compensation, (n,) [m].
        expected: Root mean square error that remains there, from the uncertainty of the parameters, (n,) [m]; NaN
            where the uncertainty of the robot is unknown.
        deviations: Largest errors of each move between waypoints, (n,) [m]; NaN for a move without length or known
            start.
        n_measured: Number of points at which `deviations` was computed.
    """

    waypoints: tuple[FloatArray, ...]
    before: FloatArray
    expected: FloatArray
    deviations: FloatArray
    n_measured: int


class _MovePieces(NamedTuple):
    """A move in pieces: waypoints and joints from its start on, (n_pieces + 1, 3), and the errors at its end [m]."""

    waypoints: FloatArray
    q: FloatArray
    before: float
    expected: float


def require_nominal_controller(robot: Robot) -> None:
    """Raise `InputError` for a robot whose controller gets the result itself, such as a delta printer's firmware."""
    use = result_use(robot.description)
    if use is not None and use.held_by_controller:
        raise InputError(f"{robot.name}: {use.held_by_controller}")


def compensate_moves(
    calibrated: Robot | Calibrated | KnownRobot, moves: StraightMoves, tolerance: float
) -> CompensatedMoves:
    """Change straight moves so that the calibrated robot goes straight where the nominal robot would.

    Args:
        calibrated: A fit, a loaded result or a robot, with three motors.
        moves: Moves of the program.
        tolerance: Allowed error of the tool between points [m].

    Raises:
        DataError: The robot does not have three motors.
        InputError: The tolerance is not positive, or the robot is a delta printer.
        UnreachablePoseError: Points out of reach.
        ComputationError: No pieces are short enough for the tolerance.
    """
    known = known_robot(calibrated)
    robot = known.robot
    require_nominal_controller(robot)
    if len(robot.joint_names) != 3:
        raise DataError(
            f"{robot.name}: has {count_noun(len(robot.joint_names), 'motor')}; a program of X, Y and Z is for a machine"
            " of three, Cartesian or delta; give joints or poses (CSV)"
        )
    if not tolerance > 0:
        raise InputError("the tolerance between points must be positive")
    directed = (term for term in robot.terms if Condition.APPROACH in term.depends_on)
    without = robot.with_parameters({parameter.name: 0.0 for term in directed for parameter in term.parameters})
    frame = program_frame(replace(known, robot=without))
    lengths = np.linalg.norm(moves.ends - moves.starts, axis=1)
    pieces = np.ones(len(lengths), dtype=np.intp)
    ways: dict[int, _MovePieces] = {}
    deviations, n_measured = np.full(len(lengths), np.nan), 0
    active = np.arange(len(lengths))
    if frame.nothing_to_correct:
        ways, active = _pieces_by_move(frame, moves, active, pieces), active[:0]
    while len(active):
        ways |= _pieces_by_move(frame, moves, active, pieces[active])
        active = active[lengths[active] > 0]  # a NaN length (unknown start) fails the comparison too
        off, n = _deviations(frame, moves, {k: ways[k] for k in map(int, active)})
        deviations[active], n_measured = off, n_measured + n
        active, off = active[off > tolerance], off[off > tolerance]
        needed = np.ceil(_RESERVE * pieces[active] * np.sqrt(off / tolerance)).astype(np.intp)
        pieces[active] = np.maximum(needed, 2 * pieces[active])
        for k in np.flatnonzero(lengths[active] / pieces[active] < _SHORTEST)[:1]:
            raise ComputationError(
                f"{moves.labels[active[k]]}: off by {quantity_text(off[k], 'mm', '.4f')} between points, and pieces of"
                f" {quantity_text(_SHORTEST, 'mm', 'g')} do not bring that below {quantity_text(tolerance, 'mm', 'g')};"
                " the robot is near a singular pose there: keep away from it, or allow more"
            )
    waypoints, _, before, expected = zip(*(ways[k] for k in range(len(lengths))), strict=True)
    return CompensatedMoves(
        tuple(points[1:] for points in waypoints),
        np.array(before),
        np.array(expected),
        deviations,
        n_measured,
        **words_of(frame),
    )


def _pieces_by_move(
    frame: CorrectionFrame, moves: StraightMoves, active: IntArray, pieces: IntArray
) -> dict[int, _MovePieces]:
    """The active moves in pieces, by the number of the move."""
    points = []
    for k, n in zip(active, pieces, strict=True):
        start, end, share = moves.starts[k], moves.ends[k], np.arange(n + 1)[:, None] / n
        start = np.where(np.isnan(start), end, start)
        points.append(np.where(share == 1, end, (1 - share) * start + share * end))
    goals = np.concatenate(points)
    fresh = np.append(True, np.any(np.diff(goals, axis=0) != 0, axis=1))  # a move mostly starts at the last one's end
    labels = tuple(moves.labels[k] for k in np.repeat(active, pieces + 1)[fresh])
    compensated = compensate_in(frame, Goals(goals[fresh], labels=labels))
    misses = list(dict.fromkeys(compensated.unreached_rows()))
    if misses:
        raise UnreachablePoseError(
            f"{count_noun(len(misses), 'point')} cannot be compensated: {listing(misses, '; ')}; change the program"
            f" there"
        )
    at, cuts = np.cumsum(fresh) - 1, np.cumsum(pieces + 1)[:-1]
    sent = goals[fresh] if frame.nothing_to_correct else compensated.controller_poses(frame.nominal)[0]
    parts = (sent, compensated.q, compensated.before, compensated.expected)
    of_moves = zip(*(np.split(part[at], cuts) for part in parts), strict=True)
    return {
        int(k): _MovePieces(waypoints, q, float(before[-1]), float(expected[-1]))
        for k, (waypoints, q, before, expected) in zip(active, of_moves, strict=True)
    }


def _deviations(frame: CorrectionFrame, moves: StraightMoves, ways: dict[int, _MovePieces]) -> tuple[FloatArray, int]:
    """The largest deviation of each move in `ways`, (n_ways,) [m], and the number of checked points."""
    sent, near, meant, owner = [], [], [], []
    for row, (k, way) in enumerate(ways.items()):
        start, end, n = moves.starts[k], moves.ends[k], len(way.q) - 1
        inside = max(_AT_LEAST, int(np.ceil(float(np.linalg.norm(end - start)) / n / _MEASURED_EVERY)))
        for j in range(n):
            spread = (_GOLDEN * (1 + np.arange(inside) + j * inside)) % 1
            share = np.append(0.5, (np.arange(inside) + spread) / inside)[:, None]
            sent.append((1 - share) * way.waypoints[j] + share * way.waypoints[j + 1])
            near.append((1 - share) * way.q[j] + share * way.q[j + 1])
            meant.append(start + (end - start) * (j + share) / n)
        owner.append(np.full(n * (inside + 1), row))
    largest = np.zeros(len(ways))
    if not sent:
        return largest, 0
    places, rows, numbers = np.concatenate(sent), np.concatenate(owner), list(ways)
    labels = tuple(moves.labels[numbers[row]] for row in rows)
    goals, straight = (Goals(points, labels=labels) for points in (places, np.concatenate(meant)))
    at = np.concatenate(near)
    for first in range(0, len(places), _CHUNK):
        chunk = np.arange(first, min(first + _CHUNK, len(places)))
        real = _driven_positions(frame.robot, frame.nominal, goals.subset(chunk), at[chunk])
        ideal = straight.positions[chunk]
        if frame.meant is not frame.nominal:
            ideal = _driven_positions(frame.meant, frame.nominal, straight.subset(chunk), at[chunk])
        np.maximum.at(largest, rows[chunk], np.linalg.norm(real - ideal, axis=1))
    return largest, len(places)


def _driven_positions(robot: Robot, nominal: Robot, sent: Goals, near: FloatArray) -> FloatArray:
    """Positions (n, 3) [m] of `robot` if a nominal controller gets `sent` at joints `near`: g for the real robot."""
    reach = problem(nominal, sent)
    start = nominal.assemble(near, labels=sent.labels)
    reached = descend(reach, np.arange(len(near)), GoalConfigurations.unknown(start.actuated, start.passive))
    if np.any(reached.distance > TOLERANCE):
        label = sent.labels[int(np.argmax(reached.distance))]
        raise UnreachablePoseError(f"{label}: the controller cannot follow the line; keep away from there")
    return robot.positions(commands_for(nominal, reached.actuated))[:, robot.target_names.index(reach.target.name)]

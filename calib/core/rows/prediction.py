"""The uncertainty of a calibrated robot's positions: the parameters' covariance, propagated to poses.

    covariance of x(q)  =  B C B^T,      B = d(position)/d(free parameters) at the pose

The covariance of a target's orientation, as a small turn about the axes of the measurement frame, has the same form.

Directions of C that no measurement determined (redundant or prior-held parameters) drop out where B does not see them,
so a position can be known to micrometres although no single parameter is. Errors that the model leaves out count as an
independent error of each joint at each pose, as large as residuals show (`calib.core.fitting.unexplained`):

    covariance of x(q)  =  B C B^T + delta^2 K K^T,      K = d(position)/d(joints), scaled

Backlash moves a joint to one side or the other. Where a pose does not state the direction of approach, its position is
the middle, and each joint with play c, known to a standard deviation s, adds the covariance of a motion by
+-sqrt(c^2 + s^2).

The robot's repeatability is not included. Joint terms that a choice left out, and that the data do not exclude, have
coefficients that are zero and uncertain (`UndecidedTerms`). They join the free parameters in C and in B, with their
correlations.

Reference: jcgm100 (GUM), section 5.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadAsArray, ReadOnlyArrays, evenly_spread, hold
from calib.core.base.contributions import Contributions
from calib.core.base.errors import InputError
from calib.core.base.memoize import memoize
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.numerics import linalg
from calib.core.numerics.rigid import cross_matrices
from calib.core.robots.acceleration import compile_for, many
from calib.core.robots.configurations import Configurations
from calib.core.robots.jacobian import linearise
from calib.core.robots.joint_errors import term_columns
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Condition, Context, TermSection
from calib.core.rows.common_motion import CommonMotion, target_poses

CHUNK = 1024
"""Number of poses computed at once."""
ROWS = (slice(3), slice(3, 6))
"""Rows of positions and of turns."""
_DIFFERS = 1.5  # the measurement frame is reported, too, if positions are this many times as uncertain in it
_CERTAIN = 1e-12  # a length is certain if its variance is below this part of its square


@dataclass(frozen=True, eq=False, repr=False)
class PositionUncertainty(ReadAsArray, ReadOnlyArrays):
    """Predicted positions and their uncertainty; read as an array, it is `positions`.

    Attributes:
        positions: (n_poses, n_targets, 3) [m].
        covariance: (n_poses, n_targets, 3, 3) [m^2].
        coverage_factor: Half a 95 % interval of one coordinate, in standard deviations.
        turn_covariance: Covariance of small turns of the targets, (n_poses, n_targets, 3, 3) [rad^2]; None where not
            computed.
        left_out: Targets that summaries leave out (`RobotData.unreported_targets`), and their indices.
        frame: Frame of the covariances, in words; empty for the measurement frame.
        measured: The same positions with their covariance in the measurement frame, if `frame` is another.
        contains: Contributions to the covariances; empty where these are not known.
    """

    positions: FloatArray
    covariance: FloatArray
    coverage_factor: float
    turn_covariance: FloatArray | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    frame: str = ""
    measured: PositionUncertainty | None = None
    contains: Contributions = frozenset()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.positions, dtype=dtype)

    def __str__(self) -> str:
        n_poses, n_targets = self.positions.shape[:2]
        sentence = "how far off is not known"
        following = "fit.predict(q) says how far off they are; fit is a fit or a result of calib.load_result"
        if self.reported_distance.size and np.all(np.isfinite(self.reported_distance)):
            known = self.summary()
            sentence = f"known to {known['rms']:.3g} mm RMS, {known['max']:.3g} mm at worst"
            following = "measure some of these poses and compare: calib.verify(fit, data)"
        return (
            f"{count_noun(n_poses, 'predicted pose')} of {count_noun(n_targets, 'target')}, {sentence}\n"
            f"Inside: positions {self.positions.shape} [m], std and covariance of each, distance95: two limits [m]\n"
            f"Next: {following}"
        )

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each coordinate, (n_poses, n_targets, 3) [m]."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=2, axis2=3), 0.0))

    @property
    def distance(self) -> FloatArray:
        """Root mean square distance between true and predicted position, (n_poses, n_targets) [m]."""
        return rms_length(self.covariance)

    @property
    def distance95(self) -> FloatArray:
        """Low and high 95 % limits of the distance between true and predicted position, (2, n_poses, n_targets) [m]."""
        return length95(self.covariance, self.coverage_factor)

    @property
    def reported_distance(self) -> FloatArray:
        """`distance` without the targets in `left_out`, (n_poses, n) [m]."""
        return np.delete(self.distance, list(self.left_out.values()), axis=1)

    @property
    def worst(self) -> int:
        """The pose with the largest `reported_distance`; without poses, an `InputError`."""
        if not len(self):
            raise InputError("no poses, so none is the worst; predict at one pose at least")
        return int(np.argmax(np.max(self.reported_distance, axis=1)))

    def remark(self) -> str:
        """Return remarks on the frame of a summary and on targets that it leaves out; empty if there are none."""
        frame = f"; {self.frame}" if self.frame else ""
        if self.measured is not None and self.measured.summary()["mean"] > _DIFFERS * self.summary()["mean"]:
            frame += f" (in the measurement frame to {self.measured.summary()['mean']:.2g} mm on average)"
        mean = np.mean(self.distance, axis=0) if len(self) else np.full(self.distance.shape[1], np.nan)
        texts = [f"{name} (known to {quantity_text(mean[k], 'mm', '.2g')})" for name, k in self.left_out.items()]
        return frame + (f"; not counted: {listing(texts)}, seen only from unknown places" if texts else "")

    def table(self) -> dict[str, object]:
        """Return `summary` as data, with its frame, and the summary in the measurement frame if that is another."""
        other = {} if self.measured is None else {"measurement_frame": self.measured.summary()}
        frame = "measurement" if self.measured is None else "robot base"
        return {**self.summary(), "frame": frame, **other, "left_out": list(self.left_out)}

    def summary(self) -> dict[str, float]:
        """Return mean, root mean square and largest `reported_distance` over the poses [mm]; NaN without poses."""
        distance = millimetres(self.reported_distance if len(self) else np.full((1, 1), np.nan))
        return {
            "mean": float(np.mean(distance)),
            "rms": float(np.sqrt(np.mean(distance**2))),
            "max": float(np.max(distance)),
        }


def order_of_joints(q: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return an order and signs of joints that depend on poses q (n, n_actuated) alone.

    They are the place of each joint in the order, and +1 or -1 for each, (n_actuated,). So samples do not depend on the
    names of joints, their order in a description, and the positive direction of an axis.
    """
    off = q - q.mean(axis=0)
    first = off[np.argmax(off != 0, axis=0), np.arange(off.shape[1])]
    order = sorted(range(off.shape[1]), key=np.abs(off).T.tolist().__getitem__)
    return np.argsort(order), np.where(first < 0, -1.0, 1.0)


def recombined_joints(q: FloatArray, most: int) -> FloatArray:
    """Return the joint values of poses q (n, n_actuated) in new combinations, at most `most` [m or rad].

    The values of each joint are shifted by a different number of poses, in the order of `order_of_joints`. So every
    joint stays in its measured range, and joints that moved only together show their uncertainty.
    """
    n, n_joints = q.shape
    mixed = np.stack([np.roll(q[:, j], k * n // n_joints) for j, k in enumerate(order_of_joints(q)[0])], axis=1)
    return np.asarray(mixed[evenly_spread(n, most)])


def without_common_motion(positions: FloatArray, rows: FloatArray) -> FloatArray:
    """Return derivatives of positions without the motion of all of them as one body, in the shape of `rows`.

    Where base and tool are placed anew, only this part of an error of the parameters is visible. Positions are
    (n, n_targets, 3) [m], derivatives (..., n_parameters), three rows for each position.
    """
    points = positions.reshape(-1, 3)
    turns = cross_matrices(points - points.mean(axis=0))
    common = np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2).reshape(-1, 6)
    basis = linalg.orth(common)
    flat = rows.reshape(len(common), -1)
    return np.asarray(flat - basis @ (basis.T @ flat)).reshape(rows.shape)


def rms_length(covariance: FloatArray, mean: FloatArray | float = 0.0) -> FloatArray:
    """Return the root mean square length of vectors with these covariances (..., 3, 3) and means (..., 3), (...)."""
    return np.sqrt(np.maximum(np.trace(covariance, axis1=-2, axis2=-1), 0.0) + np.sum(np.square(mean), axis=-1))


def length95(covariance: FloatArray, coverage_factor: float, mean: FloatArray | None = None) -> FloatArray:
    """Return low and high 95 % limits of the length of vectors with these covariances and means, (2, ...).

    The square of the length is a sum of squares of normal numbers with mean tr(C) + |m|^2 and variance 2 tr(C^2) + 4
    m^T C m. It is nearly g chi^2 of h degrees of freedom, g and h such that mean and variance agree: g = (tr(C^2) + 2
    m^T C m) / (tr(C) + |m|^2). Where one direction outweighs the others, the limits hold 97 of 100 lengths.

    Args:
        covariance: C, (..., 3, 3).
        coverage_factor: Half a 95 % interval of one coordinate, in standard deviations.
        mean: m, (..., 3); zero if not given.
    """
    trace, squares = np.trace(covariance, axis1=-2, axis2=-1), np.sum(covariance**2, axis=(-2, -1))
    if mean is not None:
        trace = trace + np.sum(mean**2, axis=-1)
        squares = squares + 2.0 * np.einsum("...i,...ij,...j->...", mean, covariance, mean)
    return root95(trace, squares, coverage_factor)


def root95(trace: FloatArray, squares: FloatArray, coverage_factor: float) -> FloatArray:
    """Return 95 % limits of the root of a sum of squares of normal numbers, (2, ...), as `length95` does.

    They follow from the sum of its weights (`trace`), and of their squares, (...) each.
    """
    certain = squares <= _CERTAIN * trace**2  # also where both are zero
    share = np.where(certain, 1.0, squares) / np.where(certain, 1.0, trace)
    freedom = np.where(certain, 1.0, trace) / share
    low, high = (np.sqrt(scipy.special.chdtri(freedom, tail) * share) for tail in (0.975, 0.025))
    high = high * coverage_factor / scipy.special.ndtri(0.975)
    return np.where(certain, np.sqrt(np.maximum(trace, 0.0)), np.stack([low, high]))


@dataclass(frozen=True, eq=False)
class UndecidedTerms(ReadOnlyArrays):
    """Joint terms that a robot does not have, and that its data do not exclude.

    Attributes:
        terms: Their entries.
        names: Names of the uncertain parameters: free ones of the robot, and coefficients of the terms, (n,).
        spread: S, one standard deviation in each of k independent directions, (n, k) [SI]; the covariance is S S^T.
    """

    terms: tuple[TermSection, ...]
    names: tuple[str, ...]
    spread: FloatArray

    def sensitivity_of(self, names: Sequence[str]) -> FloatArray:
        """Return the rows of S (`spread`) of these parameters, (n, k); 0 for those that are not in `names`."""
        place = {name: k for k, name in enumerate(self.names)}
        rows = np.vstack([self.spread, np.zeros((1, self.spread.shape[1]))])
        return rows[[place.get(name, -1) for name in names]]


@dataclass(frozen=True, eq=False)
class UncertaintyJacobian(ReadOnlyArrays):
    """A robot linearised at poses by all uncertain quantities.

    Attributes:
        robot: The robot, with undecided joint terms, their coefficients zero.
        positions: (n_poses, n_targets, 3) [m].
        jacobian: Derivative of positions and, if requested, small turns, (n_poses, n_targets, 3 or 6, n_uncertain): by
            the free parameters, by coefficients of undecided terms, then by joints with an error at each pose.
    """

    robot: Robot
    configurations: Configurations
    positions: FloatArray
    jacobian: FloatArray


@dataclass(frozen=True, eq=False)
class ParameterUncertainty(ReadOnlyArrays):
    """The uncertainty of the parameters of a calibrated robot.

    Attributes:
        free: Mask of the calibrated parameters, (n_parameters,); the others count as exact.
        covariance: Covariance of the free parameters without undecided joint terms, (n_free, n_free) [m, rad].
        coverage_factor: Half a 95 % interval, in standard deviations.
        undecided: Joint terms that the data do not exclude; None if there are none.
        joint_error: Standard deviation of an independent error of each joint at each pose [rad; characteristic lengths
            of a sliding joint].
        contains: Contributions to the uncertainty of positions.
    """

    free: BoolArray
    covariance: FloatArray
    coverage_factor: float
    undecided: UndecidedTerms | None = None
    joint_error: float = 0.0
    contains: Contributions = frozenset()

    @property
    def coverage_sentence(self) -> str:
        """Clause that says whether the uncertainty of positions counts errors that the model leaves out."""
        if self.joint_error == 0.0:
            return "without what the model leaves out"
        return "counting what the model leaves out"

    def with_undecided_terms(self, robot: Robot) -> Robot:
        """Return a robot with the undecided joint terms added, their coefficients zero."""
        return robot if self.undecided is None else robot.with_terms((*robot.description.terms, *self.undecided.terms))

    def lasting_names(self, robot: Robot) -> list[str]:
        """Return the uncertain parameters of a robot with undecided terms: the free ones, then coefficients."""
        free = [p.name for p, use in zip(robot.parameters, self.free, strict=True) if use]
        own = {p.name for p in robot.parameters}
        return free + [name for name in (self.undecided.names if self.undecided else ()) if name not in own]

    def lasting(self, robot: Robot) -> BoolArray:
        """Return a mask of the uncertain quantities that are the same at every pose, (n_uncertain,)."""
        n_errors = len(robot.joint_names) if self.joint_error > 0.0 else 0
        return np.repeat([True, False], [len(self.lasting_names(robot)), n_errors])

    def counting(self, robot: Robot, counts: BoolArray) -> BoolArray:
        """Extend a mask of free parameters that count, (n_free,), by all other uncertain quantities, (n_uncertain,)."""
        return np.append(counts, np.ones(len(self.lasting(robot)) - len(counts), dtype=bool))

    def covariance_of(self, robot: Robot) -> FloatArray:
        """Return the covariance of all uncertain quantities of a calibrated robot, (n_uncertain, n_uncertain) [SI]."""
        further, n_free = self._further(robot), len(self.covariance)
        total: FloatArray = further @ further.T
        total[:n_free, :n_free] += self.covariance
        return total

    def sum_of_variances(self, robot: Robot, rows: FloatArray) -> float:
        """Return the sum of variances of numbers with these derivatives by uncertain quantities, (n, n_uncertain)."""
        of_free = rows[:, : len(self.covariance)]
        by_free = np.vdot(of_free.T @ of_free, self.covariance)  # a product with its own transpose: half of the work
        return float(by_free + np.sum((rows @ self._further(robot)) ** 2))

    @memoize
    def _further(self, robot: Robot) -> FloatArray:
        """Standard deviations of all that is uncertain but the free parameters, each a direction, (n_uncertain, k)."""
        errors = np.flatnonzero(~self.lasting(robot))
        further = np.zeros((len(self.lasting(robot)), len(errors)))
        further[errors, np.arange(len(errors))] = self.joint_error
        if self.undecided is None:
            return further
        spread = self.undecided.sensitivity_of(self.lasting_names(robot))
        return np.hstack([np.pad(spread, ((0, len(errors)), (0, 0))), further])

    def linearise(
        self, robot: Robot, q: FloatArray, context: Context, near: FloatArray | None = None, *, turns: bool = True
    ) -> UncertaintyJacobian:
        """Linearise positions and turns of all targets by all uncertain quantities.

        Commands are q, (n_poses, n_actuated) [m or rad]; `near` are passive joints to start from, if they are known,
        (n_poses, n_passive) [m or rad]. A loop that stays open is an `UnreachablePoseError`.
        """
        whole = self.with_undecided_terms(robot)
        place = {p.name: k for k, p in enumerate(whole.parameters)}
        index = np.array([place[name] for name in self.lasting_names(robot)], dtype=np.intp)
        configurations = whole.assemble(q, near, context=context)
        linear = linearise(whole, configurations, turns=turns, joints=self.joint_error > 0.0)
        jacobian = np.take(linear.jacobian, index, axis=-1)
        if linear.joint_derivative is not None:
            jacobian = np.concatenate([jacobian, linear.joint_derivative * whole.mechanism.joint_scale], axis=-1)
        hold(jacobian)
        return UncertaintyJacobian(whole, configurations, linear.positions, jacobian)

    def _motion_to_one_side(
        self, robot: Robot, linear: UncertaintyJacobian, q: FloatArray, context: Context, *, turns: bool
    ) -> FloatArray:
        """Return how far play moves the targets to one side where it is not known to which, by coefficient.

        The shape is (n_poses, n_targets, 3 or 6, k), with k = 0 where all directions of approach are known.
        """
        whole, unknown = linear.robot, context.approach == 0
        n_rows = linear.jacobian.shape[2]
        if not (np.any(unknown) and any(Condition.APPROACH in term.depends_on for term in whole.terms)):
            return np.zeros((*linear.positions.shape[:2], n_rows, 0))
        sides = (term_columns(whole, q, replace(context, approach=side)) for side in (unknown * 1.0, unknown * 0.0))
        columns = tuple(moved - middle for moved, middle in zip(*sides, strict=True))
        moved = linearise(whole, replace(linear.configurations, term_columns=columns), turns=turns)
        names, variances = self.lasting_names(robot), np.zeros(len(whole.parameters))
        place = {p.name: k for k, p in enumerate(whole.parameters)}
        of_names = np.sum(self._further(robot)[: len(names)] ** 2, axis=1)
        of_names[: len(self.covariance)] += np.diagonal(self.covariance)
        variances[[place[name] for name in names]] = of_names
        return np.asarray((moved.jacobian * np.sqrt(whole.values**2 + variances))[..., whole.coefficients])

    def predict(
        self,
        robot: Robot,
        q: FloatArray,
        context: Context | None = None,
        near: FloatArray | None = None,
        *,
        turns: bool = True,
        counts: BoolArray | None = None,
        common: tuple[CommonMotion, FloatArray] | None = None,
    ) -> PositionUncertainty:
        """Predict positions of all targets, loops closed, with the covariance of positions and orientations.

        Args:
            q: Commands, (n_poses, n_actuated) [m or rad].
            context: Conditions of the commands; joint terms may depend on them.
            near: Passive joints to start from, if they are known, (n_poses, n_passive) [m or rad].
            turns: Whether to compute the covariance of the orientations.
            counts: Mask of the uncertain quantities that count, (n_uncertain,); all if not given.
            common: A common motion z that the covariance leaves out, and its derivative by the uncertain quantities,
                (k, n_uncertain); `measured` has the covariance that includes it.

        Raises:
            UnreachablePoseError: A loop stays open.
        """
        context = Context.neutral(*q.shape) if context is None else context
        further, free, shape = self._further(robot), len(self.covariance), (len(q), len(robot.mechanism.targets), 3)
        points = np.empty(shape)
        whole, without_common = ([np.empty((*shape, 3)) for _ in ROWS[: 1 + turns]] for _ in range(2))
        for start in range(0, len(q), CHUNK):
            some = slice(start, start + CHUNK)
            seed = None if near is None else near[some]
            with compile_for(len(q), many(robot.mechanism)):
                linear = self.linearise(robot, q[some], context.select(some), seed, turns=turns)
            points[some] = linear.positions
            jacobian = linear.jacobian if counts is None else linear.jacobian * counts
            to_one_side = self._motion_to_one_side(robot, linear, q[some], context.select(some), turns=turns)
            flat = jacobian.reshape(-1, len(further))
            by_free, by_further = flat[:, :free] @ self.covariance, flat @ further  # the covariance is read once
            parts = [[array.reshape(*jacobian.shape[:3], -1) for array in (flat[:, :free], by_free, by_further)]]
            if common is not None:
                motion, following = common[0], common[1] if counts is None else common[1] * counts
                columns = motion.columns(*target_poses(linear.robot, linear.configurations))[:, :, : jacobian.shape[2]]
                followed = (following[:, :free], following[:, :free] @ self.covariance, following @ further)
                parts.append([array - columns @ of for array, of in zip(parts[0], followed, strict=True)])
            for to, arrays in zip((whole, without_common), parts, strict=False):
                for covariance, rows in zip(to, ROWS, strict=False):
                    derivative, by_covariance, others = (array[:, :, rows] for array in arrays)
                    others = np.concatenate([others, to_one_side[:, :, rows]], axis=-1)
                    covariance[some] = by_covariance @ derivative.swapaxes(2, 3) + others @ others.swapaxes(2, 3)
        hold(points, *whole, *without_common)
        measured = PositionUncertainty(
            points,
            whole[0],
            self.coverage_factor,
            whole[1] if turns else None,
            robot.unreported_targets,
            contains=self.contains,
        )
        if common is None:
            return measured
        turned = without_common[1] if turns else None
        return replace(measured, covariance=without_common[0], turn_covariance=turned, measured=measured)

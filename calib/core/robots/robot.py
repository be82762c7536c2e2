"""The robot that users hold: kinematics with closed loops, at the current values of its parameters. Immutable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, IntArray, random_numbers
from calib.core.base.errors import DataError, InputError
from calib.core.base.memory import require_memory
from calib.core.base.other_words import HintedObject
from calib.core.base.words import html_with_title
from calib.core.robots import kinematics
from calib.core.robots.acceleration import compile_for, many
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.closure import LoopSolution, motion
from calib.core.robots.configurations import (
    Configurations,
    assemble,
    close,
    distances,
    joint_vector,
    solve_configurations,
)
from calib.core.robots.joint_errors import with_terms
from calib.core.robots.joint_sampling import TRIES, Ranges, draw_spread, joint_box, validate_ranges
from calib.core.robots.mechanism import RelativeFrame
from calib.core.robots.parametrisation import with_prior
from calib.core.robots.robot_data import RobotData
from calib.core.robots.robot_files import held_by, urdf_of_origins, write_description
from calib.core.robots.terms.term import Context, TermSection


@dataclass(frozen=True, eq=False, repr=False)
class Robot(RobotData, HintedObject):
    """A robot with given parameter values. `load` makes one; `with_parameters` makes a changed copy. It can be pickled.

    Its data are those of `calib.core.robots.robot_data.RobotData`: `values`, (n_parameters,) [m or rad], of its
    `parameters`; `mechanism`, with the origins that they give, and `nominal`, with nominal ones; `description`, `urdf`,
    `instruments`, joint `terms`, `mode` (home and assembly mode), `path`; after a fit, `files` (the robots
    for files).
    """

    _other_words = "a robot"

    def __repr__(self) -> str:
        return (
            f"<Robot '{self.name}' from {self.path}: {len(self.joint_names)} actuated and {len(self.passive_names)}"
            f" passive joints, {len(self.parameters)} parameters>"
        )

    def _own_parameters(self) -> list[str]:
        return [parameter.name for parameter in self.parameters]

    def _repr_html_(self) -> str:
        contents = f"joints {', '.join(self.joint_names)}; targets {', '.join(self.target_names)}"
        rows = zip(self.parameters, self.values, self.is_free, strict=True)
        return html_with_title(self.name, (repr(self)[1:-1], contents), [p.row(value, free) for p, value, free in rows])

    def fix(self, *names: str | Sequence[str]) -> Robot:
        """Return a robot with these parameters held, too.

        Args:
            names: As arguments, or as a list. `all`: every parameter except unknown places of base and targets.

        Raises:
            ParameterError: An unknown name.
        """
        placed = {parameter.name for parameter in self.parameters if parameter.placement}
        every = [parameter.name for parameter in self.parameters if parameter.name not in placed]
        named = tuple(each for name in _flat(names) for each in (every if name == "all" else [name]))
        return self._with_held((*self.description.held, *named), named)

    def free(self, *names: str | Sequence[str]) -> Robot:
        """Return a robot with these parameters free; see `fix`."""
        named = _flat(names)
        return self._with_held(tuple(name for name in self.description.held if name not in named), named)

    def _with_held(self, held: tuple[str, ...], named: tuple[str, ...]) -> Robot:
        self.parameters.places(named)  # all are known
        changed = self.description.model_copy(update={"held": tuple(dict.fromkeys(held))})
        return replace(self, description=changed)

    def with_prior(self, names: str | Sequence[str], sigma: str) -> Robot:
        """Return a robot with the expected error `sigma` of these parameters.

        Args:
            names: A parameter, or several.
            sigma: One standard deviation with its unit, such as `0.5 mm`.

        Raises:
            ParameterError: An unknown name, or one of a joint term.
            InputError: Sigma has no unit, or is not a positive number of this dimension.
        """
        return with_prior(self, names, sigma)

    def with_terms(self, sections: Sequence[TermSection]) -> Robot:
        """Return a robot with these joint terms in place of its own; parameters that stay keep their values.

        Raises:
            DescriptionError: An entry that does not fit its joint, or coefficients of one name twice.
        """
        return with_terms(self, sections)

    def save(self, path: Path | str, *, force: bool = False) -> None:
        """Write the robot description; `calib.load` gives the same robot from it.

        Args:
            path: YAML file to write. It names the URDF, which stays where it is.
            force: Whether to replace a file that this program did not write, that was edited, or that the robot comes
                from, with the comments in it.

        Raises:
            InputError: The file cannot be written, or should not be replaced; or parameters are not nominal, which a
                description cannot say.
        """
        write_description(self, path, force=force)

    def held_by(self, holds: Holds) -> Robot:
        """Return the robot for a kind of file; this one if the file holds all of it.

        For joint zeros alone it is the nominal one, to which the zeros in `files` belong.

        Args:
            holds: Part of a robot that the file holds; see `calib.core.robots.accuracy_of_files`.

        Raises:
            ComputationError: Joint terms would be lost, and no fit says what is best without them.
        """
        return held_by(self, holds)

    def calibrated_urdf(self) -> bytes:
        """Return the URDF of the calibrated robot; unchanged numbers keep their bytes.

        A URDF cannot hold joint terms. Of a fit with joint terms, it gets the origins that are best without them.

        Raises:
            ComputationError: There are such terms, and no fit says which origins are best without them.
        """
        return urdf_of_origins(self.held_by(Holds.ORIGINS))

    def close(
        self,
        q: ArrayLike,
        seed: FloatArray | None = None,
        columns: tuple[FloatArray, ...] | None = None,
        *,
        thorough: bool = True,
    ) -> LoopSolution:
        """Solve the loops of each pose without raising; see `calib.core.robots.loops.close`.

        Args:
            q: Commanded joints, (n, n_actuated) [m or rad].
            seed: Passive joints to start from, (n, n_passive).
            columns: Columns of `term_columns`, if they are known.
            thorough: Whether to try every way; False is faster, and may miss poses that close.
        """
        return close(self, q, seed, columns, thorough=thorough)

    def assemble(
        self,
        q: ArrayLike,
        seed: FloatArray | None = None,
        labels: Sequence[str] | None = None,
        context: Context | None = None,
    ) -> Configurations:
        """Solve the loops of each pose in the assembly mode of home.

        Args:
            q: Actuated joints, (n, n_actuated) or (n_actuated,) [m or rad].
            seed: Passive joints of the same poses under slightly different parameters, to start from,
                (n, n_passive) [m or rad].
            labels: Name of each pose in messages, (n,).
            context: Conditions of the commands, on which joint terms may depend.

        Raises:
            UnreachablePoseError: A loop stays open; the message names pose and loop and the miss.
        """
        return assemble(self, q, seed, labels, context)

    def singular_values(self, configurations: Configurations) -> FloatArray:
        """Return each pose's distance to a singularity of the loops, (n,): see `calib.core.robots.closure`."""
        return distances(self, configurations)

    def forward(self, q: ArrayLike, frame: str | None = None) -> FloatArray:
        """Pose of a frame in the measurement frame, loops closed.

        Args:
            q: Actuated joints, (n, n_actuated) or (n_actuated,) [m or rad].
            frame: Link, joint or target; a name that a link and a target share means the link's frame, as in every
                other tool. The first target if not given.

        Returns:
            Homogeneous transforms T_base_frame, (n, 4, 4) or (4, 4) [m].

        Raises:
            DataError: Joint values of the wrong shape.
            DescriptionError: Unknown frame.
            UnreachablePoseError: A loop cannot be closed.
        """
        configurations, pair = self.assemble(q), self._relative_frame(frame)
        joints = self.mechanism.all_joints(configurations.actuated, configurations.passive)
        swept = kinematics.sweep(self.mechanism, joints, (pair,), poses_only=True)
        transforms = kinematics.relative_pose(swept, pair.a, pair.b)
        return transforms[0] if np.ndim(q) == 1 else transforms

    def _relative_frame(self, frame: str | None) -> RelativeFrame:
        """A frame seen from the measurement frame."""
        target = self.mechanism.targets[0]
        return target if frame is None else replace(target, b=self.mechanism.joint(frame))

    def jacobian(self, q: ArrayLike, frame: str | None = None) -> FloatArray:
        """Geometric Jacobian of a frame by the actuated joints, through the closed loops.

        [v; w] = J dq/dt, with v the velocity of the frame's origin and w its angular velocity, both in the axes of the
        measurement frame (Pinocchio's LOCAL_WORLD_ALIGNED). With joint terms, dq/dt is
        the actual motion of the joints, not the commanded one.

        Arguments and errors are those of `forward`.

        Returns:
            (n, 6, n_actuated) or (6, n_actuated) [m or rad, per m or rad].
        """
        configurations, pair = self.assemble(q), self._relative_frame(frame)
        by_joint = motion(self.mechanism, pair, configurations.actuated, configurations.passive)[2]
        jacobian = by_joint[:, :, : len(self.joint_names)]
        return jacobian[0] if np.ndim(q) == 1 else jacobian

    def positions(self, q: ArrayLike, context: Context | None = None, seed: FloatArray | None = None) -> FloatArray:
        """Positions of all targets in the measurement frame, loops closed, (n, n_targets, 3) [m].

        Args:
            q: Actuated joints, (n, n_actuated) or (n_actuated,) [m or rad].
            context: Conditions of the commands, on which joint terms may depend.
            seed: See `assemble`.

        Raises:
            DataError: Joint values of the wrong shape.
            UnreachablePoseError: A loop cannot be closed.
        """
        configurations = self.assemble(q, seed, context=context)
        joints = self.mechanism.all_joints(configurations.actuated, configurations.passive)
        swept = kinematics.sweep(self.mechanism, joints, self.mechanism.targets, poses_only=True)
        return np.stack([kinematics.value(swept, target) for target in self.mechanism.targets], axis=1)

    def sample(
        self, count: int, seed: int | np.random.Generator = 0, *, within: Ranges | ArrayLike | None = None
    ) -> FloatArray:
        """Return joint values at random over the joint limits, loops closed; see `calib.core.robots.joint_sampling`.

        These poses are not at contact: `calib.sample` brings them there, and gives poses with names.

        Args:
            seed: Seed, or a generator of random numbers.
            within: Ranges to stay in, inside the joint limits: by name [SI], or joint values that span them,
                (n, n_actuated) [m or rad].

        Returns:
            (count, n_actuated) [m or rad].

        Raises:
            InputError: The count or the seed is negative, a range is not valid, or the result does not fit into memory.
            DataError: Not enough were found, even near home; or a sliding joint has no limits.
        """
        if count < 1:
            raise InputError(f"count {count}: at least one pose is needed")
        require_memory(2 * count * len(self.joint_names), f"sampling {count} poses", "sample fewer")
        if within is not None and not isinstance(within, Mapping):
            joints = joint_vector(self, within)
            spans = zip(joints.min(axis=0).tolist(), joints.max(axis=0).tolist(), strict=True)
            within = dict(zip(self.joint_names, spans, strict=True))
        coordinates = [f"{target}_{axis}" for target in self.target_names for axis in "xyz"]
        ranges = validate_ranges(within or {}, (*self.joint_names, *coordinates))
        box = joint_box(self.mechanism, self.urdf, self.home, ranges, self.path)
        low, high = np.array([ranges.get(name, (-np.inf, np.inf)) for name in coordinates]).reshape(-1, 2).T
        bounded = not ranges.keys().isdisjoint(coordinates)

        def usable(q: FloatArray) -> IntArray:
            closed = self.close(q, thorough=False)  # others are tried in place of those that are hard to reach
            good = np.flatnonzero(closed.ok)
            distance = self.singular_values(solve_configurations(self, q[good], closed.select(good)))
            good = good[distance >= self.description.singularity_limit]
            if not bounded or len(good) == 0:
                return good
            points = self.positions(q[good]).reshape(len(good), -1)
            return good[np.all((points >= low) & (points <= high), axis=1)]

        with compile_for(TRIES * count if self.mechanism.loops else 0, many(self.mechanism)):
            q = draw_spread(count, random_numbers(seed), box, self.home, usable, draw_in=not bounded)
        if len(q) < count:
            reason = "are within these ranges; widen them" if ranges else "can be assembled; give a file of poses"
            raise DataError(f"{self.path}: only {len(q)} of {count} random poses {reason}")
        return q


def _flat(names: Sequence[str | Sequence[str]]) -> tuple[str, ...]:
    """Names that were given one after the other, or as a list."""
    for entry in names:
        if not isinstance(entry, (str, Sequence)):
            raise InputError(f"parameters are named by text, such as 'joint_3.z', not by {entry!r:.40}")
    return tuple(name for entry in names for name in ((entry,) if isinstance(entry, str) else entry))

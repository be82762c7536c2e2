"""The robot: description, kinematics with closed loops, and the current values of its parameters. Immutable."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays, random_numbers, read_only
from calib.base.errors import (
    ComputationError,
    DataError,
    DescriptionError,
    InputError,
    ParameterError,
    UnreachablePoseError,
    nearest,
)
from calib.base.files import write_file
from calib.base.memory import require_memory
from calib.base.other_words import worded
from calib.base.parameter import Parameters, index_of
from calib.base.sections import COMPONENTS, Component
from calib.base.units import quantity
from calib.base.words import listed, titled_html
from calib.instruments.kind import Instrument
from calib.joint_terms.term import Context, JointTerm, TermSection
from calib.joint_terms.terms import TERMS
from calib.robots import kinematics, loops
from calib.robots.acceleration import compiled_for
from calib.robots.closure import AssemblyMode, actuated_jacobian, singular_values
from calib.robots.described_instruments import pair_names, places_of
from calib.robots.description import Description, description_yaml
from calib.robots.gravity import accelerations, gravity_torque, turn_columns
from calib.robots.held import FileRobot, Holds
from calib.robots.joint_errors import build_terms, joint_errors, term_columns
from calib.robots.joint_sampling import TRIES, Ranges, checked_ranges, joint_box, spread
from calib.robots.loops import why_open
from calib.robots.mechanism import Mechanism, RelativeFrame, view
from calib.robots.mechanism_builder import build_mechanism, tilted_joints
from calib.robots.parameters import Parametrisation
from calib.robots.parametrisation import build_parametrisation
from calib.robots.urdf.text import Triple, UrdfText

_LARGEST_JOINT = 1e6  # [m or rad]
_COMMAND_ROUNDS = 50
_COMMANDED = 1e-10  # by which a joint may still be off its command [m or rad]
_ROUNDING = 1e-14  # a number of the URDF that moves by less has not been edited [m or rad]


@dataclass(frozen=True, eq=False)
class Configurations(ReadOnlyArrays):
    """Assembled configurations of a robot.

    Attributes:
        actuated: What the driven joints really are, (n, n_driven) [m or rad]: commands and the joints' errors, then
            how links are tilted (`calib.robots.mechanism`).
        passive: (n, n_passive) [m or rad].
        slope: Derivative of the closures by the passive joints, (n, n_passive, n_passive).
        term_columns: phi of each joint term, (n, n_moved, n_coefficients) each.
    """

    actuated: FloatArray
    passive: FloatArray
    slope: FloatArray
    term_columns: tuple[FloatArray, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Robot(ReadOnlyArrays):
    """A robot with given parameter values. `load` makes one; `with_parameters` makes a changed copy. Pickles.

    Attributes:
        path: File that it was loaded from.
        description: The robot description.
        urdf: The nominal URDF.
        nominal: Mechanism with nominal origins.
        mechanism: Mechanism with the origins that `values` give.
        parametrisation: Its parameters.
        instruments: What is measured.
        terms: Terms of the joints' errors.
        values: Current parameter values, (n_parameters,) [m or rad]: of the parametrisation, then unknown numbers of
            the instruments, then coefficients of the terms.
        mode: Home configuration and assembly mode of the nominal robot.
        files: The robots that files get, by how much these hold; of a fit alone, and gone where values are changed.
    """

    _other_words = "a robot"
    _made_by = (
        'calib.load("robot.yaml"), of a robot description, a URDF or a result folder; calib.robot("arm.urdf",'
        ' target="tool0") without a description'
    )

    path: str
    description: Description
    urdf: UrdfText
    nominal: Mechanism
    mechanism: Mechanism
    parametrisation: Parametrisation
    instruments: tuple[Instrument, ...]
    terms: tuple[JointTerm, ...]
    values: FloatArray
    mode: AssemblyMode
    files: Mapping[Holds, FileRobot] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"<Robot '{self.name}' from {self.path}: {len(self.joint_names)} actuated and {len(self.passive_names)}"
            f" passive joints, {len(self.parameters)} parameters>"
        )

    def _repr_html_(self) -> str:
        told = f"joints {', '.join(self.joint_names)}; targets {', '.join(self.target_names)}"
        rows = zip(self.parameters, self.values, self.is_free, strict=True)
        return titled_html(self.name, (repr(self)[1:-1], told), [one.row(value, free) for one, value, free in rows])

    @property
    def name(self) -> str:
        """The robot's name in its URDF."""
        return self.urdf.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints, in the order of every joint vector."""
        return self.mechanism.actuated

    @property
    def sensed_names(self) -> tuple[str, ...]:
        """Names of the actuated joints that inclinometers read, which nobody commands."""
        sensed = {name for section in self.description.inclinometers.values() for name in section.joints}
        return tuple(name for name in self.joint_names if name in sensed)

    @property
    def commanded_names(self) -> tuple[str, ...]:
        """Names of the other actuated joints."""
        return tuple(name for name in self.joint_names if name not in self.sensed_names)

    @property
    def passive_names(self) -> tuple[str, ...]:
        """Names of the joints that the loops decide."""
        return self.mechanism.passive

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the measured points."""
        return tuple(target.name for target in self.mechanism.targets)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the frames that `forward` and `jacobian` know: links, joints and targets."""
        return tuple(self.mechanism.frames)

    @property
    def joint_limits(self) -> FloatArray:
        """Lower and upper limits of the actuated joints, (n_actuated, 2) [m or rad]; infinite where there are none."""
        return read_only(np.stack(self.urdf.limits(self.joint_names), axis=1))

    @cached_property
    def left_out(self) -> dict[str, int]:
        """Targets of which is not told how well their positions are known, and their places among the targets.

        Where a target is that is only read from unknown places, as by a camera that stands somewhere, readings may
        hardly tell. It is left out beside targets that are read in the measurement frame, or from known places.
        """
        read: dict[bool, set[str]] = {True: set(), False: set()}
        for one in self.instruments:
            unknown = {place.name for place in one.places() if place.unknown}
            if any(part.dimension != "angle" for part in one.parts):
                for place, target in one.pairs(""):
                    read[place in unknown].add(target)
        unsure = read[True] - read[False] if read[False] else set()
        return {name: k for k, name in enumerate(self.target_names) if name in unsure}

    @property
    def located(self) -> list[int]:
        """Places of the targets that are not left out."""
        return [k for k, name in enumerate(self.target_names) if name not in self.left_out]

    @cached_property
    def parameters(self) -> Parameters:
        """Parameters, in the order of `values`, and by name."""
        of_instruments = tuple(p for one in self.instruments for p in one.unknowns)
        of_terms = tuple(p for term in self.terms for p in term.parameters)
        every = self.parametrisation.parameters + of_instruments + of_terms
        fleet = self.description.fleet
        return Parameters(every if fleet is None else fleet.expected(every, self.path))

    @cached_property
    def n_origin_parameters(self) -> int:
        """How many of the parameters move origins; they come first."""
        return len(self.parametrisation.parameters)

    def instrument(self, name: str) -> Instrument:
        """Return an instrument; an unknown name is a `DescriptionError`."""
        for one in self.instruments:
            if one.name == name:
                return one
        raise DescriptionError(f"no instrument '{name}'{nearest(name, [one.name for one in self.instruments])}")

    def unknowns(self, name: str) -> slice:
        """Return which parameters are the unknown numbers of an instrument."""
        start = self.n_origin_parameters
        for one in self.instruments:
            if one.name == name:
                break
            start += len(one.unknowns)
        return slice(start, start + len(self.instrument(name).unknowns))

    @cached_property
    def coefficients(self) -> slice:
        """Which parameters are coefficients of joint terms; they come last."""
        n = len(self.parameters)
        return slice(n - sum(len(term.parameters) for term in self.terms), n)

    def term_columns(self, q: FloatArray, context: Context | None = None) -> tuple[FloatArray, ...]:
        """Return phi of each joint term at commands q (n, n_actuated), (n, n_moved, n_coefficients) each."""
        if not self.terms:
            return ()
        context = Context.neutral(len(q), len(self.joint_names)) if context is None else context
        if not any(term.needs_torque for term in self.terms):
            return term_columns(self.terms, self.mechanism, q, context)
        driven = self.nominal.untilted(q)
        closed = loops.close(self.nominal, self.mode, driven)
        passive = np.where(np.isfinite(closed.passive), closed.passive, 0.0)
        slope = np.where(closed.ok[:, None, None], closed.slope, np.eye(passive.shape[1]))
        joints, told, load = self.nominal.all_joints(driven, passive), self.description, context.load
        turns = self.values[self.coefficients][-2:] if self.turns_gravity else np.zeros(0)
        acceleration, slopes = accelerations(told.gravity, tuple(told.setups), self.nominal, joints, context, turns)

        def torque(of: FloatArray) -> FloatArray:
            at = (self.nominal, driven, passive, slope)
            return gravity_torque(self.urdf, *at, load, told.payload, of, self.path)

        context = replace(context, torque=torque(acceleration))
        columns = term_columns(self.terms, self.mechanism, q, context)
        if not slopes:
            return columns
        by_turn, values = tuple(torque(one) for one in slopes), self.values[self.coefficients]
        return (*columns[:-1], turn_columns(self.terms, self.mechanism, q, context, by_turn, values))

    @property
    def turns_gravity(self) -> bool:
        """Whether gravity's direction is found: two coefficients, the last ones, with which all `term_columns` vary."""
        return any(not term.adds for term in self.terms)

    def actual(self, q: FloatArray, columns: tuple[FloatArray, ...]) -> FloatArray:
        """Return what the driven joints are, (n, n_driven), when the actuated ones are told q (n, n_actuated).

        Args:
            q: The commands [m or rad].
            columns: phi of the joint terms.
        """
        if not self.terms:
            return q
        errors = joint_errors(self.terms, self.mechanism, columns, self.values[self.coefficients], len(q))
        return self.mechanism.untilted(q) + errors

    def commands(self, actual: FloatArray, context: Context | None = None) -> FloatArray:
        """Return what the actuated joints must be told to be at `actual`, (n, n_actuated) [m or rad].

        q = actual - dq(q) is repeated until it stands; joint errors change so little with q that each round gains
        digits. Where they change much, as where backlash changes its side, a round that gains nothing is taken back,
        and the next one goes half as far. NaN where that comes to no end: a joint that falls from one side of its play
        to the other is nowhere between.

        Args:
            actual: What they shall be; where all driven joints are given, (n, n_driven), the others do not count.
            context: Under which conditions.
        """
        n_actuated = len(self.joint_names)
        wanted = q = np.array(actual[:, :n_actuated])
        if not self.terms:
            return q
        part, off = np.ones((len(q), 1)), np.full((len(q), 1), np.inf)
        best, step = q, np.zeros_like(q)
        for _ in range(_COMMAND_ROUNDS):
            left = wanted - self.actual(q, self.term_columns(q, context))[:, :n_actuated]
            still = np.max(np.abs(left), axis=1, keepdims=True, initial=0.0)
            worse = (still > off) & (still > _COMMANDED)
            part, off = np.where(worse, part / 2, part), np.where(worse, off, still)
            best, step = np.where(worse, best, q), np.where(worse, step / 2, part * left)
            q = best + step
            if not np.any(still >= _ROUNDING):
                break
        q[np.flatnonzero(off > _COMMANDED)] = np.nan
        return q

    def pairs(self, one: Instrument) -> tuple[RelativeFrame, ...]:
        """Return what an instrument looks along, in the order of `Readings.pairs`."""
        return tuple(view(self.mechanism.places, a, b) for a, b in pair_names(self.description, one))

    @property
    def home(self) -> FloatArray:
        """Actuated joints of the home configuration, (n_actuated,) [m or rad]."""
        return read_only(self.mode.actuated[: len(self.joint_names)])

    @property
    def is_free(self) -> BoolArray:
        """Which parameters a fit may change: all but the held ones, (n_parameters,)."""
        return np.array([parameter.name not in self.description.held for parameter in self.parameters])

    def fix(self, *names: str | Sequence[str]) -> Robot:
        """Return a robot of which a fit leaves these parameters, too, as they are.

        Args:
            names: One after the other, or as a list.

        Raises:
            ParameterError: An unknown name.
        """
        named = _flat(names)
        return self._held((*self.description.held, *named), named)

    def free(self, *names: str | Sequence[str]) -> Robot:
        """Return a robot of which a fit may change these parameters; see `fix`."""
        named = _flat(names)
        return self._held(tuple(name for name in self.description.held if name not in named), named)

    def _held(self, held: tuple[str, ...], named: tuple[str, ...]) -> Robot:
        for name in named:
            index_of(self.parameters, name)
        changed = self.description.model_copy(update={"held": tuple(dict.fromkeys(held))})
        return replace(self, description=changed)

    def with_prior(self, names: str | Sequence[str], sigma: float | str) -> Robot:
        """Return a robot of which these components of origins are expected to be off by `sigma`.

        Args:
            names: A parameter, or several.
            sigma: One standard deviation [m or rad], or text with a unit, such as `0.5 mm`.

        Raises:
            ParameterError: An unknown name, or one that is no component of an origin that the description lists.
            InputError: Sigma is not a positive number of this dimension.
        """
        description = self.description
        if not description.priors:
            raise ParameterError(f"{self.path}: says that priors do not count (priors: false); leave that out")
        for name in [names] if isinstance(names, str) else names:
            place = index_of(self.parameters, name)
            one = self.parameters[place]
            origin, _, component = name.rpartition(".")
            listed = place < self.n_origin_parameters and component in COMPONENTS and bool(description.origins)
            if not listed or one.placement:
                raise ParameterError(
                    f"parameter '{name}' is no component of an origin in the list 'parametrisation'; its sigma stands"
                    " in the robot description"
                )
            if quantity(sigma, one.dimension, f"prior of '{name}'") <= 0:
                raise InputError(f"prior of '{name}': sigma {sigma} must be positive; fix('{name}') keeps it as it is")
            description = description.with_sigma(origin, cast(Component, component), sigma)
        places = places_of(description, self.instruments, self.path)
        parametrisation = build_parametrisation(description, self.urdf, self.nominal, places, self.path)
        known = dict(zip((parameter.name for parameter in self.parameters), self.values, strict=True))
        return replace(self, description=description, parametrisation=parametrisation).with_parameters(known)

    def save(self, path: Path | str, *, force: bool = False) -> None:
        """Write the robot description; `calib.load` gives the same robot from it.

        Args:
            path: YAML file to write. It names the URDF, which stays where it is.
            force: Whether to replace a file that this program did not write, that was edited, or that the robot comes
                from; comments in it and all.

        Raises:
            InputError: The file cannot be written, or should not be replaced; or parameters are not nominal, which a
                description cannot say.
        """
        path = Path(path)
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise InputError(f"{path}: the name of a robot description ends in .yaml")
        nominal = np.array([parameter.nominal_si for parameter in self.parameters])
        if not np.array_equal(self.values, nominal):
            name = self.parameters[int(np.argmax(self.values != nominal))].name
            raise InputError(
                f"parameter '{name}' is not nominal, and a description holds nominal values; save the fit, whose folder"
                " loads as a robot, or export a URDF"
            )
        relative = os.path.relpath(Path(self.urdf.path).resolve(), path.resolve().parent)
        text = description_yaml(self.description.model_copy(update={"urdf": relative}))
        write_file(path, text, inputs=(self.path, self.urdf.path), force=force)

    def with_parameters(self, values: Mapping[str, float] | ArrayLike) -> Robot:
        """Return a robot with other parameter values.

        Args:
            values: New values by name [m or rad], the others staying as they are; or all of them, (n_parameters,).

        Raises:
            ParameterError: Unknown name, wrong number of values, or a value that is not finite.
        """
        if isinstance(values, Mapping):
            vector = self.values.copy()
            for name, value in values.items():
                vector[index_of(self.parameters, name)] = value
        else:
            vector = np.array(values, dtype=float)
        if vector.shape != self.values.shape:
            raise ParameterError(f"{vector.size} values given for {self.values.size} parameters")
        if not np.all(np.isfinite(vector)):
            bad = self.parameters[int(np.argmin(np.isfinite(vector)))].name
            raise ParameterError(f"parameter '{bad}': value is not finite")
        mechanism = self.nominal.with_placements(self.parametrisation.placements(vector[: self.n_origin_parameters]))
        return replace(self, values=vector, mechanism=mechanism, files={})

    def with_terms(self, sections: Sequence[TermSection]) -> Robot:
        """Return a robot with these joint terms in place of its own; parameters that stay keep their values.

        Raises:
            DescriptionError: An entry that does not fit its joint, or coefficients of one name twice.
        """
        description = self.description.with_terms(sections)
        terms = build_terms(description, self.urdf, self.nominal, self.path)
        changed = replace(self, description=description, terms=terms, files={})
        if tilted_joints(description) != tilted_joints(self.description):
            nominal = build_mechanism(self.urdf, description, self.instruments, self.path)
            mechanism = nominal.with_placements(
                self.parametrisation.placements(self.values[: self.n_origin_parameters])
            )
            mode = replace(self.mode, mechanism=nominal, actuated=nominal.untilted(self.home[None])[0])
            changed = replace(changed, nominal=nominal, mechanism=mechanism, mode=mode)
        changed.check_names()
        value_of = dict(zip((parameter.name for parameter in self.parameters), self.values, strict=True))
        return replace(changed, values=np.array([value_of.get(p.name, p.nominal_si) for p in changed.parameters]))

    def at_nominal(self) -> Robot:
        """Return a robot with nominal parameter values."""
        return self.with_parameters([parameter.nominal_si for parameter in self.parameters])

    def lost_by(self, holds: Holds) -> tuple[str, ...]:
        """Return the joints of whose errors a file that holds so much loses terms, as far as these are not zero."""
        joints, start = dict[str, None](), self.coefficients.start
        for term in self.terms:
            own = slice(start, start := start + len(term.parameters))
            if not holds.keeps(term) and np.any(self.values[own]):
                joints[term.joint] = None
        return tuple(joints)

    def held_by(self, holds: Holds) -> Robot:
        """Return the robot that files get which hold so much; this one where nothing of it is lost.

        Of joint zeros alone it is the nominal one, which the zeros in `files` belong to.

        Args:
            holds: How much; see `calib.robots.held`.

        Raises:
            ComputationError: Terms of joint errors would be lost, and no fit says what is best without them.
        """
        known = self.files.get(holds)
        if known is None:
            lost = self.lost_by(holds)
            if lost:
                raise ComputationError(
                    f"{self.path}: a file that holds {holds.value} loses the terms of joint errors of {listed(lost)},"
                    " and the origins here belong to these terms; a fit finds those that are best without them: export"
                    " its result, or fit again what an earlier version has fitted"
                )
            return self
        robot = self.without_terms(holds)
        return robot.at_nominal() if len(known.offsets) else robot.with_parameters(known.values)

    def without_terms(self, holds: Holds) -> Robot:
        """Return the robot without the terms of joint errors that files lose which hold so much, values as they are."""
        kept = [section for section in self.description.terms if holds.keeps(TERMS[section.term])]
        robot = self.with_terms(kept)
        names = {parameter.name for parameter in robot.parameters}
        held = tuple(name for name in robot.description.held if name in names)
        fleet = robot.description.fleet if robot.terms == self.terms else None  # its means belong with the terms
        return replace(robot, description=robot.description.model_copy(update={"held": held, "fleet": fleet}))

    def check_names(self) -> None:
        """Raise `DescriptionError` if two parameters share a name."""
        names = [parameter.name for parameter in self.parameters]
        twice = next((name for name, n in Counter(names).items() if n > 1), None)
        if twice is not None:
            raise DescriptionError(f"{self.path}: parametrisation: a parameter name is used twice: '{twice}'")

    def joint_vector(self, q: ArrayLike) -> FloatArray:
        """Check actuated joint values and return them as (n, n_actuated).

        Raises:
            DataError: Wrong shape, or values that are not finite.
        """
        values = np.atleast_2d(np.asarray(q, dtype=float))
        if values.ndim != 2 or values.shape[1] != len(self.joint_names):
            raise DataError(
                f"joint values of shape {np.shape(q)}; expected (n, {len(self.joint_names)}) in the order"
                f" {', '.join(self.joint_names)}"
            )
        if not np.all(np.isfinite(values)):
            row, column = np.argwhere(~np.isfinite(values))[0]
            raise DataError(f"pose {row}: joint '{self.joint_names[column]}' is not finite")
        if np.any(np.abs(values) > _LARGEST_JOINT):
            row, column = np.argwhere(np.abs(values) > _LARGEST_JOINT)[0]
            raise DataError(
                f"pose {row}: joint '{self.joint_names[column]}' is {values[row, column]:.3g} m or rad, which no robot"
                " reaches; check the value and its unit"
            )
        return values

    def close(
        self,
        q: ArrayLike,
        seed: FloatArray | None = None,
        columns: tuple[FloatArray, ...] | None = None,
        *,
        thorough: bool = True,
    ) -> loops.Closed:
        """Solve the loops of each pose without raising; see `calib.robots.loops.close`.

        Args:
            q: Commanded joints, (n, n_actuated) [m or rad].
            seed: Passive joints to start from, (n, n_passive).
            columns: Of `term_columns`, if they are known.
            thorough: Whether to try every way; False is faster, and may leave poses open that close.
        """
        values = self.joint_vector(q)
        actual = self.actual(values, self.term_columns(values) if columns is None else columns)
        return loops.close(self.mechanism, self.mode, actual, seed, thorough=thorough)

    def configurations(
        self, q: FloatArray, closed: loops.Closed, columns: tuple[FloatArray, ...] | None = None
    ) -> Configurations:
        """Return closed poses of commands q (n, n_actuated) as configurations."""
        phi = self.term_columns(q) if columns is None else columns
        return Configurations(self.actual(q, phi), closed.passive, closed.slope, phi)

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
            labels: What to call each pose in messages, n of them.
            context: Under which conditions the commands were given; joint terms may depend on it.

        Raises:
            UnreachablePoseError: A loop stays open; the message names pose and loop and the miss.
        """
        values = self.joint_vector(q)
        columns = self.term_columns(values, context)
        closed = self.close(values, seed, columns)
        if not np.all(closed.ok):
            raise UnreachablePoseError(describe_open(self, values, closed, labels))
        return self.configurations(values, closed, columns)

    def singular_values(self, configurations: Configurations) -> FloatArray:
        """Return each pose's distance to a singularity of the loops, (n,): see `calib.robots.closure`."""
        return singular_values(self.mechanism, configurations.slope)

    def near_singularities(self, configurations: Configurations, labels: Sequence[str]) -> list[str]:
        """Return a remark on every configuration that is near a singularity of the loops.

        There small errors of parameters and joints move the passive joints far.

        Args:
            configurations: Of `assemble`.
            labels: What to call each, n of them.
        """
        limit, values = self.description.singularity_limit, self.singular_values(configurations)
        return [near_singularity(labels[k], values[k], limit) for k in map(int, np.flatnonzero(values < limit))]

    @worded
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
        configurations, pair = self.assemble(q), self._seen(frame)
        joints = self.mechanism.all_joints(configurations.actuated, configurations.passive)
        swept = kinematics.sweep(self.mechanism, joints, (pair,))
        transforms = kinematics.relative_pose(swept, pair)
        return transforms[0] if np.ndim(q) == 1 else transforms

    def _seen(self, frame: str | None) -> RelativeFrame:
        """A frame seen from the measurement frame."""
        target = self.mechanism.targets[0]
        return target if frame is None else replace(target, b=self.mechanism.joint(frame))

    @worded
    def jacobian(self, q: ArrayLike, frame: str | None = None) -> FloatArray:
        """Geometric Jacobian of a frame by the actuated joints, through the closed loops.

        [v; w] = J dq/dt, with v the velocity of the frame's origin and w its angular velocity, both in the axes of the
        measurement frame (Pinocchio's LOCAL_WORLD_ALIGNED). Where joint terms say that a joint is not what it is told,
        dq/dt is how it really moves.

        Args:
            q: Actuated joints, (n, n_actuated) or (n_actuated,) [m or rad].
            frame: As in `forward`.

        Returns:
            (n, 6, n_actuated) or (6, n_actuated) [m or rad, per m or rad].

        Raises:
            DataError: Joint values of the wrong shape.
            DescriptionError: Unknown frame.
            UnreachablePoseError: A loop cannot be closed.
        """
        found, pair = self.assemble(q), self._seen(frame)
        by_joint = actuated_jacobian(self.mechanism, pair, found.actuated, found.passive)[2]
        own = by_joint[:, :, : len(self.joint_names)]
        return own[0] if np.ndim(q) == 1 else own

    @worded
    def positions(self, q: ArrayLike, context: Context | None = None, seed: FloatArray | None = None) -> FloatArray:
        """Positions of all targets in the measurement frame, loops closed, (n, n_targets, 3) [m].

        Args:
            q: Actuated joints, (n, n_actuated) or (n_actuated,) [m or rad].
            context: Under which conditions the commands were given; joint terms may depend on it.
            seed: See `assemble`.

        Raises:
            DataError: Joint values of the wrong shape.
            UnreachablePoseError: A loop cannot be closed.
        """
        configurations = self.assemble(q, seed, context=context)
        joints = self.mechanism.all_joints(configurations.actuated, configurations.passive)
        swept = kinematics.sweep(self.mechanism, joints, self.mechanism.targets)
        return np.stack([kinematics.value(swept, target) for target in self.mechanism.targets], axis=1)

    @worded
    def sample(
        self, count: int, seed: int | np.random.Generator = 0, *, within: Ranges | ArrayLike | None = None
    ) -> FloatArray:
        """Return joint values at random over the joint limits, loops closed; see `calib.robots.joint_sampling`.

        Nothing is brought to what the robot touches: `calib.sample` does that, and gives poses with names.

        Args:
            count: How many.
            seed: Of the random numbers; or where they come from.
            within: Ranges to stay in, inside the joint limits: by name [SI], or joint values that span them,
                (n, n_actuated) [m or rad].

        Returns:
            (count, n_actuated) [m or rad].

        Raises:
            InputError: The count or the seed is negative, or a range is not one; or more than fits into memory.
            DataError: Not enough were found, even near home; or a sliding joint has no limits.
        """
        if count < 1:
            raise InputError(f"count {count}: at least one pose is needed")
        require_memory(2 * count * len(self.joint_names), f"sampling {count} poses", "sample fewer")
        if within is not None and not isinstance(within, Mapping):
            joints = self.joint_vector(within)
            spans = zip(joints.min(axis=0).tolist(), joints.max(axis=0).tolist(), strict=True)
            within = dict(zip(self.joint_names, spans, strict=True))
        coordinates = [f"{target}_{axis}" for target in self.target_names for axis in "xyz"]
        ranges = checked_ranges(within or {}, (*self.joint_names, *coordinates))
        box = joint_box(self.mechanism, self.urdf, self.home, ranges, self.path)
        low, high = np.array([ranges.get(name, (-np.inf, np.inf)) for name in coordinates]).reshape(-1, 2).T
        bounded = not ranges.keys().isdisjoint(coordinates)

        def taken(q: FloatArray) -> IntArray:
            closed = self.close(q, thorough=False)  # others are tried in place of those that are hard to reach
            good = np.flatnonzero(closed.ok)
            distance = self.singular_values(self.configurations(q[good], closed.at(good)))
            good = good[distance >= self.description.singularity_limit]
            if not bounded or len(good) == 0:
                return good
            points = self.positions(q[good]).reshape(len(good), -1)
            return good[np.all((points >= low) & (points <= high), axis=1)]

        with compiled_for(TRIES * count if self.mechanism.loops else 0):
            found = spread(count, random_numbers(seed), box, self.home, taken, draw_in=not bounded)
        if len(found) < count:
            what = "are within these ranges; widen them" if ranges else "can be assembled; give a file of poses"
            raise DataError(f"{self.path}: only {len(found)} of {count} random poses {what}")
        return found

    def calibrated_urdf(self) -> bytes:
        """Return the URDF of the calibrated robot; unchanged numbers keep their bytes.

        Terms of joint errors have no place in it. Of a fit that has some, it gets the origins that are best without.

        Raises:
            ComputationError: There are such terms, and no fit says which origins are best without them.
        """
        return self.held_by(Holds.ORIGINS).urdf_of_origins()

    def urdf_of_origins(self) -> bytes:
        """Return the URDF with the origins that the current values give, whatever terms of joint errors go with them.

        Unchanged numbers keep their bytes.
        """
        edits: dict[str, tuple[Triple, Triple]] = {}
        for joint in self.urdf.joints:
            before, after = self.nominal.placement(joint.name), self.mechanism.placement(joint.name)
            xyz, rpy = _edited(joint.xyz, after.translation), joint.rpy
            if not np.array_equal(before.rotation, after.rotation):
                rpy = _edited(joint.rpy, pin.rpy.matrixToRpy(after.rotation))
            edits[joint.name] = (xyz, rpy)
        return self.urdf.with_origins(edits)


def _flat(names: Sequence[str | Sequence[str]]) -> tuple[str, ...]:
    """Names that were given one after the other, or as a list."""
    return tuple(name for one in names for name in ((one,) if isinstance(one, str) else one))


def _edited(text: Triple, numbers: FloatArray) -> Triple:
    """The numbers (3,), but those of the file where only rounding lies between."""
    x, y, z = (old if abs(new - old) <= _ROUNDING else float(new) for old, new in zip(text, numbers, strict=True))
    return (x, y, z)


def require_robot(robot: object) -> None:
    """Raise `InputError` for what is no robot, such as a fit, whose caller nobody checked."""
    if not isinstance(robot, Robot):
        raise InputError(
            f"robot: expected a Robot, not {type(robot).__name__}; load one with calib.load; a fit has one as .robot"
        )


def near_singularity(label: str, value: float, limit: float) -> str:
    """Say that a pose with this smallest singular value is nearer to a singularity of the loops than the limit."""
    return f"{label}: {value:.2g} from a singularity of the loops (limit {limit:g})"


def describe_open(robot: Robot, q: FloatArray, closed: loops.Closed, labels: Sequence[str] | None = None) -> str:
    """Say which of the poses q (n, n_actuated) do not close, at which loop, and by how much the first one misses."""
    poses = np.flatnonzero(~closed.ok)
    names = labels or [f"pose {k}" for k in range(len(closed.ok))]
    k = int(poses[0])
    why = why_open(robot.mechanism, robot.mode, robot.mechanism.untilted(q[k : k + 1])[0])
    more = f" (and {len(poses) - 1} more poses)" if len(poses) > 1 else ""
    return f"{names[k]}{more}: {why}; check these joint values, or leave the pose out"

"""The data of a robot: its description, its mechanism, its parameters and their values.

Other modules have the functions of a robot: joints from commands (`calib.core.robots.joint_errors`), closed loops
(`calib.core.robots.configurations`), the robots that files can hold (`calib.core.robots.robot_files`). A `Robot` has
those that users need as methods.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from calib.core.base.arrays import BoolArray, FloatArray, NamedRows, ReadOnlyArrays, read_only
from calib.core.base.errors import DescriptionError, ParameterError, require_known
from calib.core.base.parameter import Parameters
from calib.core.base.units import quantity
from calib.core.instruments.kind import Instrument
from calib.core.robots.accuracy_of_files import FileRobot, Holds
from calib.core.robots.closure import AssemblyMode
from calib.core.robots.described_instruments import pair_names
from calib.core.robots.description import Description
from calib.core.robots.mechanism import Mechanism, RelativeFrame, view
from calib.core.robots.parameters import Parametrisation
from calib.core.robots.terms.term import JointTerm
from calib.core.robots.urdf.text import UrdfText


@dataclass(frozen=True, eq=False, repr=False)
class RobotData(ReadOnlyArrays):
    """A robot with given parameter values.

    Attributes:
        path: File that it was loaded from.
        description: The robot description.
        urdf: The nominal URDF.
        nominal: Mechanism with nominal origins.
        mechanism: Mechanism with the origins that `values` give.
        parametrisation, instruments, terms: Its parameters, instruments, and terms of the joints' errors.
        values: Current parameter values, (n_parameters,) [m or rad]: of the parametrisation, then unknown numbers of
            the instruments, then coefficients of the terms.
        mode: Home configuration and assembly mode of the nominal robot.
        files: The robot that each kind of file holds. Only the robot of a fit has them; a change of values drops them.
    """

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

    @property
    def name(self) -> str:
        """The robot's name in its URDF."""
        return self.urdf.name

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints, in the order of every joint vector."""
        return self.mechanism.actuated

    @property
    def sensed_names(self) -> tuple[str, ...]:
        """Names of the actuated joints that inclinometers read, which are not commanded."""
        sensed = {name for section in self.description.inclinometers.values() for name in section.joints}
        return tuple(name for name in self.joint_names if name in sensed)

    @property
    def commanded_names(self) -> tuple[str, ...]:
        """Names of the actuated joints that are commanded: all but those that inclinometers read."""
        return tuple(name for name in self.joint_names if name not in self.sensed_names)

    @property
    def passive_names(self) -> tuple[str, ...]:
        """Names of the joints that the loops decide."""
        return self.mechanism.passive

    @cached_property
    def target_names(self) -> tuple[str, ...]:
        """Names of the measured points."""
        return tuple(target.name for target in self.mechanism.targets)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the frames that `forward` and `jacobian` know: links, joints and targets."""
        return tuple(self.mechanism.frames)

    @property
    def joint_limits(self) -> FloatArray:
        """Lower and upper limits of the actuated joints, (n_actuated, 2) [m or rad]; infinite where there are none.

        Rows also have the joints' names: `joint_limits["elbow"]`, (2,).
        """
        return NamedRows.from_array(np.stack(self.urdf.limits(self.joint_names), axis=1), self.joint_names)

    @property
    def home(self) -> FloatArray:
        """Actuated joints of the home configuration, (n_actuated,) [m or rad]."""
        return read_only(self.mode.actuated[: len(self.joint_names)])

    @cached_property
    def unreported_targets(self) -> dict[str, int]:
        """Targets for which the uncertainty of positions is not reported, and their places among the targets.

        If a target is read only from unknown places, as by a camera beside the robot, readings hardly determine its
        position. It is left out if other targets are read in the measurement frame, or from known places.
        """
        read: dict[bool, set[str]] = {True: set(), False: set()}
        for instrument in self.instruments:
            unknown = {place.name for place in instrument.places() if place.unknown}
            if any(part.dimension != "angle" for part in instrument.parts):
                for place, target in instrument.pairs(""):
                    read[place in unknown].add(target)
        unsure = read[True] - read[False] if read[False] else set()
        return {name: k for k, name in enumerate(self.target_names) if name in unsure}

    @property
    def reported_targets(self) -> list[int]:
        """Indices of the targets that are not left out."""
        return [k for k, name in enumerate(self.target_names) if name not in self.unreported_targets]

    @cached_property
    def parameters(self) -> Parameters:
        """Parameters, in the order of `values`, and by name; two of one name are a `DescriptionError`."""
        of_instruments = tuple(p for instrument in self.instruments for p in instrument.unknowns)
        of_terms = tuple(p for term in self.terms for p in term.parameters)
        parameters = self.parametrisation.parameters + of_instruments + of_terms
        twice = next((name for name, n in Counter(parameter.name for parameter in parameters).items() if n > 1), None)
        if twice is not None:
            raise DescriptionError(f"{self.path}: parametrisation: a parameter name is used twice: '{twice}'")
        fleet = self.description.fleet
        return Parameters(parameters if fleet is None else fleet.expected(parameters, self.path))

    @property
    def values_by_name(self) -> dict[str, float]:
        """Value of each parameter by its name [m or rad]."""
        return dict(zip((parameter.name for parameter in self.parameters), self.values.tolist(), strict=True))

    @cached_property
    def is_free(self) -> BoolArray:
        """Mask of the parameters that a fit may change: all but the held ones, (n_parameters,)."""
        return read_only(np.array([parameter.name not in self.description.held for parameter in self.parameters]))

    @cached_property
    def n_origin_parameters(self) -> int:
        """Number of parameters that move origins; they come first."""
        return len(self.parametrisation.parameters)

    @cached_property
    def coefficients(self) -> slice:
        """Mask of the coefficients of joint terms; they come last."""
        n = len(self.parameters)
        return slice(n - sum(len(term.parameters) for term in self.terms), n)

    def terms_with_places(self) -> Iterator[tuple[JointTerm, slice]]:
        """Yield each joint term with the place of its coefficients among the parameters."""
        start = self.coefficients.start
        for term in self.terms:
            yield term, slice(start, start := start + len(term.parameters))

    def term_values(self) -> Iterator[tuple[JointTerm, FloatArray]]:
        """Yield each joint term with the values of its coefficients, (n_coefficients,) [SI]."""
        return ((term, self.values[place]) for term, place in self.terms_with_places())

    @cached_property
    def turns_gravity(self) -> bool:
        """Whether the last two coefficients are gravity's direction, with which all `term_columns` vary."""
        return any(not term.adds for term in self.terms)

    def instrument(self, name: str) -> Instrument:
        """Return an instrument; an unknown name is a `DescriptionError`."""
        by_name = {instrument.name: instrument for instrument in self.instruments}
        require_known(name, by_name, "no instrument", DescriptionError)
        return by_name[name]

    @cached_property
    def unknowns(self) -> dict[str, slice]:
        """Which parameters are the unknown numbers of each instrument, by its name."""
        ends = np.cumsum([self.n_origin_parameters, *(len(instrument.unknowns) for instrument in self.instruments)])
        return {each.name: slice(*ends[k : k + 2].tolist()) for k, each in enumerate(self.instruments)}

    @cached_property
    def pairs(self) -> dict[str, tuple[RelativeFrame, ...]]:
        """Pairs of frames that each instrument measures between, by its name, in the order of `Readings.pairs`."""
        places, description = self.mechanism.places, self.description
        return {
            instrument.name: tuple(view(places, a, b) for a, b in pair_names(description, instrument))
            for instrument in self.instruments
        }

    def with_parameters(self, values: Mapping[str, float | str] | ArrayLike) -> Self:
        """Return a robot with other parameter values.

        Args:
            values: New values by name [m or rad], or text such as `0.5 mm`, the others staying as they are; or all of
                them, (n_parameters,).

        Raises:
            ParameterError: Unknown name, wrong number of values, or a value that is not finite.
        """
        if isinstance(values, Mapping):
            vector = self.values.copy()
            for place, (name, value) in zip(self.parameters.places(values), values.items(), strict=True):
                is_text = isinstance(value, str)
                vector[place] = quantity(value, self.parameters[place].dimension, name) if is_text else value
        else:
            vector = np.array(values, dtype=float)
        if vector.shape != self.values.shape:
            raise ParameterError(f"{vector.size} values given for {self.values.size} parameters")
        if not np.all(np.isfinite(vector)):
            bad = self.parameters[int(np.argmin(np.isfinite(vector)))].name
            raise ParameterError(f"parameter '{bad}': value is not finite")
        mechanism = self.nominal.with_placements(self.parametrisation.placements(vector[: self.n_origin_parameters]))
        return self._with(values=vector, mechanism=mechanism, files={})

    def with_nominal_values(self) -> Self:
        """Return a robot with nominal parameter values."""
        return self.with_parameters([parameter.nominal_si for parameter in self.parameters])


SomeRobot = TypeVar("SomeRobot", bound=RobotData)

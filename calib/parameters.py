"""Parameters: what may be wrong with a robot, and what a parameter does to the joint origins.

A parametrisation maps a vector of values to joint origins and gives the derivative as twists. The twist xi_i of origin
i is the right perturbation `placement_i * exp6(xi_i)`, [linear; angular] in the joint's own frame, so

    d(measured)/d(parameters) = d(measured)/d(xi) . d(xi)/d(parameters)

and the first factor is the same for every parametrisation.

`OriginComponents` is the general one. With nominal origin (t, R), its parameters give

    translation  t + [x, y, z]        (in the parent link, as URDF's xyz)
    rotation     R exp([rx, ry, rz])  (a rotation vector in the joint frame, 0 at nominal)

A rotation vector, and not URDF's rpy, because rpy has no derivative at pitch = +-90 degrees, where many robots have
joints. The value shown for a translation is the coordinate itself; for a rotation it is the deviation.

The measurement frame is the one origin that is edited the other way round: the parameters of `base` are those of the
robot's link seen in the measurement frame. A tracker stands metres away; turning the robot about its own base keeps
the model close to linear, turning it about the tracker would not.

Other packages add parametrisations of their own under the entry point group `calib.parametrisations`: a callable that
takes the nominal origins by name and returns a `Parametrisation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np
import pinocchio as pin

from calib.description import ANGLE_COMPONENTS, COMPONENTS, LENGTH_COMPONENTS, Component, Description, OriginSection
from calib.errors import DescriptionError, InputError, ParameterError, nearest
from calib.mechanism import FloatArray, Mechanism
from calib.units import DISPLAY_UNIT, Dimension, per_si, quantity

ENTRY_POINTS = "calib.parametrisations"
DEFAULT_LENGTH_SIGMA = 2e-3
"""Expected error of an origin's coordinate where nothing is stated [m]."""
DEFAULT_ANGLE_SIGMA = 5e-3
"""Expected error of an origin's angle where nothing is stated [rad]."""


@dataclass(frozen=True)
class Parameter:
    """One number that may differ from its nominal value.

    Attributes:
        name: Unique name.
        dimension: Length or angle.
        nominal: Value in the description [m or rad].
        sigma: Expected deviation from nominal, one standard deviation [m or rad]; scales its column, and is its prior.
        unit: Unit in tables.
        prior: Whether nominal +- sigma counts as information in a fit. False: the measurements alone decide.
        placement: Whether it only says where the measurement frame or a target is, which is no error of the robot.
    """

    name: str
    dimension: Dimension
    nominal: float
    sigma: float
    unit: str
    prior: bool = True
    placement: bool = False


@dataclass(frozen=True)
class Origin:
    """A nominal joint origin as the URDF has it: `xyz` (3,) [m] in the parent link, `rpy` (3,) fixed-axis angles [rad].

    That of `base` is the pose of its link in the measurement frame.
    """

    xyz: FloatArray
    rpy: FloatArray

    @property
    def placement(self) -> pin.SE3:
        """The origin as a rigid transform, parent link to joint."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), self.xyz)


class Parametrisation(Protocol):
    """What the engine needs to know of a set of parameters."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order of every vector and column."""

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the origins that the values (n_parameters,) [m or rad] give, by name; the others stay nominal."""

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return d(xi)/d(values) of the same origins, (6, n_parameters) each; see the module docstring for xi."""


def twist_of_edit(rpy: FloatArray, d_xyz: FloatArray, d_rpy: FloatArray) -> FloatArray:
    """Turn derivatives of URDF's xyz and rpy into a right-perturbation twist.

    xi = [R^T dxyz ; W(rpy) drpy], with W Pinocchio's local roll-pitch-yaw Jacobian.

    Args:
        rpy: Angles at which to differentiate, (3,) [rad].
        d_xyz: d(xyz)/d(parameters), (3, n_parameters).
        d_rpy: d(rpy)/d(parameters), (3, n_parameters).

    Returns:
        (6, n_parameters).
    """
    rotation = pin.rpy.rpyToMatrix(*rpy)
    return np.vstack([rotation.T @ d_xyz, pin.rpy.computeRpyJacobian(rpy, pin.ReferenceFrame.LOCAL) @ d_rpy])


@dataclass(frozen=True, eq=False)
class OriginComponents:
    """Any components of any joint origins; see the module docstring.

    Attributes:
        parameters: One for each component.
        places: (origin name, index into x, y, z, rx, ry, rz) of each parameter.
        nominal: Nominal (t, R) of each origin that has parameters.
        inverted: Origins whose (t, R) is the inverse of their placement.
    """

    parameters: tuple[Parameter, ...]
    places: tuple[tuple[str, int], ...]
    nominal: dict[str, pin.SE3]
    inverted: frozenset[str] = frozenset()

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the edited origins; see `Parametrisation`."""
        edited = {name: self._edited(name, moved) for name, moved in self._deviations(values).items()}
        return {name: pose.inverse() if name in self.inverted else pose for name, pose in edited.items()}

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the derivative of each origin; see `Parametrisation`."""
        result: dict[str, FloatArray] = {}
        for name, moved in self._deviations(values).items():
            columns = [k for k, (origin, _) in enumerate(self.places) if origin == name]
            components = [self.places[k][1] for k in columns]
            pose = self._edited(name, moved)
            whole = np.zeros((6, 6))
            whole[:3, :3] = pose.rotation.T
            whole[3:, 3:] = pin.Jexp3(moved[3:])
            if name in self.inverted:  # (T exp(xi))^-1 = T^-1 exp(-Ad(T) xi)
                whole = -pose.toActionMatrix() @ whole
            result[name] = np.zeros((6, len(self.parameters)))
            result[name][:, columns] = whole[:, components]
        return result

    def _edited(self, name: str, moved: FloatArray) -> pin.SE3:
        nominal = self.nominal[name]
        return pin.SE3(nominal.rotation @ pin.exp3(moved[3:]), nominal.translation + moved[:3])

    def _deviations(self, values: FloatArray) -> dict[str, FloatArray]:
        moved: dict[str, FloatArray] = {name: np.zeros(6) for name in self.nominal}
        for parameter, (name, component), value in zip(self.parameters, self.places, values, strict=True):
            moved[name][component] = value - parameter.nominal
        return moved


def build_parametrisation(
    description: Description, origins: Mapping[str, Origin], mechanism: Mechanism
) -> Parametrisation:
    """Build the parametrisation that a description names or lists, plus an unknown base and unknown targets.

    Raises:
        DescriptionError: Unknown plugin, origin or unit, or a component listed twice.
    """
    if isinstance(description.parametrisation, str):
        if description.base.pose == "unknown" or any(t.position == "unknown" for t in description.targets.values()):
            raise DescriptionError(
                f"{description.urdf}: a named parametrisation has its own base and target parameters;"
                " set base.pose and targets.*.position to 'known'"
            )
        return _plugin(description.parametrisation)(origins)
    listed = sorted(description.parametrisation, key=lambda section: section.origin == "all")  # exact entries win
    entries = [(section, description.priors, False) for section in listed]
    entries += [(section, prior, True) for section, prior in _unknown_places(description, mechanism)]
    parameters: dict[str, Parameter] = {}
    places: list[tuple[str, int]] = []
    for section, prior, placement in entries:
        for origin in _origins_of(section, mechanism, description.urdf):
            for component in section.components:
                parameter = _component_parameter(section, origin, component, origins, description.urdf)
                parameter = replace(parameter, prior=prior, placement=placement)
                if parameter.name in parameters:
                    if section.origin == "all":
                        continue
                    raise DescriptionError(f"{description.urdf}: parametrisation: '{parameter.name}' is listed twice")
                parameters[parameter.name] = parameter
                places.append((origin, COMPONENTS.index(component)))
    nominal = {name: origins[name].placement for name in dict.fromkeys(origin for origin, _ in places)}
    return OriginComponents(tuple(parameters.values()), tuple(places), nominal, inverted=frozenset({_base(mechanism)}))


def default_sections() -> tuple[OriginSection, ...]:
    """Return the entries for a plain URDF: every component of every origin that moves a target, with default priors."""
    return (
        OriginSection(origin="all", components=LENGTH_COMPONENTS, sigma=f"{DEFAULT_LENGTH_SIGMA * 1e3:g} mm"),
        OriginSection(origin="all", components=ANGLE_COMPONENTS, sigma=f"{DEFAULT_ANGLE_SIGMA * 1e3:g} mrad"),
    )


def _base(mechanism: Mechanism) -> str:
    return mechanism.origin_names[mechanism.targets[0].a - 1]


def _unknown_places(description: Description, mechanism: Mechanism) -> list[tuple[OriginSection, bool]]:
    """Entries for a base or targets whose place is not known beforehand, and whether `sigma` is a prior for them."""
    sections = []
    base = _base(mechanism)
    if description.base.pose == "unknown":
        sections += [
            (OriginSection(origin=base, components=LENGTH_COMPONENTS, sigma="10 mm"), False),
            (OriginSection(origin=base, components=ANGLE_COMPONENTS, sigma="10 mrad"), False),
        ]
    for target in mechanism.targets:
        section = description.targets[target.name]
        if section.position == "unknown":
            origin = mechanism.origin_names[target.b - 1]
            sections.append(
                (
                    OriginSection(origin=origin, components=LENGTH_COMPONENTS, sigma=section.sigma or "10 mm"),
                    section.sigma is not None,
                )
            )
    return sections


def _origins_of(section: OriginSection, mechanism: Mechanism, where: str) -> list[str]:
    if section.origin != "all":
        if section.origin not in mechanism.origin_names:
            raise DescriptionError(
                f"{where}: parametrisation: no joint origin '{section.origin}'"
                f"{nearest(section.origin, (*mechanism.origin_names, 'all'))}"
            )
        return [section.origin]
    pairs = mechanism.targets + mechanism.loops
    virtual = {pair.a for pair in mechanism.targets} | {pair.b for pair in mechanism.targets}
    return [
        name
        for i, name in enumerate(mechanism.origin_names)
        if i + 1 not in virtual and any(mechanism.between(pair)[i] for pair in pairs)
    ]


def _component_parameter(
    section: OriginSection, origin: str, component: Component, origins: Mapping[str, Origin], where: str
) -> Parameter:
    dimension = section.dimension
    name = f"{origin}.{component}"
    place = f"{where}: parametrisation: {name}"
    try:
        sigma = quantity(section.sigma, dimension, f"{place}, sigma")
        unit = section.unit or DISPLAY_UNIT[dimension]
        per_si(unit, dimension, f"{place}, unit")
    except InputError as error:
        raise DescriptionError(str(error)) from None
    if sigma <= 0:
        raise DescriptionError(f"{place}: sigma must be positive; leave a component out to keep it at nominal")
    nominal = float(origins[origin].xyz[COMPONENTS.index(component)]) if dimension == "length" else 0.0
    return Parameter(name, dimension, nominal, sigma, unit)


def _plugin(name: str) -> Callable[[Mapping[str, Origin]], Parametrisation]:
    found = {entry.name: entry for entry in entry_points(group=ENTRY_POINTS)}
    if name not in found:
        raise DescriptionError(f"no parametrisation '{name}' is installed{nearest(name, found)}")
    factory: Callable[[Mapping[str, Origin]], Parametrisation] = found[name].load()
    return factory


def index_of(parameters: Sequence[Parameter], name: str, where: str = "parameters") -> int:
    """Return the position of a parameter; an unknown name is an error that names the nearest one."""
    for index, parameter in enumerate(parameters):
        if parameter.name == name:
            return index
    raise ParameterError(f"{where}: no parameter '{name}'{nearest(name, [p.name for p in parameters])}")

"""The parameters of a robot description: the origin components that it lists, or a named plugin.

Other packages add parametrisations of their own under the entry point group `calib.parametrisations`: a callable that
takes the nominal origins by name and returns a `calib.core.robots.parameters.Parametrisation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.core.base.errors import DescriptionError, InputError, ParameterError, nearest, require_known
from calib.core.base.parameter import Parameter, index_of
from calib.core.base.registry import list_entry_points, load_entry, load_named
from calib.core.base.sections import ANGLE_COMPONENTS, COMPONENTS, LENGTH_COMPONENTS
from calib.core.base.units import DISPLAY_UNIT, per_si, quantity, quantity_text
from calib.core.instruments.kind import Place
from calib.core.robots.described_instruments import places_of
from calib.core.robots.description import Description, OriginSection
from calib.core.robots.mechanism import Mechanism
from calib.core.robots.parameters import Origin, OriginComponents, Parametrisation, ParametrisationStack, ResultUse
from calib.core.robots.robot_data import SomeRobot
from calib.core.robots.urdf.text import UrdfText

ENTRY_POINTS = "calib.parametrisations"
Entry = tuple[OriginSection, bool, bool]
"""Components of origins, whether they have a prior, and whether they are a mere place."""
DEFAULT_LENGTH_SIGMA = 2e-3
"""Expected error of an origin's coordinate where nothing is stated [m]."""
DEFAULT_ANGLE_SIGMA = 5e-3
"""Expected error of an origin's angle where nothing is stated [rad]."""


def build_parametrisation(
    description: Description, urdf: UrdfText, mechanism: Mechanism, places: tuple[Place, ...], where: str
) -> Parametrisation:
    """Build the parametrisation that a description names or lists, plus unknown places, with the priors of its names.

    `DescriptionError` if a plugin, origin or unit is unknown, a component is listed twice, or a prior has no parameter.
    """
    plain = _without_names(description, urdf, mechanism, places, where)
    parameters = list(plain.parameters)
    _indexed_values(description.in_use, parameters, f"{where}: in_use")
    for place, sigma_si in _indexed_values(description.prior, parameters, f"{where}: prior").items():
        if sigma_si <= 0:
            name = parameters[place].name
            raise DescriptionError(f"{where}: prior of '{name}': sigma must be positive; 'held' keeps it at nominal")
        parameters[place] = replace(parameters[place], sigma_si=sigma_si, prior=True)
    return ParametrisationStack((plain,), tuple(parameters)) if description.prior else plain


def _indexed_values(given: Mapping[str, object], parameters: Sequence[Parameter], where: str) -> dict[int, float]:
    """Numbers that a description gives to parameters [SI], by the index of each; `DescriptionError` if one is wrong."""
    numbers = {}
    for name, value in given.items():
        try:
            place = index_of(parameters, name, where)
            numbers[place] = quantity(value, parameters[place].dimension, f"{where} of '{name}'")
        except InputError as error:
            raise DescriptionError(str(error)) from None
    return numbers


def robot_in_use(robot: SomeRobot) -> SomeRobot:
    """Return the robot as its controller computes it now, by the key `in_use` of its description."""
    numbers = _indexed_values(robot.description.in_use, robot.parameters, f"{robot.path}: in_use")
    return robot.with_parameters({robot.parameters[place].name: value for place, value in numbers.items()})


def _without_names(
    description: Description, urdf: UrdfText, mechanism: Mechanism, places: tuple[Place, ...], where: str
) -> Parametrisation:
    """The parametrisation without the `prior` of single parameters."""
    origins = {joint.name: Origin(np.array(joint.xyz), np.array(joint.rpy)) for joint in urdf.joints}
    origins |= {mechanism.origin(place.name): Origin(np.array(place.xyz), np.array(place.rpy)) for place in places}
    unknown = [entry for place in places for entry in _unknown_components(place, mechanism.origin(place.name))]
    inverted = frozenset(mechanism.origin(place.name) for place in places if place.inverted)
    if isinstance(description.parametrisation, str):
        if description.base.pose == "unknown" or any(t.position == "unknown" for t in description.targets.values()):
            raise DescriptionError(
                f"{where}: a named parametrisation has its own base and target parameters;"
                " set base.pose and targets.*.position to 'known'"
            )
        plugin = _from_plugin(description.parametrisation, origins, mechanism, where)
        parts = (plugin, _components(unknown, origins, mechanism, inverted, where))
        return ParametrisationStack(parts) if unknown else plugin
    listed = sorted(description.origins, key=lambda section: section.origin == "all")  # exact entries win
    entries = [(section, description.priors, False) for section in listed]
    return _components(entries + unknown, origins, mechanism, inverted, where)


def _components(
    entries: list[Entry], origins: Mapping[str, Origin], mechanism: Mechanism, inverted: frozenset[str], where: str
) -> OriginComponents:
    parameters: dict[str, Parameter] = {}
    components: list[tuple[str, int]] = []
    from_all: set[str] = set()
    for section, prior, placement in entries:
        moved = [(origin, each) for origin in _origins_of(section, mechanism, where) for each in section.components]
        if not moved:
            continue
        sigma, unit = _sigma_and_unit(section, f"{where}: parametrisation: {'.'.join(moved[0])}")
        for origin, component in moved:
            name, k = f"{origin}.{component}", COMPONENTS.index(component)
            if name in parameters:
                if section.origin == "all" and name not in from_all:
                    continue
                advice = "leave it out: an unknown base or target is free anyway" if placement else "leave one out"
                raise DescriptionError(f"{where}: parametrisation: '{name}' is listed twice; {advice}")
            start = float(origins[origin].xyz[k]) if section.dimension == "length" else 0.0
            parameters[name] = Parameter(name, section.dimension, start, sigma, unit, prior, placement)
            if section.origin == "all":
                from_all.add(name)
            components.append((origin, k))
    nominal = {name: origins[name].placement for name in dict.fromkeys(origin for origin, _ in components)}
    return OriginComponents(tuple(parameters.values()), tuple(components), nominal, inverted)


def result_use(description: Description) -> ResultUse | None:
    """Return the `result_use` of a named parametrisation: how the calibrated robot is used; None if it has none."""
    if not isinstance(description.parametrisation, str):
        return None
    return getattr(load_entry(ENTRY_POINTS, description.parametrisation), "result_use", None)


def default_sections() -> tuple[OriginSection, ...]:
    """Return the entries for a plain URDF: every component of every origin that moves a target, with default priors."""
    length, angle = quantity_text(DEFAULT_LENGTH_SIGMA, "mm", "g"), quantity_text(DEFAULT_ANGLE_SIGMA, "mrad", "g")
    entries = ((LENGTH_COMPONENTS, length), (ANGLE_COMPONENTS, angle))
    return tuple(OriginSection(origin="all", components=components, sigma=sigma) for components, sigma in entries)


def _unknown_components(place: Place, origin: str) -> list[Entry]:
    """Entries for the unknown components of a place; its sigmas are priors where they are stated."""
    entries = []
    lengths, angles = (LENGTH_COMPONENTS, place.sigma, "10 mm"), (ANGLE_COMPONENTS, place.sigma_angle, "10 mrad")
    for components, sigma, default in (lengths, angles):
        unknown = tuple(component for component in components if component in place.unknown)
        if unknown:
            section = OriginSection(origin=origin, components=unknown, sigma=default if sigma is None else sigma)
            entries.append((section, sigma is not None, True))
    return entries


def _origins_of(section: OriginSection, mechanism: Mechanism, where: str) -> list[str]:
    known = {name: i + 1 for i, name in enumerate(mechanism.origin_names) if name not in mechanism.tilts}
    require_known(section.origin, (*known, "all"), f"{where}: parametrisation: no joint origin", DescriptionError)
    if section.origin != "all":
        return [section.origin]
    virtual = set(mechanism.places.values())
    return [name for name, index in known.items() if index not in virtual and mechanism.is_seen[index - 1]]


def _sigma_and_unit(section: OriginSection, place: str) -> tuple[float, str]:
    """Sigma [SI] and unit of the parameters of an entry, of which the first is at `place`."""
    sigma = quantity(section.sigma, section.dimension, f"{place}, sigma", DescriptionError)
    unit = section.unit or DISPLAY_UNIT[section.dimension]
    per_si(unit, section.dimension, f"{place}, unit", DescriptionError)
    if sigma <= 0:
        raise DescriptionError(f"{place}: sigma must be positive; leave a component out to keep it at nominal")
    return sigma, unit


def _from_plugin(name: str, origins: Mapping[str, Origin], mechanism: Mechanism, where: str) -> Parametrisation:
    plugins = {entry.name: entry for entry in reversed(list_entry_points(ENTRY_POINTS))}
    if name not in plugins:
        raise DescriptionError(f"{where}: no parametrisation '{name}' is installed{nearest(name, plugins)}")
    factory: Callable[[Mapping[str, Origin]], Parametrisation] = load_named(plugins[name], f"{where}: parametrisation")
    parametrisation = factory(origins)
    nominal = np.array([parameter.nominal_si for parameter in parametrisation.parameters])
    twists = parametrisation.twists(nominal)
    edited = parametrisation.placements(nominal)
    for origin in (*edited, *twists):
        lacks = f"{where}: parametrisation '{name}': the robot has no origin"
        require_known(origin, mechanism.origin_names, lacks, DescriptionError)
    if set(edited) != set(twists) or any(twist.shape != (6, len(nominal)) for twist in twists.values()):
        raise DescriptionError(
            f"{where}: parametrisation '{name}': twists must give a (6, {len(nominal)}) array for each of the origins"
            " that placements edits"
        )
    return parametrisation


def with_prior(robot: SomeRobot, names: str | Sequence[str], sigma: str) -> SomeRobot:
    """Return a robot with the expected error `sigma` of parameters; see `Robot.with_prior`."""
    priors = dict(robot.description.prior)
    for name in [names] if isinstance(names, str) else names:
        place = index_of(robot.parameters, name)
        if place >= robot.n_origin_parameters:
            raise ParameterError(f"parameter '{name}' belongs to a joint term; state its sigma in the description")
        if not isinstance(sigma, str):
            number = isinstance(sigma, (float, int))
            lacks = "has no unit; write it" if number else "is not a standard deviation with its unit"
            raise InputError(f"prior of '{name}': {sigma!r:.40} {lacks}, such as '0.5 mm' or '1 mrad'")
        if quantity(sigma, robot.parameters[place].dimension, f"prior of '{name}'") <= 0:
            raise InputError(f"prior of '{name}': sigma {sigma} must be positive; fix('{name}') keeps it as it is")
        priors[name] = sigma
    description = robot.description.model_copy(update={"prior": priors})
    places = places_of(description, robot.instruments, robot.path)
    parametrisation = build_parametrisation(description, robot.urdf, robot.nominal, places, robot.path)
    changed = replace(robot, description=description, parametrisation=parametrisation)
    return changed.with_parameters(robot.values_by_name)

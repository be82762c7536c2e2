"""The robot description: a YAML file that says what a URDF cannot.

It says which joints have motors, where the loops close and in which directions, one assembled configuration, where the
measurements are taken, which origins may be wrong and by how much. Keys `name_mot`, `closed_loop` and `type` are those
of Pinocchio's toolbox-parallel-robots. Lengths and angles are SI, or text with a unit (`0.04 mm`, `1.5 deg`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Discriminator, Field, Tag, ValidationError, model_validator
from pydantic_core import ErrorDetails

from calib.core.base.errors import DescriptionError, nearest
from calib.core.base.files import read_text
from calib.core.base.registry import capability_entry
from calib.core.base.sections import (
    COMPONENTS,
    LENGTH_COMPONENTS,
    UNKNOWN_KEY,
    Component,
    FrameSection,
    Length,
    PlaceSection,
    PositiveLength,
    Quantity,
    Section,
    parse_yaml,
)
from calib.core.base.units import Dimension, stated_tolerance
from calib.core.instruments.kinds import AnyInstrument
from calib.core.instruments.noise import PositionSigma
from calib.core.robots.fleet_prior import FleetSection
from calib.core.robots.terms.gravity import GravitySection, InclinometerSection
from calib.core.robots.terms.term import TermSection
from calib.core.robots.terms.terms import AnyTerm


class BaseSection(FrameSection):
    """The frame in which positions are measured.

    Attributes:
        xyz, rpy: Pose of that link in the measurement frame [m], [rad].
        pose: `known`: that pose is right; `unknown`: it is found from the measurements.
    """

    pose: Literal["known", "unknown"] = "known"


class TargetSection(PlaceSection):
    """A measured point, or a measured frame; only instruments that see orientations need its orientation.

    State how far an unknown position may be off (`sigma`) if you can: joints that hardly turned during the measurements
    leave the point loosely determined.

    Attributes:
        shape: Shape there, in the target's axes: a nest with its reflector, a board, a camera.
        acceptance: In which directions it is seen; an angle is about its z axis.
    """

    what = "target"
    shape: Annotated[Any, *capability_entry("shape")] = None
    acceptance: Annotated[Any, *capability_entry("acceptance")] = None


class OriginSection(Section):
    """Components of joint origins that may be wrong.

    Attributes:
        origin: A joint's name, `all` (every joint origin that moves a target), `base`, or a target's name.
        components: Of x, y, z (translation, in the parent link) and rx, ry, rz (rotation vector in the joint frame).
        sigma: How far each is expected to be off (one standard deviation), with its unit.
        unit: Unit in tables; mm and deg if not given.
    """

    origin: str
    components: tuple[Component, ...] = Field(min_length=1)
    sigma: Quantity
    unit: str | None = None

    @model_validator(mode="after")
    def _one_dimension(self) -> OriginSection:
        if len({component in LENGTH_COMPONENTS for component in self.components}) > 1:
            raise ValueError("lengths (x, y, z) and angles (rx, ry, rz) need entries of their own")
        return self

    @property
    def dimension(self) -> Dimension:
        """Whether these components are lengths or angles."""
        return "length" if self.components[0] in LENGTH_COMPONENTS else "angle"


_COMMENTS = re.compile(r"^# ?(\S.*)$", re.MULTILINE)  # not those inside an entry
_FORMS = ("number", "axes", "beam")  # forms of noise (`calib.core.instruments.noise`)


def _origin_or_joint(value: Any) -> str:
    keys = value if isinstance(value, dict) else vars(value)
    return "joint" if "joint" in keys else "origin"


class Description(Section):
    """A robot description, as the YAML file has it. See docs/robot_description.md for every key.

    `xacro` has the arguments of a xacro file.
    `instruments` says what is measured, by which kind of measurement; without it, the position of every target.
    `setups` names the setups of a measurement and what had been moved or remounted before each but the first.
    `joint_terms` are terms of the joints' errors, which a list in `parametrisation` may hold too; `payload` is the
    frame that carries the mass of a column `load`. `gravity` says where down is, if not along -z of the root link;
    `inclinometers` are sensors that say how far joints are turned that are not commanded.
    `fleet` is what other robots of the model are like (`calib fleet` writes it); `model` takes it from a model that the
    program knows, such as `ur5e`, or from such a file.
    `obstacles` are what the robot must not touch, and parts of its tool; `self_clearance` is the distance that its
    links keep from each other; `sight` is from where a tracker sees the targets.
    `traceability` is where the measurements come from, for a certificate.
    `in_use` has parameters as the controller has them now, if they were computed from the same measurements.
    `tolerance` is how far the tool may be off, 95 % of the time: a verdict compares its claim with it [m].
    `join` says what joins files without joint values to those with them: the column `pose`, the order of rows, or the
    nearest `time`, at most `lag` away [s].
    `elimination_order` names parameters in the order in which `calib check` proposes to hold them, where it can choose.
    """

    urdf: str
    xacro: dict[str, str] = Field(default_factory=dict)
    name_mot: tuple[str, ...] = Field(min_length=1)
    closed_loop: tuple[tuple[str, str], ...] = ()
    type: tuple[Literal["3d", "6d"], ...] = ()
    closed_loop_axes: tuple[tuple[Component, ...], ...] | None = None
    home: dict[str, Quantity] = Field(default_factory=dict)
    base: BaseSection
    targets: dict[str, TargetSection] = Field(min_length=1)
    instruments: dict[str, AnyInstrument] = Field(default_factory=dict)
    setups: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    parametrisation: Annotated[
        Annotated[str, Tag("name")]
        | Annotated[
            tuple[
                Annotated[
                    Annotated[OriginSection, Tag("origin")] | Annotated[AnyTerm, Tag("joint")],
                    Discriminator(_origin_or_joint),
                ],
                ...,
            ],
            Tag("list"),
        ],
        Discriminator(lambda value: "name" if isinstance(value, str) else "list"),
    ]
    joint_terms: tuple[AnyTerm, ...] = ()
    payload: str | None = None
    gravity: GravitySection | None = None
    inclinometers: dict[str, InclinometerSection] = Field(default_factory=dict)
    held: tuple[str, ...] = ()
    elimination_order: tuple[str, ...] = ()
    fleet: FleetSection | None = None
    model: str | None = None
    priors: bool = True
    prior: dict[str, Quantity] = Field(default_factory=dict)
    in_use: dict[str, Quantity] = Field(default_factory=dict)
    sigma: PositionSigma | None = None
    tolerance: PositiveLength | None = None
    obstacles: Annotated[Any, *capability_entry("obstacles")] = None
    self_clearance: Annotated[Length, Field(ge=0)] = 0.005
    sight: Annotated[Any, *capability_entry("sight")] = None
    traceability: Annotated[Any, *capability_entry("traceability")] = None
    singularity_limit: Annotated[float, Field(gt=0, lt=1)] = 0.02
    columns: dict[str, str] = Field(default_factory=dict)
    join: Literal["pose", "rows", "time"] = "pose"
    lag: Annotated[float, Field(gt=0)] = 0.02

    @model_validator(mode="after")
    def _check_lists(self) -> Description:
        for key in ("name_mot", "held", "elimination_order"):
            names = getattr(self, key)
            again = next((name for k, name in enumerate(names) if name in names[:k]), None)
            if again is not None:
                raise ValueError(f"'{key}' names '{again}' twice")
        n = len(self.closed_loop)
        for key in ("type", "closed_loop_axes"):
            entries = getattr(self, key)
            if entries is not None and len(entries) != n:
                raise ValueError(f"'{key}' has {len(entries)} entries for {n} entries of 'closed_loop'")
        return self

    @property
    def origins(self) -> tuple[OriginSection, ...]:
        """Listed components of origins; none where the parametrisation has a name."""
        listed = () if isinstance(self.parametrisation, str) else self.parametrisation
        return tuple(section for section in listed if isinstance(section, OriginSection))

    @property
    def terms(self) -> tuple[TermSection, ...]:
        """Listed joint terms."""
        listed = () if isinstance(self.parametrisation, str) else self.parametrisation
        return tuple(section for section in listed if isinstance(section, TermSection)) + self.joint_terms

    def with_terms(self, sections: Sequence[TermSection]) -> Description:
        """Return the description with these joint terms in place of its own."""
        listed = self.parametrisation if isinstance(self.parametrisation, str) else self.origins
        return self.model_copy(update={"parametrisation": listed, "joint_terms": tuple(sections)})

    def loop_axes(self, index: int) -> tuple[Component, ...]:
        """Constrained directions of one closure: as given, or all that its type has."""
        if self.closed_loop_axes is not None:
            return self.closed_loop_axes[index]
        return COMPONENTS if self.type[index] == "6d" else LENGTH_COMPONENTS


def read_description(path: Path | str) -> Description:
    """Read a robot description; a `DescriptionError` names the place of a mistake."""
    text = read_text(path, "a robot description (YAML) or a URDF", DescriptionError)
    content = parse_yaml(text, path)
    if not isinstance(content, dict):
        raise DescriptionError(
            f"{path}: is not a mapping of keys to values; `calib init URDF` writes one to start from"
        )
    description = validate_description(content, path)
    in_comments = stated_tolerance(_COMMENTS.findall(text), str(path), DescriptionError)
    if in_comments is None:
        return description
    return description.model_copy(update={"tolerance": min(in_comments, description.tolerance or in_comments)})


def validate_description(content: Mapping[str, Any], where: Path | str) -> Description:
    """Validate keys and values of a robot description; a `DescriptionError` names the place of a wrong one.

    Files that it names are relative to its own, `where`.
    """
    try:
        return Description.model_validate(content, context={"folder": Path(where).parent})
    except ValidationError as error:
        raise DescriptionError(f"{where}: {_one_line(error)}") from None


def description_yaml(description: Description) -> str:
    """Return a description as YAML that reads back the same, numbers in SI and points of files written out."""
    content = description.model_dump(mode="json", exclude_unset=True)
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _one_line(error: ValidationError) -> str:
    """Turn pydantic's complaints into one line: where, what, and the nearest valid key."""
    complaints = error.errors()  # a misspelled key first: it explains why another one is missing
    first = next((detail for detail in complaints if detail["type"] == UNKNOWN_KEY), complaints[0])
    location = [part for k, part in enumerate(first["loc"]) if not _is_tag(k, first["loc"])]
    if first["type"] == "invalid_key" or location[-1:] == ["[key]"]:  # 1, on, yes, null: YAML reads them as no text
        return f"key {first['input']} should be text; put it in quotes"
    if first["type"] == UNKNOWN_KEY:
        return f"unknown key '{_place([*location, first['ctx']['key']])}'{first['ctx']['hint']}"
    place = _place(location)
    if first["type"] == "missing":
        *before, last = location
        missing = f"key '{place}'" if isinstance(last, str) else f"{_place(before)}: entry {last + 1}"
        return f"{missing} is missing"
    return (f"{place}: " if place else "") + _complaint(first)


def _is_tag(k: int, location: tuple[int | str, ...]) -> bool:
    """Whether pydantic put the k-th part of a location there to tell forms of a value apart."""
    if location[0] == "parametrisation":
        return k in (1, 3)
    if location[0] == "instruments":
        return k > 2 and location[k] in _FORMS
    return location[0] == "sigma" and k == 1 and location[k] in _FORMS


def _place(location: list[int | str]) -> str:
    """Write a place in the file as `targets.tool.xyz[2]`."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")


def _complaint(detail: ErrorDetails) -> str:
    """Say what is wrong with a value, in the words of the file rather than of Python."""
    kind, given, context = detail["type"], detail["input"], detail.get("ctx", {})
    if kind == "value_error":
        return detail["msg"].removeprefix("Value error, ")
    if kind == "literal_error":
        valid = re.findall("'([^']*)'", context["expected"])
        return f"unknown value '{given}'{nearest(str(given), valid)}"
    if kind in ("too_short", "too_long"):
        limit = f"least {context['min_length']}" if kind == "too_short" else f"most {context['max_length']}"
        return f"should have at {limit} entries, not {context['actual_length']}"
    shown = "" if isinstance(given, (dict, list)) else f" (given: {given!r:.60})"
    if kind == "string_type":
        return f"should be text{'' if isinstance(given, (dict, list)) else '; put it in quotes'}{shown}"
    if kind == "tuple_type":
        return f"should be a list, such as [a, b]{shown}"
    if kind in ("model_type", "dict_type"):
        return f"should be keys and values, such as {{frame: base_link}}{shown}"
    return detail["msg"].removeprefix("Input ") + shown

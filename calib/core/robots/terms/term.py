"""Interface of joint terms.

Joints are not exactly at their commands. The error of joint j is a sum of terms,

    dq_j = sum over terms of c_k phi_k(q, context)

with coefficients c_k that are fitted like all other parameters, and columns phi_k that depend on commands and context
only. So derivatives are exact, d(anything)/dc_k = d(anything)/d(joint j) phi_k, through closed loops, too. A new term
is one small class, here with a line in `calib.core.robots.terms.terms`, or in another package with an entry point.

Every coefficient has the dimension of its joint (an angle or a length): it is the error at phi_k = 1.

Instead, a term may tilt the link after its joint by angles c_k phi_k, about each axis about which the joint itself does
not turn. The coefficients are the same for all these axes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter
from calib.core.base.sections import Quantity, Section
from calib.core.base.units import Dimension
from calib.core.robots.terms.formula import Formula, Proportional, Source
from calib.core.robots.terms.gravity import COLUMNS as GRAVITY
from calib.core.robots.terms.gravity import read_down


class TermSection(Section):
    """A term of one joint's error, or of every actuated joint's.

    Attributes:
        joint: Name of the joint; `all` for every actuated joint.
        term: Name of the term.
        sigma: Expected size of its coefficients (one standard deviation), in the joint's unit.
    """

    joint: str
    term: str
    sigma: Quantity | None = None

    def with_stroke(self, stroke: float) -> TermSection:
        """Return the entry for a prismatic joint with this stroke [m]; the same entry if the term needs no stroke."""
        return self


@dataclass(frozen=True)
class Condition:
    """A quantity, other than the joint's own command, that a joint error may depend on; a term may bring a new one.

    Attributes:
        words: Its name in words.
        column: Column of a file with its values; empty: no column, or one for each joint.
        dimension: Dimension of the column; None: a pure number.
    """

    words: str
    column: str = ""
    dimension: Dimension | None = None
    APPROACH: ClassVar[Condition]
    TIME: ClassVar[Condition]
    TEMPERATURE: ClassVar[Condition]
    LOAD: ClassVar[Condition]
    ANOTHER_JOINT: ClassVar[Condition]


Condition.APPROACH = Condition("the direction of approach")
Condition.TIME = Condition("time", "time", "time")
Condition.TEMPERATURE = Condition("temperature", "temperature", "temperature")
Condition.LOAD = Condition("the load", "load", "mass")
Condition.ANOTHER_JOINT = Condition("another joint")
CONTEXT: dict[str, Dimension | None] = {"time": "time", "temperature": "temperature", "load": "mass", **GRAVITY}
"""Columns with the conditions of a visit, and their dimensions."""
_STEP = 1e-4  # step of a central difference by the torque, as part of the largest torque
REFERENCE_TEMPERATURE = 20.0
"""Temperature at which lengths hold [degC]; fixed, so that a coefficient means the same for every file."""


@dataclass(frozen=True)
class Joint:
    """The joint that a term belongs to.

    Attributes:
        name: Its name.
        dimension: Whether it turns or slides.
        actuated: Names of all actuated joints, in the order of commands.
    """

    name: str
    dimension: Dimension
    actuated: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Context(ReadOnlyArrays):
    """Conditions of commands. A condition that is not known is neutral.

    Attributes:
        approach: Direction in which each joint moved last, +1, -1, or 0 where not known, (n, n_actuated).
        time: Time as counted in the file, (n,) [s]; 0 where not known.
        temperature: Temperature above 20 degC, the reference of ISO 1, (n,) [K]; 0 where not known.
        load: Mass at the tool, (n,) [kg]; 0 where not known.
        down: Direction of gravity as a sensor read it, unit vectors in its axes, (n, 3); NaN where it was not read;
            None where it never was.
        setups: Number of the setup, (n,); None: the first.
        torque: Torque or force of gravity that each driven joint holds (`calib.core.robots.mechanism`), (n, n_driven)
            [N m or N]; None where it is not known: terms that depend on it are then zero.
        others: Values of the columns that terms of other packages name, (n,) each [SI]; 0 where not known.
    """

    approach: FloatArray
    time: FloatArray
    temperature: FloatArray
    load: FloatArray
    down: FloatArray | None = None
    setups: IntArray | None = None
    torque: FloatArray | None = None
    others: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def setup_numbers(self) -> IntArray:
        """Number of the setup of each command, (n,)."""
        return np.zeros(len(self.time), dtype=np.intp) if self.setups is None else self.setups

    def column(self, name: str) -> FloatArray:
        """Return the values of a column that a term names, (n,) [SI]; 0 where not known."""
        return self.others.get(name, np.zeros(len(self.time)))

    def inputs(self, q: FloatArray) -> dict[Source, FloatArray]:
        """Return the numbers that terms may depend on, with those of the commands q (n, n_actuated)."""
        numbers = {
            Source.ONE: np.ones((len(q), 1)),
            Source.COMMAND: q,
            Source.APPROACH: self.approach,
            Source.TIME: self.time[:, None],
            Source.WARMTH: self.temperature[:, None],
        }
        return numbers if self.torque is None else numbers | {Source.TORQUE: self.torque}

    @staticmethod
    def neutral(n: int, n_actuated: int) -> Context:
        """Return a context in which no condition is known."""
        nothing, none = np.zeros(n), np.zeros((n, n_actuated))
        return Context(none, nothing, nothing, nothing)

    def select(self, which: slice | IntArray) -> Context:
        """Return the conditions of some of the commands, by a slice or indices (k,)."""
        known = {key: value[which] for key, value in vars(self).items() if isinstance(value, np.ndarray)}
        return Context(**known, others={name: values[which] for name, values in self.others.items()})

    @staticmethod
    def from_conditions(
        approach: FloatArray, conditions: Mapping[str, FloatArray], setups: IntArray | None = None
    ) -> Context:
        """Return the context of visits, with directions of approach (n, n_actuated), and setups (n,).

        `conditions` are columns `time` [s], `temperature` [degC], `load` [kg], those of
        `calib.core.robots.terms.gravity`, and those that terms name, as far as they are known, (n,).
        """
        n = len(approach)

        def known(name: str) -> FloatArray:
            return np.nan_to_num(conditions.get(name, np.zeros(n)))

        warmer = np.nan_to_num(conditions.get("temperature", np.full(n, np.nan)) - REFERENCE_TEMPERATURE)
        others = {name: known(name) for name in conditions if name not in CONTEXT}
        return Context(approach, known("time"), warmer, known("load"), read_down(conditions), setups, others=others)


class JointTerm(ABC):
    """One term of one joint's error. A class defines its columns, or a formula for them.

    Attributes of the class:
        section: Keys of its entry in a robot description.
        needs_torque: Whether it depends on `Context.torque`.
        tilts: Whether it tilts the link after its joint, instead of moving the joint.
        adds: Whether its columns times its coefficients are errors of joints; if not, it acts on those of other terms,
            and its columns are the derivative of these by its coefficients.
        cause: Its name in an error budget.
        depends_on: Conditions that its columns change with. With the direction of approach, columns change their sign.
        per: Denominator of a coefficient's unit, such as `per hour`.
        follows_command: Whether its columns change with the command of its joint, so that one that did not move does
            not show it.
        counts_turns: Whether a whole turn of the joint that it follows changes its columns.
        in_auto: Whether it is tried if a robot's terms are not named.
        differs: Whether its size differs between joints: a ratio or a belt is wrong at one of them.

    Attributes:
        joint: The joint.
        parameters: Its coefficients.
    """

    section: ClassVar[type[TermSection]] = TermSection
    needs_torque: ClassVar[bool] = False
    tilts: ClassVar[bool] = False
    adds: ClassVar[bool] = True
    cause: ClassVar[str] = "other joint terms"
    depends_on: ClassVar[tuple[Condition, ...]] = ()
    per: ClassVar[str] = ""
    follows_command: ClassVar[bool] = True
    counts_turns: ClassVar[bool] = False
    in_auto: ClassVar[bool] = True
    differs: ClassVar[bool] = False
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    @abstractmethod
    def from_section(cls, joint: Joint, section: Any, sigma: float | None) -> JointTerm:
        """Return the term of an entry of a robot description, with its sigma [m or rad] or None.

        Raises:
            ValueError: The entry does not fit the joint.
        """

    @classmethod
    def entries(cls, term: str, joints: Sequence[str], actuated: Sequence[str]) -> tuple[TermSection, ...]:
        """Return the entries that are tried if a robot's terms are not named; `joints` are those that can show it."""
        named = ["all"] if len(joints) == len(actuated) else joints
        return tuple(cls.section(joint=name, term=term) for name in named)

    @classmethod
    def needs_more(cls, dimension: Dimension) -> str:
        """Return in words what a description must state for a joint of this dimension; empty: nothing."""
        return ""

    def answers(self, section: TermSection) -> bool:
        """Whether this term already covers an entry of the same kind."""
        return section.joint in ("all", self.joint)

    def driven_joint_names(self, dimensions: Mapping[str, Dimension]) -> tuple[str, ...]:
        """Return the names of the driven joints whose errors depend on the term; `dimensions` of joints by name."""
        return tilts_of(self.joint, dimensions[self.joint]) if self.tilts else (self.joint,)

    def driving_joint(self, actuated: tuple[str, ...]) -> str:
        """Return the actuated joint whose command the term follows."""
        return self.joint

    def formula(self, j: int) -> Formula | None:
        """Return phi of the coefficients as data, to write it in other languages; None if there is no formula.

        `j` is the index of the term's joint among the actuated joints; for a term that tilts, of one of its rotations
        among the driven joints.
        """
        return None

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return phi of each coefficient, (n, n_coefficients).

        Args:
            q: Commanded actuated joints, (n, n_actuated) [m or rad].
            j: As in `formula`.
            context: Conditions of the commands, the torque among them if the term asks for it.

        Raises:
            NotImplementedError: The class gives neither columns nor a formula.
        """
        formula = self.formula(j)
        if formula is None:
            raise NotImplementedError(f"{type(self).__qualname__} gives neither columns nor a formula")
        return formula.columns(context.inputs(q))

    def torque_derivative(self, q: FloatArray, j: int, context: Context, rate: FloatArray) -> FloatArray:
        """Return the derivative of phi along a change `rate` of the torque (n, n_driven), (n, n_coefficients).

        It follows from the formula, or without one from a central difference; other arguments as in `columns`.
        """
        formula, largest = self.formula(j), float(np.max(np.abs(rate), initial=0.0))
        if isinstance(formula, Proportional) and formula.knee:
            return formula.slope(context.inputs(q)) * rate[:, formula.place, None]
        if formula is not None:
            return self.columns(q, j, replace(context, torque=rate))  # phi is linear in the torque
        assert context.torque is not None  # the term needs the torque
        step = _STEP * (float(np.max(np.abs(context.torque))) or 1.0) / (largest or 1.0)
        ends = [self.columns(q, j, replace(context, torque=context.torque + s * rate)) for s in (step, -step)]
        return np.asarray((ends[0] - ends[1]) / (2 * step))

    def reads(self) -> tuple[str, ...]:
        """Return the names of further columns of pure numbers that this term depends on; see `Context.column`."""
        return ()

    @classmethod
    def follows_joint_alone(cls) -> bool:
        """Whether commands of joints alone decide its columns: no condition, and no column that `reads` names."""
        return not cls.depends_on and cls.reads is JointTerm.reads

    def states_by_order(self, q: FloatArray) -> Mapping[str, FloatArray]:
        """Return values for columns of `reads`, (n,) by name, that a file need not state.

        They follow from the order of the commands q of its joint, (n,) [m or rad].
        """
        return {}

    def curvature(self, values: FloatArray) -> float:
        """Return a bound of |d^2(dq)/dq^2| [1/rad or 1/m], from the coefficients (n_coefficients,); 0 if straight."""
        return 0.0


def tilts_of(joint: str, dimension: Dimension) -> tuple[str, ...]:
    """Return the names of the rotations that tilt the link behind a joint: two if it turns, else three."""
    return tuple(f"{joint}:tilt_{k}" for k in range(2 if dimension == "angle" else 3))


UNIT: dict[Dimension, str] = {"angle": "mrad", "length": "mm"}
"""Units of coefficients in tables."""


def coefficient(name: str, dimension: Dimension, sigma: float, family: str = "") -> Parameter:
    """Return the parameter of a coefficient, nominally zero, of expected size sigma [m or rad].

    `family` names coefficients whose common size is found from the data; empty: sigma is used.
    """
    return Parameter(name, dimension, 0.0, sigma, UNIT[dimension], family=family)

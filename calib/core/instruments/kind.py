"""Base class of a kind of measurement.

An instrument looks from one frame a at another frame b (`FrameInstrument`); a reading is a few numbers about T_ab, b
seen from a. Or it reads the value of a joint (`JointInstrument`). A kind defines all that the engine needs: its frames
or its joint, its columns in a file, its unknown numbers, its prediction, the difference of a prediction and a reading,
and the derivatives of that difference by T_ab or the joint, and by its unknowns. Kinematics, loops and parameters enter
by the chain rule, which is written once (`calib.core.rows.observed`), so that a new kind is one small file, here with a
line in `calib.core.instruments.kinds`, or in another package with an entry point.

Derivatives are by the twist [dp; dw] of b seen from a, in the axes of a:

    p_ab + dp,        exp([dw]) R_ab
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import DataError, nearest
from calib.core.base.parameter import Parameter
from calib.core.base.sections import Component, PlaceSection, PosedSection, Section
from calib.core.base.units import Dimension
from calib.core.instruments.noise import Noise


@dataclass(frozen=True)
class Part:
    """Rows of a reading that belong together: one vector, one unit, one noise.

    Attributes:
        name: Such as `position`.
        axes: Names of its rows.
        dimension: Dimension of its rows.
        usual: The largest noise of such instruments [SI]: more comes from the model.
        largest: Noise beyond which the numbers mean something else, for every robot [SI].
        is_position: Whether its rows are the coordinates of the target: they then state the accuracy of a robot, and
            the noise of positions is theirs.
        is_distance: Whether its row is the distance of its two frames, which pictures show as a wire.
        plural: Name of its readings in a sentence; the name with an s if not given.
    """

    name: str
    axes: tuple[str, ...]
    dimension: Dimension
    usual: float = float("inf")
    largest: float = float("inf")
    is_position: bool = False
    is_distance: bool = False
    plural: str = ""

    @property
    def readings(self) -> str:
        """Name of the readings in a sentence."""
        return self.plural or f"{self.name}s"


@dataclass(frozen=True)
class Column:
    """A column of a measurement file: its name and dimension (None: a pure number)."""

    name: str
    dimension: Dimension | None


@dataclass(frozen=True)
class Place:
    """A frame fixed to a link, from which or at which an instrument looks.

    Attributes:
        name: Its name, also of its origin.
        link: Link or joint frame that carries it.
        xyz, rpy: Pose of the place in that link, or with `inverted` of that link in the place [m], [rad].
        unknown: Components that the measurements must find.
        sigma, sigma_angle: Expected errors of these [m], [rad]; None: the numbers are only a start.
        inverted: Whether `xyz`, `rpy` are the pose of the link in the place.
    """

    name: str
    link: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unknown: tuple[Component, ...] = ()
    sigma: float | None = None
    sigma_angle: float | None = None
    inverted: bool = False


def placed(name: str, section: PlaceSection | PosedSection, unknown: tuple[Component, ...] | None = None) -> Place:
    """Return a place of this name as the description states it; `unknown` replaces the components that it calls so."""
    found = section.unknown if unknown is None else unknown
    return Place(name, section.frame, section.xyz, section.rpy, found, section.sigma, section.sigma_angle)


@dataclass(frozen=True, eq=False)
class View:
    """Poses of frame b seen from frame a, for n readings.

    Attributes:
        rotation: R_ab, (n, 3, 3).
        translation: p_ab, (n, 3) [m].
    """

    rotation: FloatArray
    translation: FloatArray

    def after_step(self, component: int, step: float) -> View:
        """Return the views after a step [m or rad] of one component of the twist [dp; dw], 0 to 5."""
        change = step * np.eye(3)[component % 3]
        if component < 3:
            return View(self.rotation, self.translation + change)
        turned = scipy.spatial.transform.Rotation.from_rotvec(change).as_matrix() @ self.rotation
        return View(turned, self.translation)


@dataclass(frozen=True, eq=False)
class Readings(ReadOnlyArrays):
    """Readings of one instrument. Nothing is averaged.

    Attributes:
        visits: Visit of the robot for each reading, (n,).
        pairs: Number of the pair of frames of each reading, (n,).
        values: The numbers, (n, n_values); NaN where a component was not read.
        covariance: Noise that the file states, (n, n_rows, n_rows) [SI]; None where it does not.
        details: Further numbers of each reading that a kind needs, (n, n_details).
        labels: File, line and pose name of each reading, if readings are in another file than the joint values; None:
            the labels of their visits.
    """

    visits: IntArray
    pairs: IntArray
    values: FloatArray
    covariance: FloatArray | None
    details: FloatArray
    labels: tuple[str, ...] | None = None

    def __len__(self) -> int:
        return len(self.visits)

    def subset(self, index: IntArray | slice, visits: IntArray | None = None) -> Readings:
        """Return the readings with these indices (n,), in this order, with new visits (n,) if given."""
        return Readings(
            self.visits[index] if visits is None else visits,
            self.pairs[index],
            self.values[index],
            None if self.covariance is None else self.covariance[index],
            self.details[index],
            None if self.labels is None else tuple(np.array(self.labels, dtype=object)[index].tolist()),
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """Predicted minus read, of an instrument that looks at frames.

    Attributes:
        residuals: (n, n_rows) [SI]; NaN where a component was not read.
        by_twist: Derivative by the twist of the module docstring, (n, n_rows, 6).
        by_unknown: Derivative by the instrument's unknown numbers, (n, n_rows, n_unknowns).
    """

    residuals: FloatArray
    by_twist: FloatArray
    by_unknown: FloatArray


@dataclass(frozen=True, eq=False)
class JointComparison:
    """Predicted minus read, of an instrument that reads a joint.

    Attributes:
        residuals: (n, n_rows) [SI]; NaN where a component was not read.
        by_joint: Derivative by the joint's value, (n, n_rows).
        by_unknown: Derivative by the instrument's unknown numbers, (n, n_rows, n_unknowns).
    """

    residuals: FloatArray
    by_joint: FloatArray
    by_unknown: FloatArray


@dataclass(frozen=True, eq=False)
class Scene:
    """Data for a first guess at unknown places, before anything is fitted.

    Attributes:
        readings: Readings of the instrument, n of them.
        links: Pose of the link of frame b in the link of frame a for each reading, by the present robot, (n, 4, 4).
        pairs: Names of the places (a, b) of each pair.
        places: Present pose of each of these places in its link, (4, 4) [m].
        unknown: Components of each place that the measurements must find.
        unknowns: Present unknown numbers of the instrument, (n_unknowns,).
    """

    readings: Readings
    links: FloatArray
    pairs: tuple[tuple[str, str], ...]
    places: Mapping[str, FloatArray]
    unknown: Mapping[str, tuple[Component, ...]]
    unknowns: FloatArray


@dataclass(frozen=True, eq=False)
class Guess:
    """First values of unknown places and numbers.

    Attributes:
        places: Poses of places in their links, (4, 4) [m]; only unknown components are used.
        unknowns: Unknown numbers of the instrument, (n_unknowns,); None: unchanged.
    """

    places: Mapping[str, FloatArray]
    unknowns: FloatArray | None = None


class InstrumentSection(Section):
    """The entry of an instrument, of some `kind`, in a robot description."""

    kind: str


@dataclass(frozen=True)
class Instrument(ABC):
    """A kind of measurement, as one instrument of a robot description: the properties of all kinds.

    Attributes:
        section: Keys of its entry in a robot description (class attribute).
        label_column: Text column whose cells name the instrument of a row. Instruments with the same label column may
            share columns of numbers; a file may leave it out where they do not. None: there is none (class attribute).
        touches: Whether a reading has no numbers, because contact is all that it states (class attribute).
        may_see_nothing: Whether it reads nothing at some poses, such as those at which a camera does not see the board;
            then predictions are NaN (class attribute).
        lacks: Beginning of the message on a text that names nothing (class attribute).
        name: Its name in the description, and the beginning of its columns.
        noise: Its stated noise.
        unknowns: Its own unknown numbers.
    """

    section: ClassVar[type[InstrumentSection]]
    label_column: ClassVar[str | None] = None
    touches: ClassVar[bool] = False
    may_see_nothing: ClassVar[bool] = False
    lacks: ClassVar[str] = "has no place"
    name: str
    noise: Noise = field(kw_only=True)
    unknowns: tuple[Parameter, ...] = field(default=(), kw_only=True)

    @classmethod
    @abstractmethod
    def from_section(cls, name: str, section: Any) -> Instrument:
        """Return the instrument of an entry of a robot description.

        Args:
            section: The entry.

        Raises:
            ValueError: The entry is not valid.
        """

    @property
    @abstractmethod
    def parts(self) -> tuple[Part, ...]:
        """Parts of its rows; most kinds have them as a class attribute."""

    @property
    def group(self) -> str:
        """Group that shares the scale of its noise; its own name unless a kind overrides this."""
        return self.name

    @cached_property
    def n_rows(self) -> int:
        """Rows of one reading."""
        return sum(len(part.axes) for part in self.parts)

    @cached_property
    def part_of_row(self) -> tuple[int, ...]:
        """Index of the part of each row."""
        return tuple(k for k, part in enumerate(self.parts) for _ in part.axes)

    @property
    def reads_positions(self) -> bool:
        """True if positions along three axes are all that it reads."""
        return len(self.parts) == 1 and self.parts[0].is_position and len(self.columns()) == 3

    def places(self) -> tuple[Place, ...]:
        """Return its own places, other than the measurement frame and the targets."""
        return ()

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return the names of the frames (a, b) of its readings; `base` is the measurement frame, the default of a."""
        return ()

    def columns(self) -> tuple[Column, ...]:
        """Return its columns in a measurement file: by default `<name>_<axis>` for each of its rows."""
        return tuple(Column(f"{self.name}_{axis}", part.dimension) for part in self.parts for axis in part.axes)

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the things that rows may be about, in the order of the detail; empty where there is one thing."""
        return ()

    def text_columns(self) -> tuple[str, ...]:
        """Return its text columns, which name the observed things."""
        return ()

    def parse_texts(
        self, texts: Mapping[str, Sequence[str]], where: Sequence[str]
    ) -> tuple[Sequence[bool], IntArray, FloatArray]:
        """Return from the text columns which rows are readings of this instrument, their pairs and their details.

        By default a cell is one of `named`, whose number is the detail; an empty one without numbers is no reading.

        Args:
            texts: Text columns by name, n cells each.
            where: Name of each row in messages.

        Returns:
            (n,) whether a row is a reading; pairs (n,); details (n, n_details).

        Raises:
            DataError: A text is not valid.
        """
        which, number = np.zeros(len(where), dtype=np.intp), {name: k for k, name in enumerate(self.named)}
        for column in self.text_columns():
            for k, text in enumerate(texts[column]):
                if text not in number and (text or self.columns()):
                    raise DataError(
                        f"{where[k]}, column '{column}': '{self.name}' {self.lacks} '{text:.60}'"
                        f"{nearest(text, self.named)}"
                    )
                which[k] = number.get(text, -1)
        return (which >= 0).tolist(), self.pair_of(np.maximum(which, 0)), self._details(which)

    def pair_of(self, which: IntArray) -> IntArray:
        """Return the pairs of frames of things that rows are about, (n,): by default all have the same."""
        return np.zeros_like(which)

    def texts(self, pairs: IntArray, details: FloatArray) -> dict[str, list[str]]:
        """Return the text columns by name from pairs (n,) and details (n, n_details), the inverse of `parse_texts`."""
        names = self.named
        return {column: [names[int(which)] for which in details[:, 0]] for column in self.text_columns()}

    def looks(self) -> tuple[IntArray, FloatArray]:
        """Return all that it can read at one visit: pairs (n,) and details (n, n_details)."""
        which = np.arange(max(len(self.named), 1))
        return self.pair_of(which), self._details(which)

    def _details(self, which: IntArray) -> FloatArray:
        return which[:, None].astype(float)[:, : len(self.text_columns())]

    def values(self, columns: Mapping[str, FloatArray]) -> FloatArray:
        """Turn columns (n,) [SI] by name into values (n, n_values): by default the columns themselves."""
        return np.stack([columns[column.name] for column in self.columns()], axis=1)

    def cells(self, values: FloatArray) -> dict[str, FloatArray]:
        """Turn values (n, n_values) into columns (n,) [SI] by name, the inverse of `values`."""
        return {column.name: values[:, k] for k, column in enumerate(self.columns())}

    @abstractmethod
    def predict(self, seen: Any, unknowns: FloatArray, details: FloatArray) -> FloatArray:
        """Return its predicted readings, (n, n_values).

        Args:
            seen: Its input: the frames, a `View`; or values of its joint, (n,) [m or rad].
            unknowns: Its unknown numbers, (n_unknowns,).
            details: Details of `Readings`, (n, n_details).
        """

    @abstractmethod
    def compare(self, seen: Any, unknowns: FloatArray, readings: Readings) -> Comparison | JointComparison:
        """Compare predictions with readings, (n, n_rows): see `Comparison` and `JointComparison`."""

    def with_errors(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return values (n, n_values) changed by small errors of their rows (n, n_rows) [SI], as noise does."""
        return values + change

    def covariance(self, values: FloatArray, noise: Noise) -> FloatArray:
        """Return the covariance of readings with values (n, n_values) and this noise, (n, n_rows, n_rows) [SI^2]."""
        return noise.covariance(self.points(values), len(values), [len(part.axes) for part in self.parts])

    def points(self, values: FloatArray) -> FloatArray | None:
        """Return the target's position from values (n, n_values), seen from a, (n, 3) [m]; None if not read."""
        return None

    def doubts(self, readings: Readings) -> tuple[str, ...]:
        """Return doubts about the readings by themselves, in words; empty if there are none."""
        return ()

    def other_meanings(self, values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield other meanings of values (n, n_values), in words, and the values then."""
        yield from ()

    def orientations(self, values: FloatArray) -> FloatArray | None:
        """Return the target's orientation R_ab from values (n, n_values), (n, 3, 3); None for kinds without it."""
        return None


@dataclass(frozen=True)
class FrameInstrument(Instrument, ABC):
    """A kind that looks from one frame at another, its `target`."""

    target: str

    def pairs(self, base: str) -> tuple[tuple[str, str], ...]:
        """Return the measurement frame and the target."""
        return ((base, self.target),)

    def point_seen(self, view: View, details: FloatArray) -> FloatArray:
        """Return the observed point, seen from a, (n, 3) [m], for details (n, n_details): by default the target."""
        return view.translation

    def sights(self, count: int, generator: np.random.Generator) -> View | None:
        """Return views in which it reads something, drawn at random, for `sample` to bring poses there.

        None where it reads something in most views, or has no such views; then poses are tried at random.

        Args:
            count: Number of views.
            generator: Generator of random numbers.

        Returns:
            Views of frame b seen from frame a; a rotation of NaN: any.
        """
        return None

    def first_values(self, scene: Scene) -> tuple[Guess, ...]:
        """Return first guesses at unknown places and numbers, of which the best is kept; empty if there are none.

        Measurement frame and targets that points show are placed before (`calib.core.rows.registration`).
        """
        return ()


@dataclass(frozen=True)
class JointInstrument(Instrument, ABC):
    """A kind that reads the value of a `joint`."""

    joint: str

    def first_unknowns(self, joint: FloatArray, unknowns: FloatArray, readings: Readings) -> FloatArray:
        """Return a first guess at its unknown numbers, (n_unknowns,), from the present robot's joint values."""
        return unknowns

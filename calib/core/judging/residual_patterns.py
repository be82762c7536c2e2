"""Systematic residuals: patterns that noise does not make.

Question. Would the model explain the data significantly better with one more effect? For an effect with columns Z (what
it would add to the measured rows) the linear model r = J du + Z c is compared with the fit:

    M = I - J A^-1 J^T,   A = J^T J + sigma^2 P        what of Z the fit has not absorbed already
    gain = r^T Z (Z^T M Z)^-1 Z^T r                    by how much |r|^2 would fall
    F = (gain / k) / ((|r|^2 - gain) / (nu - k))       against F(k, nu - k), k columns left after M

The effects are those of `calib.core.judging.effects`. One that the fit absorbs (a constant shift, where the base is
free) cannot be seen and is not tested: `visible` says how large it would have to be. Effects come in families of kinds,
which share the chance of a false finding evenly; in a family, the chance of each finding is multiplied by the number of
its tests. A finding needs a chance below 1 % over all families, and an effect of at least a tenth of the noise: enough
data make any trifle significant. Where poses scatter by more than independent readings would
(`calib.core.numerics.clusters`), F is divided by how much more the score of the effect scatters, summed pose by pose,
and nu is that of this scatter. A fit follows each pose a little, so that its residuals scatter too little: a finding
counts only if it is one with the residuals of each pose by the fit, and the effect, of all other poses. Of waves and of
slips, which are tried by the dozen for each joint or target, the best is kept.

The direction of approach and, without a time, the course of the measurement come from the order of the rows in the data
file, which must be the order of measurement.

Waves. A test needs Z^T Z, (J T)^T Z with the span J T of the fit, and Z^T r only. The waves of a joint have columns
h_i sin(k q_i), h_i cos(k q_i) that differ by a factor of each visit, so the sums over the rows of a visit are made once
and serve all orders; the powers exp(i k q) follow from one another. Time grows with the rows, and no order has columns
of its own.

When it fails. Effects in other shapes stay in the noise; two effects that look alike at the poses measured are both
named. F supposes normal noise.

Reference: cook1982, chapter 2.4 (added variables), and 3 (residuals without the pose that is judged).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.units import DISPLAY_UNIT, Dimension, millimetres, quantity_text
from calib.core.base.words import joints_named
from calib.core.judging.effect_kinds import Family, Kind, Trait
from calib.core.judging.effects import ORDERS, Effect, EffectSetting, JointWaves, effects
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT, FALSE_ALARM
from calib.core.numerics.clusters import LeftOut
from calib.core.numerics.tall import Span, in_parts
from calib.core.rows.rows import Rows

SMALLEST_EFFECT = 0.1
"""Least root mean square of an effect, over that of the noise, that is worth a finding."""
PARTS_PER_MILLION = 1e6
_ABSORBED = 1e-6  # part of an effect's square that must be left after the fit for it to be seen
_COLUMNS_AT_ONCE = 128  # of effects that are tested together
_ROWS_AT_ONCE = 1 << 12  # of these
_NUMBERS_AT_ONCE = 1 << 24  # of what findings explain
_VISITS_AT_ONCE = 512  # their powers stay in the processor's cache
_ALIKE = 9.2  # of the noise squared: chance makes a sine and cosine explain more in 1 % of cases
_SURELY = 5.0  # standard deviations of an effect from which it is found nine times of ten, among so many


@dataclass(frozen=True)
class Pattern:
    """One effect that was tested.

    Attributes:
        kind: Which effect.
        name: The axis, joint or target; `xyz` for what all axes do.
        p_value: Chance of such a pattern from noise, over all tests.
        size: Root mean square of what it explains [m]; of readings in another unit where no positions are [SI].
        amount: The shift or slip [m], half the backlash or the height of a wave [m or rad], the part by which lengths
            are off, the error for a unit of the neighbour; NaN for a curve.
        significant: Whether it counts as a finding.
        dimension: What `size` measures.
        detail: Cycles of a wave, the first visit of a slip, in words; the other joint of a coupling, or before a link.
    """

    kind: Kind
    name: str
    p_value: float
    size: float
    amount: float
    significant: bool
    dimension: Dimension = "length"
    detail: str = ""


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A finished fit as a linear model.

    Attributes:
        rows: Its whitened rows, with the weights of a robust loss.
        span: J T, which it has absorbed, (n_rows, rank), with T of `calib.core.numerics.observability`.
        freedom: Degrees of freedom.
        factor: Found over assumed noise.
        pose_freedom: Degrees of freedom of the scatter of poses, where they scatter by more than independent readings
            would; infinite where they do not.
    """

    rows: Rows
    span: Span
    freedom: float
    factor: float
    pose_freedom: float = np.inf

    def after_fit(self, effect: FloatArray) -> FloatArray:
        """Return M Z, what a fit leaves of effects Z (n_rows, n_effects) on the residuals, (n_rows, n_effects)."""
        return effect - self.span.times(self.span.pulled(effect))

    def beside(self, effects: FloatArray) -> LinearFit:
        """Return the fit as it would be if effects Z (n_rows, k) were parameters too, as far as they can be seen."""
        size = np.linalg.norm(effects, axis=0)
        columns = effects[:, size > 0] / size[size > 0]
        left = self.after_fit(columns)
        values, vectors = linalg.eigh(columns.T @ left)
        seen = values > _ABSORBED
        root = vectors[:, seen] / np.sqrt(values[seen])
        absorbed, fewer = left @ root, int(np.sum(seen))
        residuals = self.rows.residuals - absorbed @ (root.T @ (columns.T @ self.rows.residuals))
        return replace(
            self,
            rows=replace(self.rows, residuals=residuals),
            span=self.span.beside(absorbed),
            freedom=self.freedom - fewer,
            pose_freedom=self.pose_freedom - fewer,
        )

    def sizes(self, effects: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sizes (k,) of effects Z (n_rows, k) if all of them were parameters, and their standard deviations.

        Infinite deviations are of effects that were not made. What the fit absorbs is hardly known.
        """
        size = np.linalg.norm(effects, axis=0)
        made = np.flatnonzero(size > 0)
        columns = effects[:, made] / size[made]
        left = self.after_fit(columns)
        inverse = np.linalg.inv(columns.T @ left + _ABSORBED * np.eye(len(made)))
        found = -inverse @ (columns.T @ self.rows.residuals)
        scatter = np.sqrt(np.sum((self.rows.residuals + left @ found) ** 2) / max(self.freedom - len(made), 1.0))
        sizes, deviations = np.zeros(len(size)), np.full(len(size), np.inf)
        sizes[made], deviations[made] = found / size[made], scatter * np.sqrt(np.diag(inverse)) / size[made]
        return sizes, deviations

    @cached_property
    def without_poses(self) -> LeftOut:
        """The fit with poses left out in turn."""
        return LeftOut(self.span, self.rows.layout.pose_of_row)

    @cached_property
    def square(self) -> float:
        """Their sum of squares."""
        return float(np.sum(self.rows.residuals**2))


@dataclass(frozen=True, eq=False)
class _Moments:
    """What a test needs to know of an effect with columns Z: Z^T Z, (J T)^T Z and Z^T r."""

    kind: Kind
    name: str
    detail: str
    squares: FloatArray
    absorbed: FloatArray
    score: FloatArray
    order: int = 0
    """Cycles of a wave."""


@dataclass(frozen=True)
class _Tested:
    """What the test of one effect gave.

    Attributes:
        effect: The effect.
        p_value: Chance of such a gain if readings are independent.
        ratio: F of the module docstring.
        freedom: k and nu - k.
        gain: By how much |r|^2 would fall.
        coefficients: c, (n_columns,).
    """

    effect: _Moments
    p_value: float
    ratio: float
    freedom: tuple[int, float]
    gain: float
    coefficients: FloatArray


def patterns(residuals: LinearFit, setting: EffectSetting, kinds: Container[Kind] = tuple(Kind)) -> tuple[Pattern, ...]:
    """Test effects.

    Args:
        residuals: The fit.
        setting: What effects are made of.
        kinds: Which of them are tested.
    """
    if residuals.factor * setting.metre < EXACT:
        return ()
    tested = (effect for effect in effects(setting) if effect.kind in kinds)
    tests = _tests(residuals, list(_moments(residuals, tested)))
    kept: dict[tuple[str, str, str], tuple[_Tested, int]] = {}
    for family in Family:
        members = [test for test in tests if test.effect.kind.family is family]
        times = len(Family) * len(members)
        kept |= {(test.effect.kind, test.effect.name, test.effect.detail): (test, times) for test in _best(members)}
    noise = setting.size(np.full(len(residuals.rows.residuals), residuals.factor))
    result = []
    for effect, explained in _explained(residuals, _kept_effects(setting, kept), kept):
        test, times = kept[effect.kind, effect.name, effect.detail]
        p = min(1.0, _chance(residuals, test, effect, explained, FALSE_ALARM / times) * times)
        size = setting.size(explained)
        significant = p < FALSE_ALARM and size > SMALLEST_EFFECT * noise
        amount = (
            float(np.linalg.norm(test.coefficients))
            if Trait.BY_THE_DOZEN in effect.kind.traits
            else _only(test.coefficients)
        )
        detail = _cycles(test, tests, _ALIKE * residuals.factor**2)
        result.append(Pattern(effect.kind, effect.name, p, size, amount, bool(significant), setting.dimension, detail))
    return tuple(sorted(result, key=lambda pattern: (pattern.p_value, -pattern.size)))


def _explained(
    residuals: LinearFit, some: Iterator[Effect], kept: Mapping[tuple[str, str, str], tuple[_Tested, int]]
) -> Iterator[tuple[Effect, FloatArray]]:
    """Yield effects with M Z c, (n_rows,), which takes less time for several of them than `after_fit`."""
    at_once = max(_NUMBERS_AT_ONCE // len(residuals.span), 1)
    while together := list(islice(some, at_once)):
        tests = [kept[effect.kind, effect.name, effect.detail][0] for effect in together]
        absorbed = residuals.span.times(np.stack([test.effect.absorbed @ test.coefficients for test in tests], axis=1))
        for k, (effect, test) in enumerate(zip(together, tests, strict=True)):
            yield effect, effect.times(test.coefficients) - absorbed[:, k]


def _kept_effects(setting: EffectSetting, kept: Container[tuple[str, str, str]]) -> Iterator[Effect]:
    """Yield the effects with these kinds, names and details."""
    for effect in effects(setting):
        if isinstance(effect, JointWaves):
            orders = (order for order in effect.orders if (Kind.WAVE, effect.name, effect.detail(order)) in kept)
            yield from map(effect.effect, orders)
        elif (effect.kind, effect.name, effect.detail) in kept:
            yield effect


def _best(tests: list[_Tested]) -> list[_Tested]:
    """Of the kinds that are tried by the dozen, keep the most significant of each name; of the others, all."""
    kept: dict[tuple[str, str, int], _Tested] = {}
    for number, test in enumerate(tests):
        key = (test.effect.kind, test.effect.name, 0 if Trait.BY_THE_DOZEN in test.effect.kind.traits else number)
        if key not in kept or (test.p_value, -test.gain) < (kept[key].p_value, -kept[key].gain):
            kept[key] = test
    return list(kept.values())


def _cycles(best: _Tested, tests: Iterable[_Tested], margin: float) -> str:
    """Return the detail of an effect; of a wave with all numbers of cycles that explain the residuals as well.

    Args:
        best: The effect.
        tests: All tests.
        margin: How much less of |r|^2 a wave may explain that noise could have made the better one.
    """
    effect = best.effect
    if effect.kind is not Kind.WAVE:
        return effect.detail
    others = (test for test in tests if (test.effect.kind, test.effect.name) == (effect.kind, effect.name))
    orders = sorted(test.effect.order for test in others if test.gain > best.gain - margin)
    if len(orders) < 2:
        return effect.detail
    unit = effect.detail.partition(" ")[2]
    if orders[-1] - orders[0] == len(orders) - 1:
        return f"{orders[0]} to {orders[-1]} {unit}"
    return f"a number of {unit} that these poses do not determine"


def _only(coefficients: FloatArray) -> float:
    return float(coefficients[0]) if len(coefficients) == 1 else float("nan")


def visible(residuals: LinearFit, column: FloatArray) -> float:
    """Return how large an effect of one column (n_rows, 1) must be for the residuals to show it; inf if they never do.

    Args:
        residuals: The fit.
        column: What an effect of 1 does to the whitened rows.
    """
    size = float(np.linalg.norm(column))
    if size == 0.0:
        return float("inf")
    unit = column / size
    left = float(np.sum(unit * residuals.after_fit(unit)))
    return _SURELY * residuals.factor / (size * float(np.sqrt(left))) if left > _ABSORBED else float("inf")


def _moments(residuals: LinearFit, some: Iterable[Effect | JointWaves]) -> Iterator[_Moments]:
    """Yield the moments of effects, those of several at once, and of all waves of joints."""
    together, width = list[Effect](), 0
    for effect in some:
        if isinstance(effect, JointWaves):
            yield from _moments_of_waves(residuals, effect)
            continue
        if together and width + effect.width > _COLUMNS_AT_ONCE:
            yield from _moments_at_once(residuals, together)
            together, width = [], 0
        together.append(effect)
        width += effect.width
    if together:
        yield from _moments_at_once(residuals, together)


def _moments_at_once(residuals: LinearFit, some: list[Effect]) -> Iterator[_Moments]:
    """Yield the moments of effects, whose columns are there for some rows at a time."""
    squares = [np.zeros((effect.width, effect.width)) for effect in some]
    others = _beside(residuals)
    products = np.zeros((sum(other.shape[1] for other in others), sum(effect.width for effect in some)))
    for part in in_parts(len(residuals.span), _ROWS_AT_ONCE):
        columns = [effect.rows(part) for effect in some]
        for square, z in zip(squares, columns, strict=True):
            square += z.T @ z
        together = np.hstack(columns)
        products += np.concatenate([other[part].T @ together for other in others])
    absorbed, score = _resolved(residuals, products)
    first = 0
    for effect, square in zip(some, squares, strict=True):
        own = slice(first, first + effect.width)
        yield _Moments(effect.kind, effect.name, effect.detail, square, absorbed[:, own], score[own])
        first = own.stop


def _beside(residuals: LinearFit) -> list[FloatArray]:
    """J, r and what stands beside J T, (n_rows, ...) each: what effects are multiplied with."""
    span = residuals.span
    return [span.jacobian, residuals.rows.residuals[:, None], *([] if span.more is None else [span.more])]


def _resolved(residuals: LinearFit, products: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (J T)^T Z and r^T Z from products of `_beside` with columns Z, (n, k)."""
    root = residuals.span.root
    n = len(root)
    return np.vstack([root.T @ products[:n], products[n + 1 :]]), products[n]


def _moments_of_waves(residuals: LinearFit, waves: JointWaves) -> Iterator[_Moments]:
    """Yield the moments of all waves of a joint; see the module docstring."""
    if not waves.orders:
        return
    others, n_orders = _beside(residuals), len(ORDERS)
    squares, products = np.zeros((3, n_orders)), np.zeros((sum(other.shape[1] for other in others), 2 * n_orders))
    for rows, firsts, visits in _visits_together(waves.visit):
        column = waves.column[rows]
        sums = _sums_of_visits(column, [other[rows] for other in others], firsts)
        weights = np.add.reduceat(column**2, firsts)
        powers = _powers(np.exp(1j * waves.phase[visits]), n_orders)
        cosine, sine = powers.real, powers.imag
        squares += [weights @ product for product in (cosine * cosine, cosine * sine, sine * sine)]
        products += sums.T @ powers.view(float)
    absorbed, score = _resolved(residuals, products)
    for order in waves.orders:
        k = order - ORDERS.start
        normal = squares[[[0, 1], [1, 2]], k]
        own = slice(2 * k, 2 * k + 2)
        yield _Moments(Kind.WAVE, waves.name, waves.detail(order), normal, absorbed[:, own], score[own], order)


def _visits_together(visit: IntArray) -> Iterator[tuple[IntArray | slice, IntArray, IntArray]]:
    """Yield rows of some visits, those of a visit together; where each of these begins among them, and the visits."""
    order: IntArray | None = None if np.all(visit[1:] >= visit[:-1]) else np.argsort(visit, kind="stable")
    arranged = visit if order is None else visit[order]
    firsts = np.flatnonzero(np.append(True, arranged[1:] != arranged[:-1]))
    for k in range(0, len(firsts), _VISITS_AT_ONCE):
        some = firsts[k : k + _VISITS_AT_ONCE]
        last = firsts[k + _VISITS_AT_ONCE] if k + _VISITS_AT_ONCE < len(firsts) else len(visit)
        rows = slice(int(some[0]), int(last))
        yield rows if order is None else order[rows], some - some[0], arranged[some]


def _sums_of_visits(column: FloatArray, others: list[FloatArray], firsts: IntArray) -> FloatArray:
    """Return the products of a column (n,) and others (n, k) each, summed over the rows of each visit, (n_visits, k).

    Args:
        column: Of rows of visits, one visit after the other.
        others: Of these rows.
        firsts: First row of each visit, (n_visits,).
    """
    n_visits, length = len(firsts), len(column) // len(firsts)
    if n_visits * length == len(column) and np.array_equal(firsts, length * np.arange(n_visits)):
        each = column.reshape(n_visits, 1, length)  # without the products themselves: a tenth of the time
        return np.hstack([np.matmul(each, other.reshape(n_visits, length, -1))[:, 0] for other in others])
    return np.add.reduceat(np.hstack([column[:, None] * other for other in others]), firsts)


def _powers(turned: FloatArray, count: int) -> NDArray[np.complex128]:
    """Return z, z^2, ... of complex numbers z (n,), (n, count)."""
    powers = np.empty((len(turned), count), dtype=complex)
    powers[:, 0], known = turned, 1
    while known < count:
        more = min(known, count - known)
        np.multiply(powers[:, :more], powers[:, known - 1 : known], out=powers[:, known : known + more])
        known += more
    return powers


def _tests(residuals: LinearFit, effects: list[_Moments]) -> list[_Tested]:
    """Test those effects that can be seen; all with equally many columns at once, for there are hundreds."""
    widths = np.array([len(effect.score) for effect in effects], dtype=np.intp)
    tests: dict[int, _Tested] = {}
    for width in np.unique(widths):
        numbers = np.flatnonzero(widths == width).tolist()
        which, tested = _tests_at_once(residuals, [effects[k] for k in numbers])
        tests |= zip((numbers[k] for k in which), tested, strict=True)
    return [tests[k] for k in sorted(tests)]


def _tests_at_once(residuals: LinearFit, effects: list[_Moments]) -> tuple[list[int], list[_Tested]]:
    """Test effects with equally many columns.

    Returns:
        Which of them are tested, and their tests. The others do nothing that the fit does not absorb, or leave no
        degree of freedom to compare the gain with.
    """
    squares = np.array([effect.squares for effect in effects])
    size = np.sqrt(np.diagonal(squares, axis1=1, axis2=2))
    shown = np.all(size > 0, axis=1)
    size = np.where(shown[:, None], size, 1.0)
    absorbed = np.array([effect.absorbed for effect in effects]) / size[:, None, :]
    left = squares / (size[:, :, None] * size[:, None, :]) - np.matmul(absorbed.transpose(0, 2, 1), absorbed)
    values, vectors = linalg.eigh(left)
    determined = values > _ABSORBED
    score = np.array([effect.score for effect in effects]) / size
    score = np.where(determined, np.matmul(score[:, None, :], vectors)[:, 0], 0.0)
    along = score / np.where(determined, values, 1.0)
    gains, k = np.sum(score * along, axis=1), np.sum(determined, axis=1)
    coefficients = np.matmul(vectors, along[:, :, None])[:, :, 0] / size
    beside = residuals.freedom - k
    which = np.flatnonzero(shown & (k > 0) & (beside >= 1))
    k, beside, gains = k[which], beside[which], gains[which]
    rest = np.maximum(residuals.square - gains, 1e-12 * residuals.square) / beside
    ratios = np.maximum(gains / k / rest, 0.0)
    chances = scipy.special.fdtrc(k, beside, ratios)
    numbers = (column.tolist() for column in (which, chances, ratios, k, beside, gains))
    return which.tolist(), [
        _Tested(effects[number], chance, ratio, (count, freedom), gain, coefficients[number])
        for number, chance, ratio, count, freedom, gain in zip(*numbers, strict=True)
    ]


def _chance(residuals: LinearFit, tested: _Tested, effect: Effect, explained: FloatArray, limit: float) -> float:
    """Chance of a gain as large from noise; where poses scatter together, F is divided by how much more its score does.

    Args:
        residuals: The fit.
        tested: The effect.
        effect: What was tested, with its columns.
        explained: M Z c, (n_rows,).
        limit: Chance below which it is a finding.
    """
    if not np.isfinite(residuals.pose_freedom):
        return tested.p_value
    basis = linalg.orth(effect.columns - residuals.span.times(tested.effect.absorbed), rcond=np.sqrt(_ABSORBED))
    k, pose = tested.freedom[0], residuals.rows.layout.pose_of_row
    left_over = max(residuals.pose_freedom - k, 1.0)

    def chance(left: FloatArray) -> float:
        scores = [np.bincount(pose, direction * left) for direction in basis.T]
        inflation = float(np.sum(np.square(scores))) / (residuals.factor**2 * basis.shape[1])
        return float(scipy.special.fdtrc(k, left_over, tested.ratio / max(inflation, 1.0)))

    left = residuals.rows.residuals - explained
    result = chance(left)
    if result >= limit:
        return result
    return chance(left + residuals.without_poses.moved(left, beside=basis)[0])


@dataclass(frozen=True)
class PatternWords:
    """Numbers of a pattern as its sentence says them.

    Attributes:
        pattern: The pattern.
        dimensions: Whether each joint is a length or an angle.
    """

    pattern: Pattern
    dimensions: Mapping[str, Dimension]

    @property
    def size(self) -> str:
        """Root mean square of what it explains."""
        return f"{quantity_text(self.pattern.size, self.pattern.dimension)} RMS"

    @property
    def joint(self) -> str:
        """The joint that it is about."""
        return joints_named(self.pattern.name)

    @property
    def other(self) -> str:
        """Its neighbour, or the joint that a target moves with."""
        return joints_named(self.pattern.detail)

    @property
    def shift(self) -> float:
        """How far something is shifted [mm]."""
        return millimetres(self.pattern.amount)

    @property
    def ppm(self) -> float:
        """By which part lengths are off."""
        return PARTS_PER_MILLION * self.pattern.amount

    @property
    def height(self) -> str:
        """Height of a wave of the joint."""
        return self._of_joint(1.0)

    @property
    def play(self) -> str:
        """From one direction of approach to the other."""
        return self._of_joint(2.0)

    def _of_joint(self, times: float) -> str:
        dimension = self.dimensions[self.pattern.name]
        return quantity_text(times * abs(self.pattern.amount), dimension, ".2g", DISPLAY_UNIT)

    @property
    def slope(self) -> str:
        """Error of the joint for a unit of its neighbour."""
        return quantity_text(self.pattern.amount, self.dimensions[self.pattern.name], "+.2g")

    @property
    def each(self) -> str:
        """Unit of the neighbour."""
        return "rad" if self.dimensions[self.pattern.detail] == "angle" else "m"


def describe(pattern: Pattern, dimensions: Mapping[str, Dimension]) -> str:
    """Return a pattern in words.

    Args:
        pattern: The pattern.
        dimensions: Whether each joint is a length or an angle.
    """
    return pattern.kind.sentence.format(pattern=pattern, words=PatternWords(pattern, dimensions))

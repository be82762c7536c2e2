"""Systematic residuals: patterns that are no noise.

Question. Would the model explain the data significantly better with one more effect? For an effect with columns Z (its
change of the measured rows) the linear model r = J du + Z c is compared with the fit:

    M = I - J A^-1 J^T,   A = J^T J + sigma^2 P        what of Z the fit has not absorbed already
    gain = r^T Z (Z^T M Z)^-1 Z^T r                    by how much |r|^2 would fall
    F = (gain / k) / ((|r|^2 - gain) / (nu - k))       against F(k, nu - k), k columns left after M

An effect that the fit absorbs (a constant shift, where the base is free) is invisible and not tested. Families of kinds
share the chance of a false finding evenly; in a family, the chance of each finding is multiplied by the number of its
tests. A finding needs a chance below 1 % over all families, and an effect of at least a tenth of the noise: enough data
make any trifle significant. Where poses scatter more than independent readings (`calib.core.numerics.clusters`), F is
divided by the excess scatter of the effect's score, summed pose by pose, and nu is that of this scatter. A fit follows
each pose a little, so that its residuals scatter too little. So a finding must also hold with other residuals: those of
each pose if fit and effect are found from all other poses.

Many effects at once. A test needs only Z^T Z, (J T)^T Z with the span J T of the fit, and Z^T r. The effects of a
joint, a target or a frame have the columns of one base times factors of each visit, such as sin(k q_i) and cos(k q_i)
of a wave. So the sums over the rows of a visit are computed once for each base and serve all its effects.

When it fails. Without a time, the order of the rows in the data file must be that of the measurement. Effects of other
shapes stay in the noise; two effects that look alike at the measured poses are both named. F supposes normal noise.

Reference: cook1982, chapter 2.4 (added variables), and 3 (residuals without the pose that is judged).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.judging.effect_kinds import Family, Kind, Pattern, Trait
from calib.core.judging.effects import Effects, effects
from calib.core.judging.row_derivatives import EffectSetting
from calib.core.numerics import linalg
from calib.core.numerics.chances import EXACT, FALSE_ALARM
from calib.core.numerics.clusters import blocks_of_equal_length, shifts_without_block
from calib.core.numerics.tall import KEPT, Span, slices
from calib.core.rows.rows import Rows

ABSORBED = 1e-6
"""An effect is visible if at least this part of its square remains after the fit."""
_SURELY = 5.0  # an effect of so many standard deviations is found nine times of ten, although many are tested
_ROUNDING = 1e-10  # part of a square below which nothing remains
SMALLEST_EFFECT = 0.1
"""An effect counts as a finding if its root mean square is more than this part of the noise."""
_NUMBERS_AT_ONCE = 1 << 24  # largest size of the array of what findings explain
_VISITS_AT_ONCE = 512  # their factors stay in the processor's cache
_SUMS_AT_ONCE = 1 << 22  # largest size of the array of their sums
_ALIKE = 9.2  # times the noise squared: chance makes a sine and cosine explain more in 1 % of cases


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A finished fit as a linear model.

    Attributes:
        rows: Its whitened rows, with the weights of a robust loss.
        span: J T, the directions that the fit absorbs, (n_rows, rank), with T of `calib.core.numerics.observability`.
        factor: Found over assumed noise.
        pose_freedom: Degrees of freedom of the scatter of poses, where they scatter more than independent readings;
            else infinite.
        confirmed: Degrees of freedom among `freedom` that confirmed the noise before, as `Factors` has them.
    """

    rows: Rows
    span: Span
    freedom: float
    factor: float
    pose_freedom: float
    confirmed: float

    def after_fit(self, effect: FloatArray) -> FloatArray:
        """Return M Z, the remainder of effects Z (n_rows, n_effects) in the residuals, (n_rows, n_effects)."""
        return effect - self.span.times(self.span.transposed_product(effect))

    def with_parameters(self, effects: FloatArray) -> LinearFit:
        """Return the fit with effects Z (n_rows, k) as further parameters, as far as they are visible."""
        columns, left, values, vectors = self._unit_effects(effects[:, np.linalg.norm(effects, axis=0) > 0.0])
        seen = values > ABSORBED
        root = vectors[:, seen] / np.sqrt(values[seen])
        absorbed, fewer = left @ root, int(np.sum(seen))
        residuals = self.rows.residuals - absorbed @ (root.T @ (columns.T @ self.rows.residuals))
        return replace(
            self,
            rows=replace(self.rows, residuals=residuals),
            span=self.span.with_columns(absorbed),
            freedom=self.freedom - fewer,
            pose_freedom=self.pose_freedom - fewer,
        )

    def sizes(self, effects: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sizes (k,) of effects Z (n_rows, k) if all of them were parameters, and their standard deviations.

        Deviations are infinite for zero columns, and where all effects together leave no degree of freedom. An absorbed
        effect is uncertain and gets the size 0, since the residuals along it are only rounding of the solver.
        """
        made = np.flatnonzero(np.linalg.norm(effects, axis=0))
        columns, left, values, vectors = self._unit_effects(effects[:, made])
        inverse, seen = vectors / (values + ABSORBED) @ vectors.T, vectors[:, values > ABSORBED]
        found = -inverse @ (seen @ (seen.T @ (columns.T @ self.rows.residuals)))
        freedom, size = self.freedom - len(made), np.linalg.norm(effects[:, made], axis=0)
        rest = np.sum((self.rows.residuals + left @ found) ** 2) + self.confirmed
        scatter = np.sqrt(rest / freedom) if freedom > 0 else np.inf
        sizes, deviations = np.zeros(effects.shape[1]), np.full(effects.shape[1], np.inf)
        sizes[made], deviations[made] = found / size, scatter * np.sqrt(np.diag(inverse)) / size
        return sizes, deviations

    def _unit_effects(self, effects: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Effects of length 1, what the fit leaves of them, and the eigenvalues and eigenvectors of their product."""
        columns = effects / np.linalg.norm(effects, axis=0)
        left = self.after_fit(columns)
        return columns, left, *linalg.eigh(columns.T @ left)

    @cached_property
    def square(self) -> float:
        """Sum of squares of the residuals, and of those that confirmed the noise."""
        return float(np.sum(self.rows.residuals**2)) + self.confirmed

    def visible(self, column: FloatArray) -> float:
        """Return the least effect of a column (n_rows, 1) that the residuals show; infinite if they never do."""
        square = float(np.sum(column**2))
        left = float(np.sum(column * self.after_fit(column)))
        return _SURELY * self.factor / float(np.sqrt(left)) if left > _ROUNDING * square else float("inf")


@dataclass(frozen=True, eq=False)
class _EffectTests:
    """Results of the tests of m effects with k columns each: the tested `numbers` of the effects of one name.

    `ratios` are F of the module docstring, `ranks` the columns left after M, `gains` the decrease of |r|^2, (m,) each,
    and `coefficients` are c, (m, k).
    """

    effects: Effects
    numbers: IntArray
    freedom: float
    ratios: FloatArray
    ranks: IntArray
    gains: FloatArray
    coefficients: FloatArray

    def chance(self, row: int) -> float:
        """Return the chance of such a gain if readings are independent."""
        return float(scipy.special.fdtrc(self.ranks[row], self.freedom - self.ranks[row], self.ratios[row]))

    def significance(self, row: int) -> tuple[float, float]:
        """Return the chance and, for equal ones, the negative gain: the least is the most significant."""
        return self.chance(row), -float(self.gains[row])

    @property
    def best(self) -> int:
        """The row of the most significant effect; among equally many columns, it has the largest gain."""
        largest = [int(np.argmax(np.where(self.ranks == k, self.gains, -1.0))) for k in set(self.ranks.tolist())]
        return min(largest, key=self.significance)


def patterns(residuals: LinearFit, setting: EffectSetting, kinds: Container[Kind] = tuple(Kind)) -> tuple[Pattern, ...]:
    """Return the results of testing effects of some kinds, most significant first."""
    if residuals.factor * setting.noise_of(setting.first) < EXACT:
        return ()
    tested = list(_tests(residuals, [effect for effect in effects(setting) if effect.kind in kinds]))
    times = dict.fromkeys(Family, 0)
    for tests in tested:
        times[tests.effects.kind.family] += len(Family) * len(tests.numbers)
    kept = _kept(tested)
    noise = setting.sizes(np.full((len(residuals.span), 1), residuals.factor))[:, 0]
    result = []
    for part in slices(len(kept), max(_NUMBERS_AT_ONCE // len(residuals.span), 1)):
        whole = [tests.effects.times(int(tests.numbers[row]), tests.coefficients[row]) for tests, row in kept[part]]
        explained = residuals.after_fit(np.stack(whole, axis=1))
        for (tests, row), column, sizes in zip(kept[part], explained.T, setting.sizes(explained).T, strict=True):
            group = setting.first if tests.effects.group is None else tests.effects.group
            size, dimension = float(sizes[group]), setting.fit.whitening.groups[group].part.dimension
            kind, c = tests.effects.kind, tests.coefficients[row]
            p = min(1.0, _chance(residuals, tests, row, column, FALSE_ALARM / times[kind.family]) * times[kind.family])
            dozen = Trait.BY_THE_DOZEN in kind.traits
            amount = float(np.linalg.norm(c)) if dozen else float(c[0]) if len(c) == 1 else float("nan")
            surely = p < FALSE_ALARM and size > SMALLEST_EFFECT * noise[group]
            detail = tests.effects.detail(tests.numbers, tests.gains, row, _ALIKE * residuals.factor**2)
            result.append(Pattern(kind, tests.effects.name, p, size, amount, surely, dimension, detail))
    return tuple(sorted(result, key=lambda pattern: (pattern.p_value, -pattern.size)))


def _kept(tested: Iterable[_EffectTests]) -> list[tuple[_EffectTests, int]]:
    """Keep the most significant effect of each name of kinds that are tried by the dozen, and all of the others."""
    kept: dict[tuple[object, ...], list[tuple[_EffectTests, int]]] = {}
    for tests in tested:
        kind, name = tests.effects.kind, tests.effects.name
        if Trait.BY_THE_DOZEN in kind.traits:
            kept.setdefault((kind, name), []).append((tests, tests.best))
        else:
            kept |= {(kind, name, len(kept), row): [(tests, row)] for row in range(len(tests.numbers))}
    return [min(some, key=lambda of: of[0].significance(of[1])) if len(some) > 1 else some[0] for some in kept.values()]


def _moments(residuals: LinearFit, some: Sequence[Effects]) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield Z^T Z, (m, k, k), and Z^T r above (J T)^T Z, (1 + rank, k, m), of the m effects with k columns of each."""
    span, bases = residuals.span, {id(effect.base): effect.base for effect in some}
    tall, n = len(span) > KEPT, len(span.root)  # then J T is not stored: it is computed from sums over rows
    known = [span[:]] if not tall else [span.jacobian] if span.more is None else [span.jacobian, span.more]
    ends = np.cumsum([base.shape[1] for base in bases.values()])[:-1]
    numbers = sum(base.shape[1] for base in bases.values()) * (1 + sum(other.shape[1] for other in known))
    at_once = min(max(_SUMS_AT_ONCE // max(numbers, 1), 1), _VISITS_AT_ONCE)
    squares: list[FloatArray] = [np.zeros(1)] * len(some)
    products: list[FloatArray] = [np.zeros(1)] * len(some)
    for rows in _rows_of_visits(some[0].visit, at_once) if some else ():
        visits, own = some[0].visit[rows[:, 0]], [base[rows].transpose(0, 2, 1) for base in bases.values()]
        others = np.concatenate([residuals.rows.residuals[rows][:, :, None], *(other[rows] for other in known)], axis=2)
        further = np.split(np.matmul(np.concatenate(own, axis=1), others), ends, axis=1)
        sums = {
            key: (np.matmul(b, b.transpose(0, 2, 1)), more) for key, b, more in zip(bases, own, further, strict=True)
        }
        for k, effect in enumerate(some):
            factors, (square, product) = effect.factors(visits), sums[id(effect.base)]
            squares[k] = squares[k] + _squares(square, factors)
            each = product.reshape(len(visits), -1).T @ factors.reshape(len(visits), -1)
            products[k] = products[k] + each.reshape(*product.shape[1:], *factors.shape[1:])
    for square, product in zip(squares, products, strict=True):
        moments = product.swapaxes(0, 1).reshape(-1, square.shape[1], len(square))
        if tall:
            moments = np.concatenate([moments[:1], np.tensordot(span.root.T, moments[1 : n + 1], 1), moments[n + 1 :]])
        yield square, moments


def _rows_of_visits(visit: IntArray, at_once: int) -> Iterator[IntArray]:
    """Yield rows of at most `at_once` visits with equally many rows, (n_visits, n_rows_of_each)."""
    for every in blocks_of_equal_length(visit):
        for part in slices(len(every), at_once):
            yield every[part]


def _squares(sums: FloatArray, factors: FloatArray) -> FloatArray:
    (n, f, m), b = factors.shape, sums.shape[1]
    both = (factors[:, :, None] * factors[:, None]).reshape(n, -1)
    return (sums.reshape(n, -1).T @ both).reshape(b, b, f, f, m).transpose(4, 0, 2, 1, 3).reshape(m, b * f, b * f)


def _tests(residuals: LinearFit, some: Sequence[Effects]) -> Iterator[_EffectTests]:
    """Test effects, all with equally many columns at once; not absorbed ones, nor without a degree of freedom left."""
    by_width: dict[int, list[tuple[Effects, FloatArray, FloatArray]]] = {}
    for effect, (square, moments) in zip(some, _moments(residuals, some), strict=True):
        by_width.setdefault(square.shape[1], []).append((effect, square, moments))
    for alike in by_width.values():
        effects, each_square, each_moments = zip(*alike, strict=True)
        squares, moments = np.concatenate(each_square), np.concatenate(each_moments, axis=2)
        score, absorbed = moments[0].T, moments[1:]
        left = squares - np.einsum("rim,rjm->mij", absorbed, absorbed)
        size = np.sqrt(np.diagonal(squares, axis1=1, axis2=2))
        shown = np.all(size > 0, axis=1)
        size = np.where(shown[:, None], size, 1.0)
        values, vectors = linalg.eigh(left / (size[:, :, None] * size[:, None, :]))
        determined = values > ABSORBED
        score = np.where(determined, np.einsum("mi,mij->mj", score / size, vectors), 0.0)
        along = score / np.where(determined, values, 1.0)
        gains, k = np.sum(score * along, axis=1), np.sum(determined, axis=1)
        coefficients = np.einsum("mij,mj->mi", vectors, along) / size
        tested = shown & (k > 0) & (residuals.freedom - k >= 1)
        rest = np.maximum(residuals.square - gains, 1e-12 * residuals.square) / np.where(
            tested, residuals.freedom - k, 1
        )
        ratios = np.maximum(gains / np.maximum(k, 1) / rest, 0.0)
        use = np.flatnonzero(tested)
        ends = np.cumsum([0, *(len(square) for square in each_square)])
        parts = [slice(*of) for of in pairwise(np.searchsorted(use, ends).tolist())]
        found = [array[use] for array in (ratios, k, gains, coefficients)]
        for effect, first, part in zip(effects, ends.tolist(), parts, strict=False):
            if part.stop > part.start:
                yield _EffectTests(effect, use[part] - first, residuals.freedom, *(array[part] for array in found))


def _chance(residuals: LinearFit, tests: _EffectTests, row: int, explained: FloatArray, limit: float) -> float:
    """Chance of a gain as large from noise, with F divided by the excess scatter of the score where poses scatter
    together.

    `explained` is M Z c of the effect, (n_rows,), and `limit` the chance below which it is a finding.
    """
    if not np.isfinite(residuals.pose_freedom):
        return tests.chance(row)
    columns = tests.effects.columns(int(tests.numbers[row]))
    basis = linalg.orth(residuals.after_fit(columns), rcond=np.sqrt(ABSORBED))
    k, pose = int(tests.ranks[row]), residuals.rows.layout.pose_of_row
    left_over = max(residuals.pose_freedom - k, 1.0)

    def chance(left: FloatArray) -> float:
        scores = [np.bincount(pose, direction * left) for direction in basis.T]
        inflation = float(np.sum(np.square(scores))) / (residuals.factor**2 * basis.shape[1])
        return float(scipy.special.fdtrc(k, left_over, float(tests.ratios[row]) / max(inflation, 1.0)))

    left = residuals.rows.residuals - explained
    result = chance(left)
    if result >= limit:
        return result
    return chance(left + shifts_without_block(residuals.span.with_columns(basis), pose, left)[0])

"""One linear model of all kinds of columns, in which the size of each kind is found instead of choosing kinds.

Problem. Rows y of a linear problem have columns of many kinds. Some are certain (origins, places), others possible
(gears, bending), and no column describes the rest. The same rows show which kinds exist and how large they are, and the
uncertainty of that must be counted.

Model. With u the coefficients of all columns X,

    y = X u + H_k e_k + noise
    u_c ~ N(0, s_f^2)     of a column of family f; s_f is the size of the family, found
    u_c ~ N(0, 1)         of a column whose prior is known
    u_c                   flat of a column without a prior
    e_k ~ N(0, d^2 I)     scatter of what H moves (joints), drawn anew at each pose k; d is found
    noise ~ N(0, s_g^2)   of the rows of group g; s_g = 1 where it is stated, else found

Rows of a pose and group are rotated once, Q^T H H^T Q = diag(l). Then V = s_g^2 + d^2 l is diagonal, whatever the sizes
are. (Rows of a pose in two groups are taken to have independent scatters.)

Restricted likelihood. Scale the columns by their sizes, Z = X S (S = 1 where there is no size), and let P be 1 for
columns with a prior, 0 for flat ones. With A = Z^T V^-1 Z + P, v = A^-1 Z^T V^-1 y and r = y - Z v,

    -2 log L = log |V| + log |A| + r^T V^-1 r + |P v|^2 + constant

The constant depends on the flat columns alone (patterson1971; harville1977). The marginal covariance of y is W =
V + Z P Z^T, and its inverse with the flat columns projected out is Q = V^-1 - V^-1 Z A^-1 Z^T V^-1, so that Q y = r / V
and (Q Z P) = V^-1 Z A^-1 P. With T = Z A^-1 and h_i = (T_i . Z_i) / V_i the leverage of row i, derivatives by
logarithms of sizes, w_i = d log V_i / d(log size), are

    gradient of -log L     family    sum over its columns c of 1 - (A^-1)_cc - v_c^2
                           noise, d  1/2 sum of w_i (1 - h_i - r_i^2 / V_i)
    Fisher's information   families  2 |1 - (A^-1)_ff|^2,   2 |(A^-1)_fg|^2
                           mixed     sum of w_i T_ic^2 / V_i over the rows and the columns of f
                           noise, d  1/2 sum of w_i w'_i (1 - 2 h_i) + 1/2 tr(K A^-1 K' A^-1),  K = Z^T (w / V) Z

A search of the sizes steps by the mean of Fisher's information and the second derivative of -log L, which needs no
products of matrices (gilmour1995): with M the derivatives dW Q y, 1/2 M^T Q M.

At s_f = 0 the derivative of -log L by s_f^2 is 1/2 the sum of q_c - (x_c . V^-1 r)^2 over the columns of f, with q_c =
x_c . Q x_c, and Fisher's information is 1/2 the sum of q_c^2 or, where columns of f look alike, more.

With A = R^T R and B = V^-1/2 Z R^-1, h_i is |B_i|^2, and tr(K A^-1 K' A^-1) the product of B^T w B and B^T w' B.

Components. Columns of a family are replaced by their principal components, and flat ones by orthonormal columns of the
same span. Components below a ten-thousandth of the largest are dropped: rows do not see them. With a least length, so
are those that move all rows together by less than a part of the noise: of a coefficient u ~ N(0, 1) whose column has
the length l, rows decide l^2 / (1 + l^2) of its variance, and it tells the square of this part of what a long one tells
about the size. So a solution omits components that are shorter than a tenth of the noise with its sizes. Rows decide
1 % of their variance, and they tell 0.01 % of what long ones tell.

Rounding. R is found from A by Cholesky. Rows that are 1e8 times as long as others hide in A what only the others, or
priors, decide. Where pivots show this, R is found by QR of the rows, the longest first.

Another row, of derivatives b by the components, has the variance  b S A^-1 S b^T + d^2 |h|^2.

When it fails. Far from the linear model, and where the sizes of families are as large as the rows (`size_search` has
priors for them). A family with one size supposes that its coefficients are about equally large.

Reference: patterson1971; harville1977; gilmour1995; mackay1992.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays, hold
from calib.core.numerics import linalg
from calib.core.numerics.clusters import blocks_of_equal_length, shifts_without_block
from calib.core.numerics.identifiability import inverse_of_triangle, reduce_rows, square_of_triangle
from calib.core.numerics.mixed_rows import FLAT, KNOWN, Components, FamilyPart, MixedRows

_DECIDES = 1e-6  # other poses predict a direction if they decide more than this part of it
_LEAST_EFFECT = 0.1  # a solution omits a coefficient that moves all rows together by less than this part of the noise
_LOST = 1e-8  # with pivots below this part of the diagonal, products of rows have lost what a QR factor of rows keeps


@dataclass(frozen=True, eq=False)
class MixedModel(ReadOnlyArrays):
    """The model with its rows rotated and its columns replaced by components.

    Attributes:
        components: Components of each family, of columns with known priors, and of flat ones.
        x: Columns of the components, rows rotated, (n_rows, n).
        y: Values, rotated, (n_rows,).
        spread: l of the module docstring, (n_rows,).
    """

    rows: MixedRows
    components: Components
    x: FloatArray
    y: FloatArray
    spread: FloatArray
    n_families: int

    @staticmethod
    def from_rows(rows: MixedRows, least: float = 0.0) -> MixedModel:
        """Rotate rows, and replace their columns by components; those of families shorter than `least` are dropped."""
        numbers = [*range(int(np.max(rows.family, initial=-1)) + 1), KNOWN, FLAT]
        members = [np.flatnonzero(rows.family == number) for number in numbers]
        parts = [
            FamilyPart.from_columns(places, rows.columns[:, places], number, least)
            for number, places in zip(numbers, members, strict=True)
            if len(places)
        ]
        components = Components(tuple(parts))
        x = components.combine(rows.columns)
        y, spread = rows.values.copy(), np.zeros(len(x))
        for places, turn, spread_there in _rotate_rows(rows) if rows.levers.shape[1] else ():
            back, spread[places] = turn.transpose(0, 2, 1), spread_there
            x[places], y[places] = np.matmul(back, x[places]), np.matmul(back, y[places, None])[:, :, 0]
        return MixedModel(rows, components, x, y, spread, len(numbers) - 2)

    @property
    def family(self) -> IntArray:
        """Family of each component, as in `MixedRows`, (n,)."""
        return self.components.family

    @property
    def scatters(self) -> bool:
        """Whether d is among the sizes."""
        return self.rows.levers.shape[1] > 0

    @cached_property
    def unstated_groups(self) -> IntArray:
        """Groups whose noise is found, (n,)."""
        return np.flatnonzero(~self.rows.has_stated_noise)

    @cached_property
    def has_prior(self) -> FloatArray:
        """Diagonal of P, (n,)."""
        return np.where(self.family == FLAT, 0.0, 1.0)

    def sizes(self, logs: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return sizes of families (n_families,), noise of the groups (n_groups,) and d from logarithms (n_sizes,)."""
        noise = np.ones(len(self.rows.has_stated_noise))
        noise[self.unstated_groups] = np.exp(logs[self.n_families : self.n_families + len(self.unstated_groups)])
        return np.exp(logs[: self.n_families]), noise, float(np.exp(logs[-1])) if self.scatters else 0.0

    def solve(self, logs: FloatArray, seen: IntArray | None = None) -> SolvedModel:
        """Solve the model with given sizes.

        Args:
            logs: Logarithms of the sizes, (n_sizes,); -inf leaves a family out.
            seen: Columns with a coefficient, (n_seen,); those that rows see with these sizes if not given.
        """
        families, noise, scatter = self.sizes(logs)
        variance = noise[self.rows.group] ** 2 + scatter**2 * self.spread
        scale = np.append(families, [1.0, 1.0])[self.family]  # the appended entries are for families -2 and -1
        if seen is None:
            squares = scale**2 * np.einsum("ij,ij,i->j", self.x, self.x, 1.0 / variance)
            seen = np.flatnonzero((self.family < 0) | (squares > _LEAST_EFFECT**2))
        root = np.sqrt(variance)
        z, y = self.whiten_columns(seen, scale, variance), self.y / root
        prior = self.has_prior[seen]
        matrix: FloatArray = z.T @ z  # a product with its own transpose: half of the work
        np.einsum("ii->i", matrix)[:] += prior
        diagonal = np.diagonal(matrix).copy()
        upper, failed = scipy.linalg.lapack.dpotrf(matrix.T, overwrite_a=1)  # LAPACK's order: not copied
        if failed or np.any(np.diagonal(upper) ** 2 < _LOST * diagonal):
            rows = np.vstack([np.column_stack([z, y]), np.eye(len(seen), len(seen) + 1)[prior > 0.0]])
            matrix = reduce_rows(rows[np.argsort(-np.linalg.norm(rows, axis=1), kind="stable")])[: len(seen)]
            upper = matrix[:, :-1]
            v = scipy.linalg.solve_triangular(upper, matrix[:, -1], check_finite=False)
        else:
            v = scipy.linalg.lapack.dpotrs(upper, z.T @ y)[0]
        left = y - z @ v
        determinant = 2.0 * np.sum(np.log(np.abs(np.diag(upper)))) + self.rows.stands_for @ np.log(variance)
        cost = float(np.sum(left**2) + np.sum(prior * v**2))
        hold(matrix, upper)  # of which `upper` is a view
        solved = SolvedModel(self, logs, scale, seen, variance, upper, v, left, 0.5 * (float(determinant) + cost))
        vars(solved)["z"] = z  # the derivatives need z next
        return solved

    def whiten_columns(self, seen: IntArray, scale: FloatArray, variance: FloatArray) -> FloatArray:
        """Return V^-1/2 Z of the columns `seen`, (n_rows, n_seen)."""
        columns = self.x[:, seen]
        columns *= scale[seen]
        columns /= np.sqrt(variance)[:, None]
        return columns


def _rotate_rows(rows: MixedRows) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
    """Yield rows of poses that have equally many of the same groups, (m, k), and their Q (m, k, k) and l (m, k)."""
    for every in blocks_of_equal_length(rows.pose):
        groups = rows.group[every]
        for pattern in np.unique(groups, axis=0):
            places = every[np.all(groups == pattern, axis=1)]
            turn, spread = np.tile(np.eye(len(pattern)), (len(places), 1, 1)), np.zeros(places.shape)
            for g in np.unique(pattern):
                own = np.flatnonzero(pattern == g)
                levers = rows.levers[places[:, own]]
                values, turn[:, own[:, None], own] = linalg.eigh(np.matmul(levers, levers.transpose(0, 2, 1)))
                spread[:, own] = np.maximum(values, 0.0)
            yield places, turn, spread


def information_of_families(covariance: FloatArray, members: FloatArray) -> FloatArray:
    """Return Fisher's information of the logarithms of sizes of families, (n_families, n_families).

    Args:
        covariance: A^-1 of the module docstring, (n, n).
        members: 1 where a column is of a family, else 0, (n_families, n).
    """
    information: FloatArray = 2.0 * members @ covariance**2 @ members.T
    return information + np.diag(2.0 * members @ (1.0 - 2.0 * np.diag(covariance)))


@dataclass(frozen=True, eq=False)
class SolvedModel(ReadOnlyArrays):
    """The model solved with its sizes, in the symbols of the module docstring.

    Attributes:
        logs: Logarithms of the sizes, (n_sizes,).
        scale: Diagonal of S, (n,).
        seen: Columns that rows see with these sizes, (n_seen,); coefficients of the others are zero.
        variance: Diagonal of V, (n_rows,).
        upper: R with A = R^T R, (n_seen, n_seen).
        v: Scaled coefficients, (n_seen,).
        whitened_residuals: V^-1/2 r, (n_rows,).
        cost: -log L, up to a constant.
    """

    model: MixedModel
    logs: FloatArray
    scale: FloatArray
    seen: IntArray
    variance: FloatArray
    upper: FloatArray
    v: FloatArray
    whitened_residuals: FloatArray
    cost: float

    @cached_property
    def z(self) -> FloatArray:
        """V^-1/2 Z, (n_rows, n_seen)."""
        return self.model.whiten_columns(self.seen, self.scale, self.variance)

    @cached_property
    def _root(self) -> FloatArray:
        return inverse_of_triangle(self.upper)

    @cached_property
    def _unseen_part(self) -> FloatArray:
        """Diagonal of A^-1, (n_seen,)."""
        return np.asarray(np.einsum("ij,ij->i", self._root, self._root))

    @cached_property
    def _spread(self) -> FloatArray:
        """V^-1/2 Z R^-1, (n_rows, n_seen)."""
        return np.asarray(scipy.linalg.blas.dtrmm(1.0, self._root, self.z.T, trans_a=1).T)

    @cached_property
    def _leverage(self) -> FloatArray:
        """h, (n_rows,)."""
        return np.asarray(np.einsum("ij,ij->i", self._spread, self._spread))

    @cached_property
    def _members(self) -> FloatArray:
        """1 where a column is of a family, else 0, (n_families, n_seen)."""
        return (self.model.family[self.seen] == np.arange(self.model.n_families)[:, None]).astype(float)

    @cached_property
    def _shares(self) -> FloatArray:
        """Shares w of the noises to be found, and of d, (n_noise, n_rows)."""
        model = self.model
        _, noise, scatter = model.sizes(self.logs)
        group = model.rows.group
        shares = [2.0 * np.where(group == g, noise[g] ** 2, 0.0) / self.variance for g in model.unstated_groups]
        if model.scatters:
            shares.append(2.0 * scatter**2 * model.spread / self.variance)
        return np.array(shares).reshape(-1, len(group))

    @cached_property
    def gradient(self) -> FloatArray:
        """Gradient of `cost` by the logarithms of the sizes, (n_sizes,)."""
        of_families = self._members @ (1.0 - self._unseen_part - self.v**2)
        squares = self.model.rows.stands_for - self.whitened_residuals**2
        return np.concatenate([of_families, 0.5 * (self._shares @ squares - self._shared_leverage)])

    @property
    def _shared_leverage(self) -> FloatArray:
        """Sums of w h over the rows, (n_noise,)."""
        if self.model.scatters or len(self.model.rows.has_stated_noise) > 1:
            return self._shares @ self._leverage
        decided = len(self.seen) - self.model.has_prior[self.seen] @ self._unseen_part  # w is alike in all rows
        return np.asarray(self._shares[:, 0] * decided)

    @cached_property
    def information(self) -> FloatArray:
        """Fisher's information of the logarithms of the sizes, (n_sizes, n_sizes)."""
        shares, members = self._shares, self._members
        families = information_of_families(square_of_triangle(self._root), members)
        span = scipy.linalg.blas.dtrmm(1.0, self._root, self._spread, side=1, trans_a=1)  # V^-1/2 T
        mixed = members @ (shares @ span**2).T
        weighed = [np.sqrt(share)[:, None] * self._spread for share in shares]
        of_columns = [rows.T @ rows for rows in weighed]
        both = np.array([np.vdot(one, other) for one in of_columns for other in of_columns])
        both = both.reshape(len(shares), len(shares))
        noise = 0.5 * ((shares * (self.model.rows.stands_for - 2.0 * self._leverage)) @ shares.T + both)
        return np.block([[families, mixed], [mixed.T, noise]])

    @property
    def average_information(self) -> FloatArray:
        """Mean of Fisher's information and the second derivative of `cost`, approximately, (n_sizes, n_sizes)."""
        z = self.z
        families = 2.0 * z @ (self._members * self.v).T
        moved = np.hstack([families, (self._shares * self.whitened_residuals).T])
        seen = scipy.linalg.solve_triangular(self.upper, z.T @ moved, trans=1, check_finite=False)
        return 0.5 * (moved.T @ moved - seen.T @ seen)

    def slope_at_zero(self, families: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivative of `cost` by s^2 of families (k,) whose size is 0, and its information, (k,) each."""
        columns = np.flatnonzero(np.isin(self.model.family, families))
        z = self.model.whiten_columns(columns, np.ones(len(self.scale)), self.variance)
        seen = scipy.linalg.solve_triangular(self.upper, self.z.T @ z, trans=1, check_finite=False)
        left = np.einsum("ij,ij->j", z, z) - np.einsum("ij,ij->j", seen, seen)
        members = 0.5 * (self.model.family[columns] == families[:, None])
        return members @ (left - (z.T @ self.whitened_residuals) ** 2), members @ left**2

    @property
    def scatter_of_residuals(self) -> float:
        """Scatter that alone makes rows as large as the residuals are, in the group where it is least."""
        group, (squares, left) = self.model.rows.group, self.squares_and_freedom
        spread, counts = (np.bincount(group, of, len(left)) for of in (self.model.spread, np.ones(len(group))))
        moved = spread > 0.0
        times = counts[moved] / np.maximum(left[moved], 0.5)
        return float(np.sqrt(np.min(times * squares[moved] / spread[moved], initial=np.inf)))

    @property
    def squares_and_freedom(self) -> tuple[FloatArray, FloatArray]:
        """Squared residuals of each group of rows, and their degrees of freedom, (n_groups,) each."""
        rows, n = self.model.rows, len(self.model.rows.has_stated_noise)
        squares, freedom = self.variance * self.whitened_residuals**2, rows.stands_for - self._leverage
        return np.bincount(rows.group, squares, n) * 1.0, np.bincount(rows.group, freedom, n) * 1.0

    def freedom(self, families: IntArray) -> float:
        """Return how many coefficients of some families (k,) the rows decide."""
        return float(np.sum((1.0 - self._unseen_part)[np.isin(self.model.family[self.seen], families)]))

    @property
    def condensed_coefficients(self) -> FloatArray:
        """Coefficients u of the component columns, (n,)."""
        result = np.zeros(len(self.scale))
        result[self.seen] = self.scale[self.seen] * self.v
        return result

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients u of all columns, (n_columns,)."""
        return self.model.components.coefficients(self.condensed_coefficients)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of u of the component columns, (n, n)."""
        result = np.diag(self.scale**2)
        result[np.ix_(self.seen, self.seen)] = square_of_triangle(self.scale[self.seen, None] * self._root)
        return result

    def left_out_squares(self, block: IntArray, weight: FloatArray) -> FloatArray:
        """Return weighted squares of errors of blocks of poses, each predicted by all others, (n_blocks,).

        Directions that a block alone decides, such as the place of a setup, are not counted.

        Args:
            block: Block of each row, from 0 on, (n_rows,).
            weight: Weight of each group of rows, (n_groups,).
        """
        left = self.whitened_residuals
        shifts, _ = shifts_without_block(self._spread, block, left, alone=1.0 - _DECIDES)
        squares = weight[self.model.rows.group] * self.variance * (left + shifts) ** 2
        return np.asarray(np.bincount(block, squares))

"""Groups of parameters that move together: made-up null spaces, and MedRUE's from the paper."""

from itertools import combinations

import numpy as np
import pytest

from calib.core.robots.jacobian import linearise
from calib.shared import null_space
from calib.shared.null_space import describe_group, natural_coefficients, null_groups, shortest_basis
from medrue.closed_form import forward
from medrue.paper_tables import PARAMETERS, table1
from medrue.workspace import target_workspace

NAMES = list(PARAMETERS)


def matrix_with_null_vectors(vectors, rows=40, seed=0):
    """A random matrix whose null space is spanned by the given vectors."""
    vectors = np.array(vectors, dtype=float)
    seen = np.linalg.svd(vectors)[2][len(vectors) :]
    return np.random.default_rng(seed).standard_normal((rows, len(seen))) @ seen


def test_groups_that_were_put_in_come_out():
    groups = null_groups(matrix_with_null_vectors([[0, 0, 0, 0, 0, 1], [1, -2, 0, 0, 0, 0], [0, 0, 3, 1, 4, 0]]))
    result = [dict(zip(group.members, group.coefficients, strict=True)) for group in groups]
    expected = [{5: 1.0}, {0: 1.0, 1: -2.0}, {2: 1.0, 3: 1 / 3, 4: 4 / 3}]
    assert result == [pytest.approx(group, rel=1e-6) for group in expected]
    assert null_groups(np.random.default_rng(0).standard_normal((9, 4))) == ()  # full rank


@pytest.mark.parametrize("seed", range(8))
def test_a_held_column_that_moves_a_tenth_speaks_for_its_group_whatever_the_rounding(seed):
    (group,) = null_groups(matrix_with_null_vectors([[10, 1, 0, 0]], seed=seed), dropped=[1])
    assert group.members == (1, 0)
    np.testing.assert_allclose(group.coefficients, [1.0, 10.0], rtol=1e-9)


def brute_force_length(basis):
    """Total length of the shortest basis, by trying every support."""
    n, k = basis.shape
    results = []
    supports = (support for size in range(1, n + 1) for support in combinations(range(n), size))
    while len(results) < k:
        support = next(supports)
        outside = np.delete(basis, support, axis=0)
        _, s, vt = np.linalg.svd(outside) if len(outside) else (None, np.zeros(0), np.eye(k))
        vector = basis @ vt[-1]
        is_elementary = np.sum(s > 1e-9) == k - 1 and np.all(np.abs(vector[list(support)]) > 1e-9)
        if is_elementary and np.linalg.matrix_rank(np.array([*results, vector]), tol=1e-9) > len(results):
            results.append(vector)
    return sum(int(np.sum(np.abs(v) > 1e-9)) for v in results)


def sparse_subspace(seed, n=9, k=4):
    rng = np.random.default_rng(seed)
    vectors = np.zeros((k, n))
    for vector in vectors:
        size = int(rng.integers(2, 5))
        vector[rng.choice(n, size, replace=False)] = rng.integers(1, 4, size)
    used = vectors[:, np.any(vectors != 0, axis=0)]
    assert np.linalg.matrix_rank(used) == k
    return np.linalg.qr((rng.standard_normal((k, k)) @ used).T)[0]


@pytest.mark.parametrize("seed", range(12))
def test_the_basis_is_the_shortest_there_is(seed):
    basis = sparse_subspace(seed)
    result = shortest_basis(basis, np.zeros(len(basis), dtype=bool))
    assert int(np.sum(result != 0)) == brute_force_length(basis)
    np.testing.assert_allclose(result.T @ np.linalg.lstsq(result.T, basis, rcond=None)[0], basis, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_linear_programs_find_a_basis_of_elementary_vectors_too(seed, monkeypatch):
    basis = np.linalg.qr(np.random.default_rng(seed).standard_normal((9, 4)))[0]
    monkeypatch.setattr(null_space, "_MOST_SUPPORTS", 0)
    result = shortest_basis(basis, np.zeros(9, dtype=bool))
    assert np.linalg.matrix_rank(result) == 4
    # in a random subspace every elementary vector has exactly n - k + 1 entries
    assert {int(np.sum(vector != 0)) for vector in result} == {6}


def groups_at(medrue, q):
    rows = linearise(medrue, medrue.assemble(q)).jacobian * [p.sigma_si for p in medrue.parameters]
    return null_groups(rows.reshape(-1, 36), dropped=np.flatnonzero(~medrue.is_free))


@pytest.fixture(scope="module")
def groups(medrue):
    return groups_at(medrue, target_workspace().q)


def test_medrues_groups_are_the_papers(medrue, groups):
    words = [describe_group(group, medrue.parameters) for group in groups]
    assert words[:7] == [
        "d31 has no effect",
        "d32 has no effect",
        "d5 from xt",
        "xb from dq1",
        "d41 + dq1 from d42 + xt",
        "A2y + A1y + C1y + C2y from yb",
        "A2z + A1z + C1z + C2z from zb",
    ]
    assert len(words) == 8
    turn = {NAMES[k] for k in groups[7].members}
    assert "phi_bx" in turn
    assert turn <= {"phi_bx", "yb", "zb"} | {f"{point}{i}{axis}" for point in "AC" for i in "12" for axis in "yz"}


@pytest.mark.parametrize("k", range(8))
def test_a_group_moves_nothing_in_the_closed_form(medrue, groups, k):
    """Exactly but for the last, a turn about x: its rest at a turn by t is of order t^2."""
    q = target_workspace().q[::10]
    moves = natural_coefficients(groups[k], medrue.parameters)
    sizes = []
    for step in (1e-4, 1e-5):  # of the first member, in m or rad
        values = table1().nominal.copy()
        for name, amount, unit in moves:
            values[NAMES.index(name)] += step * amount * (np.radians(1.0) * 1e3 if unit == "deg" else 1.0)
        difference = forward(q, values).p_world_tool - forward(q, table1().nominal).p_world_tool
        sizes.append(np.abs(difference).max())
    if k < 7:
        assert max(sizes) < 1e-12  # rounding of lengths up to 1 m, and of the engine's coefficients
        return
    assert sizes[1] < 2e-9
    assert sizes[0] / sizes[1] == pytest.approx(100, rel=0.1)


def test_groups_do_not_hang_on_rounding(medrue, groups):
    again = groups_at(medrue, np.round(target_workspace().q, 9))
    assert [group.members for group in again] == [group.members for group in groups]


def test_a_parameter_that_hardly_moves_does_not_speak_for_its_group():
    """Null vector (1e-4, 1, -1): told by the first, the others would move ten thousand times its unit."""
    rows = np.linalg.svd(np.array([[1e-4, 1.0, -1.0]]))[2][1:]
    (group,) = null_groups(rows, dropped=[0])
    assert group.members == (1, 0, 2)
    assert np.allclose(group.coefficients, [1, 1e-4, -1])

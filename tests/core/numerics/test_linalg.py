"""Eigenvalues and singular values of every finite matrix, whatever LAPACK's fastest method does."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from calib.core.numerics import linalg
from tests.project import ROOT, SHARED

REPORTED = SHARED / "reports" / "eigh" / "bad_eigh.npy"
ITERATIVE = {"eig", "eigh", "eigvals", "eigvalsh", "svd", "svdvals", "lstsq", "pinv", "pinvh", "matrix_rank", "cond"}
ITERATIVE |= {"orth", "null_space", "polar", "sqrtm", "subspace_angles"}


def _clustered(n=60, seed=3):
    """Three eigenvalues, many times each, and a few others."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = np.concatenate([10.0 ** rng.uniform(-9, 0, 9), np.tile([1.53, 1.65, 1.83], n // 3)])[:n]
    matrix = (axes * values) @ axes.T
    return (matrix + matrix.T) / 2, np.sort(values)


def _fail_large(original):
    """A function of numpy that fails as LAPACK's divide and conquer does, of matrices with a first entry above 1."""

    def call(matrix, *arguments, **options):
        if np.any(np.asarray(matrix)[..., 0, 0] > 1.0):
            raise np.linalg.LinAlgError("did not converge")
        return original(matrix, *arguments, **options)

    return call


@pytest.fixture
def numpy_fails(monkeypatch):
    for name in ("eigh", "eigvalsh", "svd", "lstsq", "pinv"):
        monkeypatch.setattr(np.linalg, name, _fail_large(getattr(np.linalg, name)))


@pytest.mark.skipif(not REPORTED.is_file(), reason="the reported matrix is not here")
def test_a_matrix_on_which_divide_and_conquer_failed_has_eigenvalues():
    """With most kernels of OpenBLAS; `make test-processors` runs this with some of them."""
    matrix = np.load(REPORTED)
    values, vectors = linalg.eigh(matrix)
    assert np.max(np.abs(matrix @ vectors - vectors * values)) < 1e-12
    assert np.max(np.abs(vectors.T @ vectors - np.eye(len(matrix)))) < 1e-12
    assert linalg.eigvalsh(matrix) == pytest.approx(values, abs=1e-13)
    assert linalg.svd(matrix)[1][::-1] == pytest.approx(values, abs=1e-13)


def test_what_numpy_can_do_is_its_result_to_the_last_bit():
    matrix, _ = _clustered()
    wide = matrix[:20]
    right = np.arange(60.0)
    for ours, numpys in (
        (linalg.eigh(matrix), np.linalg.eigh(matrix)),
        ((linalg.eigvalsh(matrix),), (np.linalg.eigvalsh(matrix),)),
        (linalg.svd(wide), np.linalg.svd(wide)),
        (linalg.svd(wide, full_matrices=False), np.linalg.svd(wide, full_matrices=False)),
        ((linalg.singular_values(wide),), (np.linalg.svd(wide, compute_uv=False),)),
        ((linalg.lstsq(wide.T, right),), np.linalg.lstsq(wide.T, right)[:1]),
        ((linalg.pinv(wide, rcond=1e-6),), (np.linalg.pinv(wide, rcond=1e-6),)),
    ):
        assert all(np.array_equal(one, other) for one, other in zip(ours, numpys, strict=True))


@pytest.mark.parametrize("scale", [1.0, 1e-150, 1e150])
@pytest.mark.parametrize(
    ("a", "b", "d", "low", "high"),
    [
        (1.0, 0.0, 1e-20, 1e-20, 1.0),
        (-1e-20, 0.0, -1.0, -1.0, -1e-20),
        (1.0, 2.0**-30, 2.0**-60, 0.0, 1.0),
        (3.0, 3.0, 3.0, 0.0, 6.0),
        (-4.0, 1.0, 0.0, -2.0 - 5.0**0.5, 5.0**0.5 - 2.0),
        (0.0, 0.0, 0.0, 0.0, 0.0),
    ],
)
def test_small_eigenvalues_of_two_rows_are_not_lost(a, b, d, low, high, scale):
    matrix = scale * np.array([[a, b], [b, d]])
    values, vectors = linalg.eigh(matrix)
    assert values == pytest.approx([scale * low, scale * high], rel=1e-14, abs=0.0)
    assert np.max(np.abs((vectors * values) @ vectors.T - matrix)) <= 1e-14 * scale


def test_the_second_method_gives_what_the_first_would(numpy_fails):
    matrix, expected = _clustered()
    matrix, expected = matrix + np.eye(60), expected + 1.0  # the first entry is above 1
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.eigh(matrix)
    values, vectors = linalg.eigh(matrix)
    assert values == pytest.approx(expected, abs=1e-12)
    assert (vectors * values) @ vectors.T == pytest.approx(matrix, abs=1e-12)
    assert linalg.eigvalsh(matrix) == pytest.approx(expected, abs=1e-12)
    tall = matrix[:, :20]
    left, sizes, right = linalg.svd(tall)
    assert (left.shape, right.shape) == ((60, 60), (20, 20))
    assert (left[:, :20] * sizes) @ right == pytest.approx(tall, abs=1e-12)
    assert linalg.svd(tall, full_matrices=False)[0].shape == (60, 20)
    assert linalg.singular_values(tall) == pytest.approx(sizes, abs=1e-12)
    truth = np.arange(20.0)
    assert linalg.lstsq(tall, tall @ truth) == pytest.approx(truth, abs=1e-9)
    assert linalg.pinv(tall) @ tall == pytest.approx(np.eye(20), abs=1e-11)
    basis = linalg.orth(np.hstack([tall, tall]))
    assert basis.shape == (60, 20)
    assert basis @ (basis.T @ tall) == pytest.approx(tall, abs=1e-12)


def test_of_a_stack_only_the_matrices_that_failed_have_the_second_method(numpy_fails):
    matrix, _ = _clustered()
    small = matrix / 10
    values, vectors = linalg.eigh(np.array([[small, matrix + np.eye(60)], [small, small]]))
    assert (values.shape, vectors.shape) == ((2, 2, 60), (2, 2, 60, 60))
    alone = linalg.eigh(small)
    assert all(np.array_equal(values[k], alone[0]) and np.array_equal(vectors[k], alone[1]) for k in ((0, 0), (1, 1)))
    assert values[0, 1] == pytest.approx(10 * alone[0] + 1.0, abs=1e-12)


def test_rank_of_singular_matrices():
    singular = np.diag([2.0, 1.0, 0.0])
    assert (linalg.matrix_rank(singular), linalg.matrix_rank(-singular, hermitian=True)) == (2, 2)
    assert linalg.solution_and_rank(singular, np.ones(3))[1] == 2
    assert linalg.pinv(singular).tolist() == np.diag([0.5, 1.0, 0.0]).tolist()


def test_a_matrix_that_is_not_finite_is_an_error_as_numpy_has_it():
    with pytest.raises(np.linalg.LinAlgError):
        linalg.svd(np.full((3, 3), np.nan))


def _bare_calls(source):
    """Lines that reach an iterative method of numpy or scipy by any of its names."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module in ("numpy.linalg", "scipy.linalg"):
            yield node.lineno
        elif isinstance(node, ast.Attribute) and node.attr in ITERATIVE:
            inner = node.value
            if isinstance(inner, ast.Attribute) and inner.attr in ("linalg", "lapack"):
                yield node.lineno
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            two = any(word.arg == "ord" for word in node.keywords) or len(node.args) > 1
            if called in ("np.linalg.norm", "scipy.linalg.norm") and two:
                yield node.lineno


def test_no_file_asks_numpy_or_scipy_for_singular_values_or_eigenvalues():
    bare = [
        f"{path.relative_to(ROOT)}:{line}"
        for package in ("calib", "viz", "medrue")
        for path in sorted((ROOT / package).rglob("*.py"))
        if path != Path(linalg.__file__) and re.search("linalg|lapack", path.read_text(encoding="utf-8"))
        for line in _bare_calls(path.read_text(encoding="utf-8"))
    ]
    assert bare == []  # calib.core.numerics.linalg has each


@pytest.mark.parametrize(
    "line",
    [
        "np.linalg.eigh(a)",
        "from numpy.linalg import svd",
        "scipy.linalg.orth(a)",
        "decompose = np.linalg.svd",
        "np.linalg.norm(a, ord=2)",
        "np.linalg.norm(a, 2)",
    ],
)
def test_a_bare_call_is_found(line):
    assert list(_bare_calls(line)) == [1]


@pytest.mark.parametrize("shape", [(2, 2), (60, 2, 2), (3, 4, 2, 2)])
def test_two_by_two_matrices_are_turned_to_their_axes(shape):
    rng = np.random.default_rng(3)
    matrices = rng.standard_normal(shape) * 10.0 ** rng.integers(-9, 9, (*shape[:-2], 1, 1))
    matrices = matrices + matrices.swapaxes(-1, -2)
    matrices.reshape(-1, 2, 2)[0] = 3.0 * np.eye(2)
    values, vectors = linalg.eigh(matrices)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrices), rtol=1e-12)
    np.testing.assert_allclose(vectors.swapaxes(-1, -2) @ vectors, np.broadcast_to(np.eye(2), shape), atol=1e-15)
    back = vectors * values[..., None, :] @ vectors.swapaxes(-1, -2)
    np.testing.assert_allclose(back, matrices, atol=1e-15 * np.max(np.abs(matrices)))

"""Minima near a known one, against SciPy's solver on rows that bend."""

import numpy as np
import pytest
import scipy

from calib.core.numerics.nearby import Nearby

N_ROWS, N = 40, 4
RNG = np.random.default_rng(5)
DIRECTIONS = RNG.standard_normal((N_ROWS, N)) / np.sqrt(N_ROWS)
TIGHT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}


def rows(z, bend):
    """Sines of sums, bent the more the larger `bend` is."""
    return np.sin(bend * DIRECTIONS @ z + 1.0) / bend


def derivative(z, bend):
    return np.cos(bend * DIRECTIONS @ z + 1.0)[:, None] * DIRECTIONS


def around_zero(bend, held, pulled):
    second = -bend * np.sin(1.0) * np.einsum("ri,rj->rij", DIRECTIONS, DIRECTIONS)
    return Nearby(derivative(np.zeros(N), bend), second, held, pulled)


def minima(bend, held, pulled, noise, refused=()):
    """Minima, and those of SciPy."""
    at_zero = rows(np.zeros(N), bend) + noise

    def evaluate(numbers, places):
        for k, z in zip(numbers, places, strict=True):
            at = rows(z, bend) + noise[k] - rows(np.zeros(N), bend), derivative(z, bend)
            yield None if k in refused else at

    exact = [
        scipy.optimize.least_squares(
            lambda z, each=each: np.concatenate([rows(z, bend) - rows(np.zeros(N), bend) + each, pulled + held @ z]),
            np.zeros(N),
            lambda z: np.vstack([derivative(z, bend), held]),
            **TIGHT,
        )
        for each in noise
    ]
    return around_zero(bend, held, pulled).minima(at_zero - rows(np.zeros(N), bend), evaluate), exact


@pytest.mark.parametrize("bend", [0.003, 0.05])
@pytest.mark.parametrize("n_priors", [0, 2])
def test_minima_are_those_of_an_independent_solver(bend, n_priors):
    rng = np.random.default_rng(1)
    held, pulled = 0.5 * np.eye(N)[:n_priors], 0.1 * np.ones(n_priors)
    noise = rng.standard_normal((12, N_ROWS))
    found, exact = minima(bend, held, pulled, noise)
    assert found.draws.tolist() == list(range(12))
    for k, each in enumerate(exact):
        # the rule allows 1e-6 sqrt(40) standard deviations, of up to 2 in z
        assert found.z[k] == pytest.approx(each.x, abs=3e-5)
        plain = len(each.fun) - n_priors
        assert found.residuals[k] == pytest.approx(each.fun[:plain], abs=3e-5)
        assert found.jacobian[k] == pytest.approx(each.jac[:plain], abs=1e-5)
        assert found.root[k] @ found.root[k].T == pytest.approx(each.jac.T @ each.jac, abs=1e-5)


def test_rows_that_bend_little_are_evaluated_once_and_others_again():
    noise = np.random.default_rng(2).standard_normal((10, N_ROWS))
    nothing = np.zeros((0, N)), np.zeros(0)
    assert minima(0.003, *nothing, noise)[0].evaluations == 10
    assert 10 < minima(0.05, *nothing, noise)[0].evaluations <= 30


def test_draws_without_rows_are_left_out():
    noise = np.random.default_rng(3).standard_normal((4, N_ROWS))
    assert minima(0.003, np.zeros((0, N)), np.zeros(0), noise, refused=(1, 3))[0].draws.tolist() == [0, 2]
    assert len(minima(0.003, np.zeros((0, N)), np.zeros(0), noise, refused=range(4))[0].draws) == 0


def test_a_saddle_is_no_minimum():
    """Residuals so large that they outweigh what the rows say of a direction."""
    hollow = np.einsum("r,ij->rij", np.ones(2), np.diag([0.0, 1.0]))
    model = Nearby(np.eye(2), hollow, np.zeros((0, 2)), np.zeros(0))
    found = model.minima(np.array([[0.0, -5.0]]), lambda k, z: [(np.array([0.0, -5.0]), np.eye(2))])
    assert len(found.draws) == 0


def test_a_model_without_bends_leads_as_far_as_first_order():
    model = Nearby(DIRECTIONS, None, np.zeros((0, N)), np.zeros(0))
    noise = np.random.default_rng(4).standard_normal((3, N_ROWS))
    expected = [-np.linalg.lstsq(DIRECTIONS, each, rcond=None)[0] for each in noise]
    assert model.first(noise) == pytest.approx(np.array(expected), rel=1e-10)

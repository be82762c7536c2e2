import numpy as np
import pytest

from calib.errors import ComputationError
from calib.numerics.least_squares import minimise


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def slope(x):
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


@pytest.mark.parametrize("scaling", ["unit", "jacobian"])
def test_a_bent_valley_is_followed_to_its_end(scaling):
    found = minimise(rosenbrock, slope, np.array([-1.2, 1.0]), scaling=scaling)
    assert found.converged
    np.testing.assert_allclose(found.x, [1.0, 1.0], atol=1e-8)
    assert found.cost == pytest.approx(0.0, abs=1e-16)


def test_the_cost_is_the_sum_of_squares():
    found = minimise(lambda x: np.array([x[0] - 1, x[0] - 4.0]), lambda x: np.ones((2, 1)), np.zeros(1))
    assert found.x[0] == pytest.approx(2.5)
    assert found.cost == pytest.approx(2 * 1.5**2)


def test_a_step_to_where_there_is_no_value_is_shortened():
    def root(x):
        with np.errstate(invalid="ignore"):
            return np.array([np.sqrt(x[0] - 1) - 0.1])  # the first step goes to x < 1

    found = minimise(root, lambda x: np.array([[0.5 / np.sqrt(x[0] - 1)]]), np.array([3.0]))
    assert found.converged
    assert found.x[0] == pytest.approx(1.01, rel=1e-6)


def test_a_start_without_residuals_is_an_error():
    with pytest.raises(ComputationError, match="no value at the starting point"):
        minimise(lambda x: np.array([np.nan]), lambda x: np.ones((1, 1)), np.zeros(1))


def test_running_out_of_evaluations_is_not_convergence():
    found = minimise(rosenbrock, slope, np.array([-1.2, 1.0]), max_evaluations=2)
    assert not found.converged
    assert found.evaluations == 2
    assert found.message == "the limit of evaluations was reached"


BEND, OFFSET = 1.0, 0.8


def test_curvature_of_residuals_that_stay_does_not_spoil_convergence():
    """r = (u - 1, b u^2 + d): where plain Gauss-Newton steps move away from the minimum, which a cubic's root gives."""
    roots = np.roots([2 * BEND**2, 0, 1 + 2 * BEND * OFFSET, -1])  # half the derivative of |r|^2
    at = float(roots[np.abs(roots.imag) < 1e-12].real[0])

    def residuals(u):
        return np.array([u[0] - 1, BEND * u[0] ** 2 + OFFSET])

    def jacobian(u):
        return np.array([[1.0], [2 * BEND * u[0]]])

    near = np.array([at + 1e-3])
    plain = near - np.linalg.lstsq(jacobian(near), residuals(near), rcond=None)[0]
    assert abs(plain[0] - at) > 1e-3
    found = minimise(residuals, jacobian, np.zeros(1))
    assert found.converged
    assert found.x[0] == pytest.approx(at, abs=1e-6)
    assert found.evaluations <= 10  # 35 with a trust region around plain steps

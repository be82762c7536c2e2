import numpy as np
import pytest

from calib.core.base.errors import ComputationError
from calib.core.numerics.least_squares import minimise


def found_at(x, residuals, jacobian, start, *, most=1000, rtol=0.0, atol=1e-8, **options):
    """The minimum, which is at x and is found in so many evaluations."""
    minimum = minimise(residuals, jacobian, start, **options)
    assert minimum.converged
    np.testing.assert_allclose(minimum.x, x, rtol=rtol, atol=atol)
    assert minimum.cost == pytest.approx(np.sum(residuals(minimum.x) ** 2), rel=1e-9, abs=1e-16)
    assert minimum.evaluations <= most


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def slope(x):
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


@pytest.mark.parametrize("scaling", ["unit", "jacobian"])
def test_a_bent_valley_is_followed_to_its_end(scaling):
    found_at([1.0, 1.0], rosenbrock, slope, np.array([-1.2, 1.0]), scaling=scaling)


def test_a_step_to_where_there_is_no_value_is_shortened():
    def root(x):
        with np.errstate(invalid="ignore"):
            return np.array([np.sqrt(x[0] - 1) - 0.1])  # the first step goes to x < 1

    found_at(1.01, root, lambda x: np.array([[0.5 / np.sqrt(x[0] - 1)]]), np.array([3.0]), rtol=1e-6, atol=0)


def test_a_start_without_residuals_is_an_error():
    with pytest.raises(ComputationError, match="no value at the starting point"):
        minimise(lambda x: np.array([np.nan]), lambda x: np.ones((1, 1)), np.zeros(1))


def test_running_out_of_evaluations_is_not_convergence():
    minimum = minimise(rosenbrock, slope, np.array([-1.2, 1.0]), max_evaluations=2)
    assert not minimum.converged
    assert minimum.evaluations == 2
    assert minimum.message == "the limit of evaluations was reached"


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
    found_at(at, residuals, jacobian, np.zeros(1), most=10, atol=1e-6)  # 35 with a trust region around plain steps


@pytest.mark.parametrize("degrees", [120, 170])
def test_a_valley_longer_than_wide_is_followed(degrees):
    """A circle of radius 20, held to a thirtieth, and a prior of 1 around a point of it far from the start."""
    target = 20 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])

    def residuals(u):
        return np.concatenate([[(np.linalg.norm(u) - 20) * 30], u - target])

    def jacobian(u):
        return np.vstack([30 * u / np.linalg.norm(u), np.eye(2)])

    # 11 and 13 evaluations; 19 and 19 if the bottom is never left
    found_at(target, residuals, jacobian, np.array([20.0, 0.0]), most=15, atol=1e-6)


@pytest.mark.parametrize("above", [0.05, 0.2, 1.0])
def test_a_saddle_is_left(above):
    """Half a square that is 1 + c too small, and a prior of 1: zero is a maximum between minima at +-sqrt(2 c)."""
    found_at(
        np.sqrt(2 * above),
        lambda u: np.array([u[0] ** 2 / 2 - 1 - above, u[0]]),
        lambda u: np.array([[u[0]], [1.0]]),
        np.array([0.01]),
        most=40,  # 25, 13 and 9; 103, 32 and 16 without the curvature of the steps before
        rtol=1e-4,
        atol=0,
    )


def hardly_seen(seed, n=40, n_rows=120, sigma=1e-4):
    """Residuals with a prior of 1 on each unknown, whose effects are 1 to 1e-4, bend, and are 0.3 from zero."""
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(rows, n)))[0] for rows in (n_rows, n))
    effects, bent = left * np.logspace(0, -4, n) @ right.T, rng.normal(size=(n_rows, n)) / np.sqrt(n)

    def read(u):
        return effects @ u + 0.5 * (bent @ u) ** 2 / np.sqrt(n)

    measured = read(0.3 * rng.normal(size=n)) + sigma * rng.normal(size=n_rows)

    def jacobian(u):
        return np.vstack([(effects + (bent @ u)[:, None] * bent / np.sqrt(n)) / sigma, np.eye(n)])

    return lambda u: np.concatenate([(read(u) - measured) / sigma, u]), jacobian


def test_wrong_scales_of_a_linear_problem_cost_one_evaluation():
    effects = np.random.default_rng(0).normal(size=(60, 20))
    minimum = minimise(lambda x: effects @ (x - 1000.0), lambda x: effects, np.zeros(20))
    assert minimum.x == pytest.approx(1000.0)
    assert minimum.evaluations == 3


@pytest.mark.parametrize("seed", [1, 2])
def test_an_absurdly_long_first_step_is_not_taken(seed):
    residuals, jacobian = hardly_seen(seed)
    first = np.linalg.lstsq(jacobian(np.zeros(40)), -residuals(np.zeros(40)), rcond=None)[0]
    assert np.linalg.norm(first) > 10 * np.sqrt(40)  # where the truth is 0.3 sqrt(40) away
    minimum = minimise(residuals, jacobian, np.zeros(40))
    assert minimum.converged
    assert minimum.cost < 2 * 120  # noise alone; from where that step leads, minima 1000 times as high are found
    assert minimum.evaluations <= 20  # 9 and 11; 37 and 76 with that step


@pytest.mark.parametrize("bend", [3.0, 30.0])
def test_a_long_bent_valley_is_crossed_and_not_followed(bend):
    """The minimum is far along y = bend sin x, 0 at x = y = 3 and bend sin 3: a prior as wide as that is long."""

    def residuals(x):
        return np.array([1e3 * (x[1] - bend * np.sin(x[0])), x[0] - 3.0])

    def jacobian(x):
        return np.array([[-1e3 * bend * np.cos(x[0]), 1e3], [1.0, 0.0]])

    # 6 and 9 evaluations; 31 and 59 if the bottom is never left, 200 do not do with straight steps
    found_at([3.0, bend * np.sin(3.0)], residuals, jacobian, np.zeros(2), most=12, rtol=1e-6, atol=0)


def test_a_way_that_does_not_come_down_again_is_gone_back():
    """Beside the valley x^2 = y, the rows repel: every step away from the bottom leads further up."""

    def residuals(x):
        off = x[1] - x[0] ** 2
        return np.array([30 * np.arctan(30 * off), x[0] - 5.0])

    def jacobian(x):
        slope = 900 / (1 + (30 * (x[1] - x[0] ** 2)) ** 2)
        return np.array([[-2 * slope * x[0], slope], [1.0, 0.0]])

    looked_at = []

    def told(x):
        looked_at.append(x)
        return jacobian(x)

    found_at([5.0, 25.0], residuals, told, np.zeros(2), rtol=1e-6, atol=0)
    assert sum(np.array_equal(x, np.zeros(2)) for x in looked_at) == 2


@pytest.mark.parametrize("condition", [1e3, 1e7])
def test_many_unknowns_are_found_however_badly_they_are_seen(condition):
    rng = np.random.default_rng(0)
    left, right = (np.linalg.qr(rng.standard_normal((n, 150)))[0] for n in (400, 150))
    jacobian, truth = left * np.geomspace(1.0, 1.0 / condition, 150) @ right.T, rng.standard_normal(150)
    found_at(truth, lambda x: jacobian @ (x - truth), lambda x: jacobian, np.zeros(150), most=3, atol=1e-12)

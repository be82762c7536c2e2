"""The whitened rows: each kind of noise, gaps and groups, against plain linear algebra."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.robots.jacobian import linearise
from calib.core.rows.observed import observe
from calib.core.rows.unknowns import Unknowns
from calib.core.rows.whitening import ASSUMED, Whitening
from tests.small_robots import ARM_YAML, write_arm

TWO = ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider, xyz: [0, 0.1, 0]}\n")
SIGMA = 1e-4


def instruments(tip, elbow=""):
    """Two instruments that state this noise."""
    return TWO + (
        f"instruments:\n  one: {{kind: position, target: tip{tip}}}\n  two: {{kind: position, target: elbow{elbow}}}\n"
    )


class Case:
    """A robot, noisy measurements of it, and their rows."""

    def __init__(self, folder, yaml, *, gaps=(), n=30, sigma=None, change=lambda data: data):
        self.robot = calib.load(write_arm(folder, yaml))
        rng = np.random.default_rng(1)
        self.q = rng.uniform([-2, 0, -2], [2, 1, 2], (n, 3))
        self.measured = self.robot.positions(self.q) + 1e-3 * rng.standard_normal((n, 2, 3))
        for visit, target in gaps:
            self.measured[visit, target] = np.nan
        names = self.robot.target_names
        readings = {item.name: self.measured[:, names.index(item.target)] for item in self.robot.instruments}
        self.data = change(calib.as_measurements(self.robot, self.q, readings))
        self.configurations = self.robot.assemble(self.q)
        self.whitening = Whitening(self.robot, self.data, sigma)
        self.observed = observe(self.robot, self.configurations, self.data.readings)

    def rows(self, groups=None):
        unknowns = Unknowns.from_robot(self.robot)
        groups = self.whitening.start() if groups is None else np.array(groups)
        return self.whitening.rows(self.observed, groups, unknowns, self.robot.values)

    def plain(self, target):
        """Residuals (n, 3) [m] and scaled Jacobian (n, 3, n_free) [m] of a target, gaps left out."""
        linear = linearise(self.robot, self.configurations)
        t = self.robot.target_names.index(target)
        seen = np.isfinite(self.measured[:, t, 0])
        scales = np.array([p.sigma_si for p in self.robot.parameters])[self.robot.is_free]
        jacobian = linear.jacobian[:, t][..., self.robot.is_free] * scales
        return (linear.positions[:, t] - self.measured[:, t])[seen], jacobian[seen]


def same_information(rows, jacobians, residuals):
    """Compare rows with the same thing made otherwise: information and pull do not depend on how rows are turned."""
    jacobian, residual = np.concatenate(jacobians), np.concatenate(residuals)
    np.testing.assert_allclose(rows.jacobian.T @ rows.jacobian, jacobian.T @ jacobian, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(rows.jacobian.T @ rows.residuals, jacobian.T @ residual, rtol=1e-9, atol=1e-6)
    assert rows.residuals @ rows.residuals == pytest.approx(residual @ residual, rel=1e-9)


def whitened(case, target, covariance):
    """Rows of a target by the symmetric inverse root of each reading's covariance (3, 3) [m^2]."""
    r, j = case.plain(target)
    values, vectors = np.linalg.eigh(np.broadcast_to(covariance, (len(r), 3, 3)))
    root = np.matmul(vectors / np.sqrt(values)[:, None, :], vectors.transpose(0, 2, 1))
    return np.matmul(root, j).reshape(-1, j.shape[2]), np.matmul(root, r[:, :, None]).ravel()


def assert_whitened(case, tip, elbow=9e-8):
    """Rows are those of readings with these covariances, (3, 3) [m^2] each or one number; return them."""
    by_target = {"tip": tip, "elbow": elbow}
    parts = [whitened(case, name, np.eye(3) * c if np.isscalar(c) else c) for name, c in by_target.items()]
    same_information(case.rows(), *zip(*parts, strict=True))
    return case.rows()


@pytest.mark.parametrize(("given", "variance"), [(None, 1e-8), (5e-4, 25e-8)])
def test_one_number_divides_every_row_and_one_that_is_given_replaces_it(tmp_path, given, variance):
    case = Case(tmp_path, TWO + "sigma: 0.1 mm\n", sigma=given)
    assert_whitened(case, variance, variance)
    assert [group.name for group in case.whitening.groups] == ["targets"]  # one instrument sees both


def test_noise_of_each_axis(tmp_path):
    case = Case(tmp_path, instruments(", sigma: [0.1 mm, 0.2 mm, 0.5 mm]", ", sigma: 0.3 mm"))
    assert_whitened(case, np.diag([1e-8, 4e-8, 25e-8]))


def test_noise_of_a_tracker_along_and_across_its_beam(tmp_path):
    case = Case(tmp_path, instruments(", sigma: {range: 0.02 mm, angle: 0.1 mrad}", ", sigma: 0.3 mm"))
    p = case.measured[:, case.robot.target_names.index("tip")]
    covariance = []
    for point in p:  # two orthonormal directions across the beam
        distance = np.linalg.norm(point)
        across = np.linalg.svd(point[None])[2][1:]
        basis = np.vstack([point / distance, across])
        covariance.append(basis.T @ np.diag([2e-5**2, *2 * [(1e-4 * distance) ** 2]]) @ basis)
    assert_whitened(case, np.array(covariance))


def with_one(data, **changes):
    """Measurements in which these of the instrument `one` are others."""
    return replace(data, readings=dict(data.readings) | {"one": replace(data.readings["one"], **changes)})


def some_covariance():
    root = 1e-4 * np.random.default_rng(7).standard_normal((30, 3, 3))
    return root @ root.transpose(0, 2, 1) + 1e-9 * np.eye(3)


def test_the_covariance_of_a_row_comes_before_what_is_stated(tmp_path):
    yaml, covariance = instruments(", sigma: 5 mm", ", sigma: 0.3 mm"), some_covariance()
    assert_whitened(Case(tmp_path, yaml, change=lambda data: with_one(data, covariance=covariance)), covariance)


def test_columns_take_no_memory_but_their_own(tmp_path):
    """Between parameters that are held, with a coefficient of a joint term, of two instruments."""
    yaml = instruments(", sigma: 0.1 mm", ", sigma: 0.3 mm") + "joint_terms:\n  - {joint: turn, term: gain}\n"
    case = Case(tmp_path, yaml + "held: [slide.y, wrist.rx]\n", n=3000)
    unknowns, groups = Unknowns.from_robot(case.robot), np.ones(len(case.whitening.groups))
    tracemalloc.start()
    columns = case.whitening.columns(case.observed, groups, unknowns)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.7 * columns.nbytes  # the columns, and a part of those of one instrument
    assert_whitened(case, 1e-8)


def test_readings_that_were_not_taken_are_no_rows(tmp_path):
    gaps = [(2, 0), (3, 1), (4, 0), (4, 1), (29, 1)]
    rows = assert_whitened(Case(tmp_path, instruments(", sigma: 0.1 mm", ", sigma: 0.3 mm"), gaps=gaps), 1e-8)
    assert rows.layout.n_read == rows.layout.n_rows == 3 * (60 - len(gaps))


@pytest.mark.parametrize("stated", ["axes", "covariance"])
def test_a_component_that_was_not_read_counts_for_nothing(tmp_path, stated):
    """The others keep the noise that they have alone: rows and columns of the covariance are struck out."""
    covariance = some_covariance() if stated == "covariance" else np.tile(np.diag([1e-8, 4e-8, 25e-8]), (30, 1, 1))

    def change(data):
        values = data.readings["one"].values.copy()
        values[5, 1], values[8, :2] = np.nan, np.nan
        return with_one(data, values=values, covariance=covariance if stated == "covariance" else None)

    case = Case(tmp_path, instruments(", sigma: [0.1 mm, 0.2 mm, 0.5 mm]", ", sigma: 0.3 mm"), change=change)
    r, j = case.plain("tip")
    jacobians, residuals = [], []
    for k in range(30):
        kept = {5: [0, 2], 8: [2]}.get(k, [0, 1, 2])
        inverse = np.linalg.inv(np.linalg.cholesky(covariance[k][np.ix_(kept, kept)]))
        jacobians.append(inverse @ j[k][kept])
        residuals.append(inverse @ r[k][kept])
    elbow = whitened(case, "elbow", 9e-8 * np.eye(3))
    rows = case.rows()
    same_information(rows, [*jacobians, elbow[0]], [*residuals, elbow[1]])
    assert rows.layout.n_read == 180 - 3
    assert rows.layout.width[[5, 8, 9]].tolist() == [2, 1, 3]
    assert np.sum(rows.layout.group == -1) == 3


def test_noise_that_nobody_states_has_a_scale_for_each_instrument(tmp_path):
    case = Case(tmp_path, instruments("", ", sigma: 0.3 mm"))
    assert [(group.name, group.stated) for group in case.whitening.groups] == [("one", False), ("two", True)]
    assert case.whitening.start().tolist() == [ASSUMED["length"], 1.0]
    result = case.whitening.start({name: item.residuals for name, item in case.observed.items()})
    assert result[0] == pytest.approx(np.sqrt(np.mean(case.plain("tip")[0] ** 2)), rel=1e-5)
    parts = [whitened(case, "tip", 4e-6 * np.eye(3)), whitened(case, "elbow", 9e-8 * np.eye(3))]
    same_information(case.rows([2e-3, 1.0]), *zip(*parts, strict=True))


def test_weights_of_readings_are_weights_of_their_squares(tmp_path):
    case = Case(tmp_path, instruments(", sigma: 0.1 mm", ", sigma: 0.3 mm"))
    weights = np.random.default_rng(3).uniform(0, 1, 60)
    rows = case.rows()
    by_row = np.repeat(weights, 3)
    weighted = rows.with_weights(weights)
    assert np.sum(weighted.residuals**2) == pytest.approx(by_row @ rows.residuals**2)
    expected = rows.jacobian.T @ (by_row[:, None] * rows.jacobian)
    np.testing.assert_allclose(weighted.jacobian.T @ weighted.jacobian, expected, rtol=1e-10, atol=1e-9)


def test_distances_are_lengths_of_whitened_residuals(tmp_path):
    case = Case(tmp_path, instruments(", sigma: 0.1 mm", ", sigma: 0.3 mm"))
    tip, elbow = (np.linalg.norm(case.plain(target)[0], axis=1) for target in ("tip", "elbow"))
    np.testing.assert_allclose(case.rows().distances(), np.concatenate([tip / 1e-4, elbow / 3e-4]), rtol=1e-12)

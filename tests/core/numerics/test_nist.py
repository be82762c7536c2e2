"""The solver core against NIST's certified nonlinear regressions of higher difficulty.

Certified values and standard deviations have eleven digits; six of them must come out from both starting points, with
the same solver and the same statistics that a calibration uses.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from calib.core.numerics.least_squares import minimise
from calib.core.numerics.observability import information
from calib.core.numerics.prior import Prior
from calib.core.numerics.statistics import find_factors, statistics


def mgh09(b, x):
    top, bottom = x**2 + x * b[1], x**2 + x * b[2] + b[3]
    value = b[0] * top / bottom
    return value, [top / bottom, b[0] * x / bottom, -value * x / bottom, -value / bottom]


def thurber(b, x):
    top = b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3
    bottom = 1 + b[4] * x + b[5] * x**2 + b[6] * x**3
    value = top / bottom
    return value, [x**k / bottom for k in range(4)] + [-value * x**k / bottom for k in (1, 2, 3)]


def boxbod(b, x):
    decay = np.exp(-b[1] * x)
    return b[0] * (1 - decay), [1 - decay, b[0] * x * decay]


def rat42(b, x):
    growth = np.exp(b[1] - b[2] * x)
    slope = b[0] * growth / (1 + growth) ** 2
    return b[0] / (1 + growth), [1 / (1 + growth), -slope, x * slope]


def mgh10(b, x):
    power = np.exp(b[1] / (x + b[2]))
    return b[0] * power, [power, b[0] * power / (x + b[2]), -b[0] * power * b[1] / (x + b[2]) ** 2]


def eckerle4(b, x):
    z = (x - b[2]) / b[1]
    value = b[0] / b[1] * np.exp(-(z**2) / 2)
    return value, [value / b[0], value / b[1] * (z**2 - 1), value * z / b[1]]


def rat43(b, x):
    growth = np.exp(b[1] - b[2] * x)
    value = b[0] * (1 + growth) ** (-1 / b[3])
    slope = value / b[3] * growth / (1 + growth)
    return value, [value / b[0], -slope, x * slope, value * np.log1p(growth) / b[3] ** 2]


def bennett5(b, x):
    value = b[0] * (b[1] + x) ** (-1 / b[2])
    return value, [value / b[0], -value / b[2] / (b[1] + x), value * np.log(b[1] + x) / b[2] ** 2]


MODELS = {
    "MGH09": mgh09, "Thurber": thurber, "BoxBOD": boxbod, "Rat42": rat42, "MGH10": mgh10, "Eckerle4": eckerle4,
    "Rat43": rat43, "Bennett5": bennett5,
}  # fmt: skip


def read(path: Path):
    """Starts and certified numbers (n_parameters, 4), and the data y, x."""
    lines = path.read_text().splitlines()
    table = [line.split("=")[1].split() for line in lines if re.match(r"\s*b\d+\s*=\s*[-\d]", line)]
    first = max(k for k, line in enumerate(lines) if line.startswith("Data:")) + 1
    data = np.array([[float(cell) for cell in line.split()] for line in lines[first:] if line.strip()])
    return np.array(table, dtype=float), data[:, 0], data[:, 1]


@pytest.fixture(scope="module")
def strd(shared_data) -> Path:
    return shared_data / "nist_strd"


@pytest.mark.parametrize("start", [1, 2])
@pytest.mark.parametrize("name", MODELS)
def test_certified_values_and_standard_deviations_come_out_to_six_digits(strd, name, start):
    table, y, x = read(strd / f"{name}.dat")
    model = MODELS[name]

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # trial points far away
        minimum = minimise(
            lambda b: model(b, x)[0] - y,
            lambda b: np.stack(model(b, x)[1], axis=1),
            table[:, start - 1],
            scaling="jacobian",
            tolerance=1e-15,
            max_evaluations=2000,
        )
    assert minimum.converged
    n = len(table)
    jacobian, one_group = np.stack(model(minimum.x, x)[1], axis=1), np.zeros(len(y), dtype=np.intp)
    known = information(jacobian)
    span = jacobian @ known.root
    factors = find_factors(minimum.residuals, span, one_group, 1)
    uncertainty = statistics(span, one_group, known, factors, np.ones(n), Prior(np.zeros(n, dtype=bool)))
    np.testing.assert_allclose(minimum.x, table[:, 2], rtol=1e-6)
    np.testing.assert_allclose(uncertainty.std, table[:, 3], rtol=1e-6)

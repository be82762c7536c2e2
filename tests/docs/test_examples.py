"""The files of docs/examples are what the pages say they are."""

import re

import make_examples
import numpy as np
import pytest
from snippets import DOCS

import calib
from calib.core.data.parameter_files import read_parameters

EXAMPLES = DOCS / "examples"
_NUMBER = re.compile(r"[-+]?\d+\.\d+(?:e[-+]?\d+)?")


@pytest.mark.quick(0)
def test_the_files_are_those_that_the_command_writes():
    for name, text in make_examples.every_file().items():
        shipped, made = (EXAMPLES / name).read_text().splitlines(), text.splitlines()
        assert len(shipped) == len(made)
        for old, new in zip(shipped, made, strict=True):
            _same(old, new)


def _same(old, new):
    """Equal but for the last digits of numbers, which another machine may round the other way."""
    texts, numbers = zip(*((_NUMBER.split(line), _NUMBER.findall(line)) for line in (old, new)), strict=True)
    assert texts[0] == texts[1]
    np.testing.assert_allclose(np.array(numbers[0], float), np.array(numbers[1], float), rtol=0, atol=2e-4)


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", ["arm", "five_bar", *make_examples.TEMPLATES])
def test_an_example_calibrates_to_its_truth(name):
    robot = calib.load(EXAMPLES / f"{name}.yaml")
    data = calib.read_measurements(EXAMPLES / f"{name}_simulated.csv", robot)
    result = calib.fit(robot, data)
    truth = robot.with_parameters(read_parameters(EXAMPLES / f"{name}_truth.csv", robot))
    off = result.robot.positions(data.joints) - truth.positions(data.joints)
    sigma = robot.description.sigma or make_examples.TEMPLATE_SIGMA
    assert abs(off).max() < 3 * sigma  # noise of one reading; the fit averages it
    assert result.verdict.grade == "PASS"


@pytest.mark.parametrize(
    ("table", "q", "place"),
    [  # at zero, from the manufacturer's drawing: both arms stretched; the Panda as its controller shows it at "ready"
        ("ur10e_dh.csv", [0, 0, 0, 0, 0, 0], [-0.6127 - 0.57155, -0.17415 - 0.11655, 0.1807 - 0.11985]),
        ("panda_dh.csv", [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4], [0.30689, 0.0, 0.59028]),
    ],
)
def test_tables_of_manufacturers_have_their_arms(tmp_path, run_calib, table, q, place):
    assert run_calib("init", "--dh", EXAMPLES / table, "--out", tmp_path / "robot.yaml").code == 0
    end = calib.load(tmp_path / "robot.yaml").forward([q], "flange" if "ur" in table else None)[0, :3, 3]
    assert np.allclose(end, place, rtol=0, atol=1e-5)


def test_simulated_files_say_so_on_their_first_line():
    for path in EXAMPLES.glob("*_simulated.csv"):
        assert path.read_text().lower().startswith("# simulated")

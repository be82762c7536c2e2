"""Arrays of frozen objects stay read-only: computed ones, and after pickling and copying, too."""

import pickle
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

import calib
from calib.core.base.arrays import ReadOnlyArrays
from tests.project import EXAMPLES


@dataclass(frozen=True, eq=False)
class Pair(ReadOnlyArrays):
    both: np.ndarray

    @cached_property
    def doubled(self):
        return 2.0 * self.both


@pytest.mark.parametrize("same", [lambda pair: pair, deepcopy, lambda pair: pickle.loads(pickle.dumps(pair))])
def test_neither_given_nor_computed_arrays_can_be_changed(same):
    pair = Pair(np.array([1.0, 2.0]))
    assert not pair.doubled.flags.writeable
    pair = same(pair)
    for array in (pair.both, pair.doubled):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0


def test_rows_have_their_names_and_parameters_their_numbers_after_pickling():
    robot = calib.load(EXAMPLES / "arm.yaml")
    limits, parameters = robot.joint_limits, robot.parameters
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(limits))["joint_2"], limits[1])
    assert not parameters.sigma_si.flags.writeable
    again = pickle.loads(pickle.dumps(parameters))
    assert again == parameters
    assert not again.sigma_si.flags.writeable


def test_masked_numbers_are_not_known_and_complex_ones_are_refused():
    robot = calib.load(EXAMPLES / "arm.yaml")
    hidden = np.ma.masked_array(np.zeros((2, 6)), mask=np.eye(2, 6, dtype=bool))
    with pytest.raises(calib.DataError, match="'joint_1' is not finite"):
        robot.positions(hidden)
    read = np.ma.masked_array(np.ones((2, 3)), mask=[[True] * 3, [False] * 3])
    assert calib.as_measurements(robot, np.zeros((2, 6)), read).readings["reflector"].visits.tolist() == [1]
    with pytest.raises(calib.InputError, match="expected numbers"):
        robot.positions(np.zeros(6) + 1j)

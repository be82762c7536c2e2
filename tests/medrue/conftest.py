"""MedRUE as its two descriptions have it, where other tests have the arm of docs/examples."""

import pytest

from calib import load
from medrue import robot_file


@pytest.fixture(scope="session")
def robot(medrue):
    """With the paper's 36 parameters."""
    return medrue


@pytest.fixture(scope="session")
def extended():
    """With all of its geometry, and the errors of its rail."""
    return load(robot_file("medrue_extended"))

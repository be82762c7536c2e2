"""Speed of the inverse kinematics: 420 poses of MedRUE through the loops. Run with `make bench`."""

import numpy as np
import pytest

import calib
from calib.programs.reaching.goals import Goals
from calib.programs.reaching.inverse import solve
from medrue import robot_file
from medrue.workspace import target_workspace


@pytest.fixture(scope="module")
def robot():
    return calib.load(robot_file())


@pytest.mark.parametrize("kept", ["full pose", "position and axis", "position"])
def test_solve_420_targets(benchmark, robot, kept):
    T = np.array(target_workspace().T_world_tool)
    goals = Goals(
        T[:, :3, 3],
        T[:, :3, :3] if kept == "full pose" else None,
        T[:, :3, 2] if kept == "position and axis" else None,
    )
    solution = benchmark.pedantic(solve, (robot, goals), rounds=3)
    assert solution.ok.all()

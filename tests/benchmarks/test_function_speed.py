"""Speed of exported functions: poses of the calibrated robot in C and numpy. Run with `make bench`.

Each is beside the engine at the same poses; the page docs/howto/robot_as_function.md has the ratios.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from function_robots import ROBOTS, by_name, exported, poses_of_engine, some_conditions

N = 1000


@pytest.mark.parametrize("how", ["engine", "numpy", "c"])
@pytest.mark.parametrize("name", ["six-axis arm, every term", "MedRUE with a rail's terms", "Stewart platform"])
def test_poses_of_1000_commands(benchmark, tmp_path, name, how):
    benchmark.group = name
    robot = ROBOTS[name](tmp_path)
    q, context = robot.sample(N, 3), some_conditions(robot, N)
    if how == "engine":
        benchmark.pedantic(poses_of_engine, (robot, q, context), rounds=3)
        return
    functions = exported(robot, how, tmp_path)
    if how == "c":
        benchmark.pedantic(functions.forward, (q, context), rounds=3)
    else:
        benchmark.pedantic(functions.forward, (q,), by_name(functions, context), rounds=3)

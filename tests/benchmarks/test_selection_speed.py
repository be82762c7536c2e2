"""Speed of choosing poses. Run with `make bench`; each line of the table below is one benchmark.

84 of 420 poses by O1, Jacobians and certificate included      at most 0.3 s
84 of 420 by each of O2 to O5                                  at most 3 s
84 of 100 000 by O1, Jacobians included, in a process          at most 60 s and 3 GB
"""

import json
import subprocess
import sys

import numpy as np
import pytest

import calib
from calib.core.data.in_memory import as_poses
from calib.planning.assessment import check
from calib.planning.selection import select
from medrue import robot_file
from medrue.closed_form_inverse import inverse
from medrue.paper_tables import table1
from medrue.rotations import homogeneous, rotation_x, rotation_y, rotation_z
from medrue.workspace import (
    AXIS_START,
    LEAN_AT_END,
    LEAN_SPREAD,
    LENGTH,
    MIDDLE_ANGLE,
    RADIUS,
    TWIST_SPREAD,
    target_workspace,
)

MANY = 100_000


@pytest.fixture(scope="module")
def robot():
    return calib.load(robot_file())


@pytest.mark.parametrize("index", ["O1", "O2", "O3", "O4", "O5", "task"])
def test_84_of_420(benchmark, robot, index):
    q = np.array(target_workspace().q)
    selection = benchmark.pedantic(select, args=(robot, q, 84, index), rounds=5, warmup_rounds=1)
    benchmark.extra_info["efficiency"] = selection.efficiency
    benchmark.extra_info["choosing alone [s]"] = selection.selecting_seconds


def test_check_of_420(benchmark, robot):
    poses = as_poses(robot, target_workspace().q)
    benchmark.pedantic(check, args=(robot, poses), rounds=3, warmup_rounds=1)


def random_candidates(count):
    """Poses all over the target workspace, with the probe leaning and twisted at random as far as there, (count, 6)."""
    rng = np.random.default_rng(0)
    direction, fraction = MIDDLE_ANGLE + np.pi * (rng.random(count) - 0.5), rng.random(count)
    lean = LEAN_AT_END * (2 * fraction - 1) + LEAN_SPREAD * rng.uniform(-1, 1, count)
    R = rotation_x(direction + np.pi / 2) @ rotation_y(lean) @ rotation_z(TWIST_SPREAD * rng.uniform(-1, 1, count))
    offset = np.stack([LENGTH * fraction, RADIUS * np.cos(direction), RADIUS * np.sin(direction)], axis=1)
    q = inverse(homogeneous(R, np.array(AXIS_START) + offset), table1().nominal)
    return q[np.all(np.isfinite(q), axis=1)]


ONE_RUN = """
import json, resource, sys
import numpy as np
import calib
from calib.planning.selection import select
from medrue import robot_file
found = select(calib.load(robot_file()), np.load(sys.argv[1]), 84, "O1")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1024 if sys.platform == "linux" else 1)
print(json.dumps({"seconds": found.seconds, "efficiency": found.efficiency, "peak [GB]": peak / 1e9}))
"""


def test_84_of_100_000(benchmark, tmp_path):
    np.save(tmp_path / "q.npy", random_candidates(MANY))

    def run():
        done = subprocess.run(
            [sys.executable, "-c", ONE_RUN, tmp_path / "q.npy"], capture_output=True, text=True, check=True, timeout=600
        )
        return json.loads(done.stdout)

    benchmark.extra_info.update(benchmark.pedantic(run, rounds=1))

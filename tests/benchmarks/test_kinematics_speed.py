"""Speed of the kinematics, per pose, split by step. Run with `make bench`.

Times of shared machines mean little on their own: each is also given as a ratio to `pinocchio` alone, one call of
computeJointJacobians per pose on the same model in the same run.
"""

import time

import numpy as np
import pinocchio as pin
import pytest

import calib
from calib.core.robots import kinematics
from calib.core.robots.closure import residual
from calib.core.rows.jacobian import linearise, origin_jacobian
from medrue import robot_file
from medrue.paper_tables import table1
from medrue.workspace import target_workspace

N = 420


@pytest.fixture(scope="module")
def case():
    """MedRUE's 420 poses, assembled at nominal; then the parameters move by a tenth of Table I's errors."""
    robot = calib.load(robot_file())
    q = np.array(target_workspace().q)
    moved = robot.with_parameters(robot.values + 0.1 * (table1().actual - robot.values))
    return moved, q, robot.assemble(q).passive, moved.assemble(q)


@pytest.fixture(scope="module")
def reference(case):
    """Seconds for one computeJointJacobians per pose: the unit of the ratios."""
    moved, q, _, solved = case
    model = moved.mechanism.model
    data = model.createData()
    joints = moved.mechanism.all_joints(q, solved.passive)

    def once():
        start = time.perf_counter()
        for row in joints:
            pin.computeJointJacobians(model, data, row)
        return time.perf_counter() - start

    return min(once() for _ in range(20))


def record(benchmark, reference, function):
    benchmark(function)
    if benchmark.stats is None:  # benchmarks are switched off: the call itself was the test
        return
    best = benchmark.stats.stats.min
    benchmark.extra_info["us_per_pose"] = round(1e6 * best / N, 2)
    benchmark.extra_info["ratio_to_pinocchio"] = round(best / reference, 1)
    print(f"\n{benchmark.name}: {1e6 * best / N:.1f} us a pose, {best / reference:.1f} x pinocchio alone")


def test_closure_warm_positions_and_full_jacobian(benchmark, reference, case):
    moved, q, seed, _ = case

    def everything():
        return linearise(moved, moved.assemble(q, seed=seed))

    record(benchmark, reference, everything)


def test_step_closure_warm(benchmark, reference, case):
    moved, q, seed, _ = case
    record(benchmark, reference, lambda: moved.assemble(q, seed=seed))


def test_step_one_newton_evaluation(benchmark, reference, case):
    moved, q, _, solved = case
    record(benchmark, reference, lambda: residual(moved.mechanism, q, solved.passive))


def test_step_positions_and_36_columns(benchmark, reference, case):
    moved, _, _, solved = case
    record(benchmark, reference, lambda: linearise(moved, solved))


def test_step_positions_and_all_origins(benchmark, reference, case):
    moved, _, _, solved = case
    record(benchmark, reference, lambda: origin_jacobian(moved.mechanism, solved))


def test_step_sweep(benchmark, reference, case):
    moved, q, _, solved = case
    mechanism = moved.mechanism
    joints = mechanism.all_joints(q, solved.passive)
    pairs = mechanism.targets + mechanism.loops
    record(benchmark, reference, lambda: kinematics.sweep(mechanism, joints, pairs))


def test_closure_cold(benchmark, reference, case):
    moved, q, _, _ = case
    record(benchmark, reference, lambda: moved.assemble(q))

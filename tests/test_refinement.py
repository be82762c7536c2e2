"""Poses off the grid: better, and never outside of what is allowed."""

import pickle
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest
from small_robots import small_arm

import calib
from calib.core.robots.terms.term import Context
from calib.planning.refinement import refine, region_of
from calib.planning.selection import select
from calib.planning.selection_problem import TASK, build_problem
from calib.planning.selection_scores import values_of_rows
from medrue.workspace import target_workspace

Q = target_workspace().q


@pytest.fixture(scope="module")
def moved(medrue):
    return select(medrue, Q[::3], 12, "O1", off_grid=True, seed=1)


def test_it_beats_every_choice_from_the_grid(moved):
    assert moved.off_grid
    assert moved.after["O1"] > moved.bound > moved.on_grid["O1"]
    assert moved.after["O1"] > 1.2 * moved.on_grid["O1"]


def test_the_poses_are_what_is_told_of_them(medrue, moved):
    np.testing.assert_allclose(medrue.positions(moved.joints), moved.positions, atol=1e-12)
    again = select(medrue, moved.joints, 12, "O1")
    assert again.after["O1"] == pytest.approx(moved.after["O1"], rel=1e-9)


def test_the_poses_stay_within_limits_and_range_of_the_candidates(medrue, moved):
    joints = {joint.name: joint for joint in medrue.urdf.joints}
    for k, name in enumerate(medrue.joint_names):
        assert moved.joints[:, k].min() >= max(joints[name].lower, Q[::3, k].min())
        assert moved.joints[:, k].max() <= min(joints[name].upper, Q[::3, k].max())
    points = medrue.positions(Q[::3])[:, 0]
    assert np.all(moved.positions[:, 0] >= points.min(axis=0) - 1e-8)
    assert np.all(moved.positions[:, 0] <= points.max(axis=0) + 1e-8)


def test_the_poses_close_away_from_singularities(medrue, moved):
    closed = medrue.close(moved.joints)
    assert closed.ok.all()
    assert medrue.singular_values(medrue.assemble(moved.joints)).min() >= medrue.description.singularity_limit


def test_the_poses_keep_the_distance_of_the_candidates(medrue, moved):
    def smallest(points):
        return (np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))).min()

    assert moved.distance == pytest.approx(smallest(medrue.positions(Q[::3])[:, 0]), rel=1e-9)
    assert smallest(moved.positions[:, 0]) >= moved.distance


@pytest.mark.parametrize("index", ["O3", "O5", TASK])
def test_any_index_can_be_refined(tmp_path, index):
    arm = small_arm(tmp_path)
    q = np.random.default_rng(0).uniform([-2, 0.1, -2], [2, 0.9, 2], (40, 3))
    selection = select(arm, q, 10, index, off_grid=True, sigma=1e-4)
    ratio = selection.after[index] / selection.on_grid[index]
    assert ratio < 0.999 if index == TASK else ratio > 1.001


def test_a_region_of_one_point_leaves_the_poses_where_they_are(medrue):
    q = Q[::30]
    rows = np.random.default_rng(0).standard_normal((len(q), 3, int(np.sum(medrue.is_free))))
    problem = build_problem(rows)
    positions = medrue.positions(q)
    region = region_of(medrue, q[:1], positions[:1])
    neutral = Context.neutral(1, q.shape[1])
    refined = refine(medrue, problem, "O1", q[:1], neutral, region, np.random.default_rng(0))
    np.testing.assert_array_equal(refined.joints, q[:1])
    assert values_of_rows(problem, refined.rows, 1.0)["O1"] == 0  # one pose cannot determine 28 parameters


def test_poses_off_a_surface_of_candidates_stay_near_it(medrue, moved):
    """The half cylinder's poses lie 150 mm from the leg's axis; moved ones stay as near as candidates to each other."""
    points = medrue.positions(Q[::3])[:, 0]
    gaps = np.linalg.norm(points[:, None] - points, axis=2) + np.diag(np.full(len(points), np.inf))
    nearest = np.linalg.norm(moved.positions - points, axis=2).min(axis=1)  # (12, 1, 3) - (140, 3)
    assert nearest.max() > 1e-3
    assert nearest.max() <= np.percentile(gaps.min(axis=0), 95) * (1 + 1e-6)


class Posting(Executor):
    """Sends work as to another computer, and loses every fifth piece of it on the way."""

    def __init__(self):
        self.sent = 0

    def submit(self, function, /, *arguments, **named):
        future, self.sent = Future(), self.sent + 1
        if self.sent % 5 == 0:
            future.set_exception(ConnectionError("the line broke"))
        else:
            function, arguments = pickle.loads(pickle.dumps((function, arguments)))
            future.set_result(pickle.loads(pickle.dumps(function(*arguments, **named))))
        return future


def test_numbers_do_not_depend_on_who_works(tmp_path, monkeypatch):
    monkeypatch.setattr("calib.planning.refinement._CHUNK", 30)
    arm, told = small_arm(tmp_path), []
    q = np.random.default_rng(0).uniform([-2, 0.1, -2], [2, 0.9, 2], (30, 3))
    given = {"count": 6, "off_grid": True, "starts": 3, "sigma": 1e-4}
    alone = select(arm, q, **given, progress=lambda done, total: told.append((done, total)))
    assert told[:3] == [(1, 3), (2, 3), (3, 3)]
    assert told[-1] == (6, 6)
    posting = Posting()
    with ThreadPoolExecutor(2) as threads:
        for executor in (posting, threads):
            shared = select(arm, q, **given, executor=executor)
            np.testing.assert_array_equal(shared.joints, alone.joints)
            assert shared.after == alone.after
            assert [run.history for run in shared.runs] == [run.history for run in alone.runs]
    assert posting.sent > 20


def test_no_process_at_all_cannot_choose(tmp_path):
    with pytest.raises(calib.InputError, match="executor 0: must be an executor"):
        select(small_arm(tmp_path), np.zeros((3, 3)), 2, executor=0)

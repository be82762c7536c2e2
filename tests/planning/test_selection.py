"""Choosing MedRUE's poses: certified, complementing what is measured, within what is asked for."""

import errno
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.base.errors import InputError
from calib.core.data.in_memory import as_poses
from calib.core.numerics.observability import observability
from calib.core.robots.jacobian import linearise
from calib.planning.instrument_choice import groups_of, pairs_of
from calib.planning.selection import select
from calib.shared.candidates import build_candidates
from medrue.workspace import target_workspace
from tests.small_robots import ARM_YAML, small_arm, write_arm

Q = target_workspace().q


@pytest.fixture(scope="module")
def by_o1(medrue):
    return select(medrue, Q, 84, "O1")


def singular_values(robot, q, *, raw=False):
    """Of the Jacobian by parameters in units of their sigma [m]; `raw`: in mm per unit of table."""
    scale = [1e3 / p.per_si if raw else p.sigma_si for p in robot.parameters]
    rows = (linearise(robot, robot.assemble(q)).jacobian * scale)[..., robot.is_free]
    return np.linalg.svd(rows.reshape(-1, rows.shape[-1]), compute_uv=False)


def of_index(values, selection):
    """The values of O1 to O5 that a selection tells, of those that are expected."""
    return {name: selection[name] for name in values}


def test_84_of_420_are_certified_to_a_thousandth_and_in_a_short_order(by_o1):
    assert by_o1.travel[1] < 0.6 * by_o1.travel[0]
    assert by_o1.efficiency >= 0.999
    assert by_o1.after["O1"] <= by_o1.bound
    assert by_o1.after["O1"] / by_o1.bound == pytest.approx(by_o1.efficiency, rel=1e-9)


@pytest.mark.quick(1)
@pytest.mark.parametrize("index", ["O1", "task"])
def test_screened_candidates_give_the_choice_of_all_and_are_in_the_bound(medrue, monkeypatch, index):
    of_all = select(medrue, Q, 40, index, exclude=[3], starts=2, seed=4)
    monkeypatch.setattr("calib.planning.selection.SCREENED", 100)
    monkeypatch.setattr("calib.planning.selection._SEARCHED", 180)
    monkeypatch.setattr("calib.planning.selection._FOR_EACH", 1)
    screened = select(medrue, Q, 40, index, exclude=[3], starts=2, seed=4)
    assert [run.start for run in screened.runs] == ["uniform", "random", "relaxed", "best"]
    assert len(set(screened.chosen.tolist())) == 40
    assert 3 not in screened.chosen
    assert screened.after[index] == pytest.approx(of_all.after[index], rel=2e-3)  # both within their certificates
    assert (screened.bound - of_all.after[index]) * (1 if index == "O1" else -1) >= 0
    assert of_all.efficiency - 2e-3 < screened.efficiency <= 1


@pytest.mark.quick(0)
def test_o2_has_no_bound_and_is_not_screened(medrue, monkeypatch):
    of_all = select(medrue, Q[::3], 30, "O2")
    monkeypatch.setattr("calib.planning.selection.SCREENED", 10)
    assert np.array_equal(select(medrue, Q[::3], 30, "O2").chosen, of_all.chosen)


def test_the_chosen_poses_have_the_indices_that_are_told(medrue, by_o1):
    assert len(set(by_o1.chosen.tolist())) == 84
    np.testing.assert_array_equal(by_o1.joints, Q[by_o1.chosen])
    np.testing.assert_allclose(by_o1.positions, medrue.positions(by_o1.joints), atol=1e-12)
    raw = observability(singular_values(medrue, by_o1.joints, raw=True), 84)
    assert by_o1.raw == pytest.approx(raw, rel=1e-9)
    for told, q in ((by_o1.after, by_o1.joints), (by_o1.before, Q[2::5])):
        expected = observability(singular_values(medrue, q), 84)
        assert of_index(expected, told) == pytest.approx(expected, rel=1e-9)


def test_the_history_is_the_papers_figure_4(by_o1):
    run = by_o1.runs[0]
    assert run.start == "uniform"
    assert run.history[0] == pytest.approx(by_o1.before["O1"], rel=1e-9)
    assert np.all(np.diff(run.history) > 0)
    assert len(run.history) == len(run.exchanges) + 1 > run.n_paper > 20


@pytest.mark.quick(1)
@pytest.mark.parametrize("index", ["O2", "O3", "O4", "O5", "task"])
def test_each_index_is_best_where_it_was_asked_for(medrue, index):
    by_o1, selection = (select(medrue, Q[::2], 42, name) for name in ("O1", index))
    better = np.less if index == "task" else np.greater
    assert better(selection.after[index], by_o1.after[index])
    assert better(selection.after[index], selection.before[index])
    if index == "task":
        assert selection.efficiency > 0.99
        assert selection.bound <= selection.after["task"]
    else:
        assert selection.efficiency is None
        assert selection.bound is None


@pytest.mark.quick(0)
def test_the_same_seed_gives_the_same_poses(medrue):
    first, second = (select(medrue, Q[::4], 30, "O3", random_start=True, starts=2, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.chosen, second.chosen)
    assert [run.start for run in first.runs] == ["random", "random"]
    other = select(medrue, Q[::4], 30, "O3", random_start=True, seed=6)
    assert other.runs[0].history != first.runs[0].history


@pytest.mark.quick(0)
def test_excluded_candidates_are_never_chosen(medrue, by_o1):
    out = by_o1.chosen[:20]
    selection = select(medrue, Q, 84, "O1", exclude=out.tolist())
    assert not set(out.tolist()) & set(selection.chosen.tolist())
    assert selection.after["O1"] < by_o1.after["O1"]
    with pytest.raises(calib.InputError, match="no candidate 420"):
        select(medrue, Q, 84, "O1", exclude=[420])


@pytest.mark.quick(0)
def test_chosen_poses_keep_their_distance_also_from_measured_ones(medrue):
    measured = Q[::40]
    selection = select(medrue, Q, 30, "O1", measured=measured, minimum_distance=0.06)
    points = np.vstack([selection.positions[:, 0], medrue.positions(measured)[:, 0]])
    gaps = np.linalg.norm(points[:30, None] - points[None], axis=2)
    gaps[np.arange(30), np.arange(30)] = 1.0
    assert gaps.min() >= 0.06
    with pytest.raises(calib.InputError, match="keep 300 mm from each other"):
        select(medrue, Q, 84, "O1", minimum_distance=0.3)


@pytest.mark.quick(0)
def test_poses_to_add_complement_those_measured(medrue):
    """All indices are those of measured and chosen poses together, and measured ones are not chosen again."""
    measured = Q[:60]
    selection = select(medrue, Q, 24, "O1", measured=measured)
    assert selection.already_measured == 60
    assert not set(selection.chosen.tolist()) & set(range(60))
    together = observability(singular_values(medrue, np.vstack([measured, selection.joints])), 84)
    assert of_index(together, selection.after) == pytest.approx(together, rel=1e-9)
    alone = observability(singular_values(medrue, measured), 60)
    assert of_index(alone, selection.measured_only) == pytest.approx(alone, rel=1e-7)
    blind = select(medrue, Q, 24, "O1", exclude=range(60))
    blindly = observability(singular_values(medrue, np.vstack([measured, blind.joints])), 84)
    assert selection.after["O1"] > 1.01 * blindly["O1"]


@pytest.mark.quick(0)
def test_the_task_index_is_about_the_task_poses(medrue):
    corner = Q[:28]
    there, everywhere = select(medrue, Q, 40, "task", task=corner), select(medrue, Q, 40, "task")
    compared = select(medrue, Q, 40, "O1", task=corner)
    assert there.after["task"] < compared.after["task"]
    assert set(there.chosen.tolist()) != set(everywhere.chosen.tolist())


def test_a_robot_with_priors_is_chosen_for_on_the_stacked_rows(tmp_path):
    arm = small_arm(tmp_path)
    q = np.random.default_rng(0).uniform([-2, 0.1, -2], [2, 0.9, 2], (60, 3))
    selection = select(arm, q, 10, "O1", sigma=1e-4)
    rows = 1e-4 * build_candidates(arm, as_poses(arm, selection.joints), 1e-4).rows  # whitened by 0.1 mm
    # every parameter has a prior, so what the poses do not see is what it was, and the rest is seen and held
    values = np.linalg.svd(rows.reshape(-1, rows.shape[2]), compute_uv=False)[: selection.rank_of_poses.rank]
    stacked = observability(np.sqrt(values**2 + 1e-4**2), 10)
    assert selection.rank.rank == len(arm.parameters) > selection.rank_of_poses.rank
    assert of_index(stacked, selection.after) == pytest.approx(stacked, rel=1e-9)
    assert selection.efficiency > 0.98
    assert not selection.sigma_assumed
    assert select(arm, q, 10).sigma_assumed


def test_two_targets_are_two_positions(tmp_path):
    more = ARM_YAML.replace("parametrisation:", "  elbow: {frame: slider}\nparametrisation:")
    arm = calib.load(write_arm(tmp_path, more))
    q = np.random.default_rng(0).uniform([-2, 0.1, -2], [2, 0.9, 2], (40, 3))
    selection = select(arm, q, 8, "task", sigma=1e-4)
    assert selection.positions.shape == (8, 2, 3)
    assert selection.efficiency > 0.97


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"index": "O6"}, "unknown index 'O6'; valid: O1, O2"),
        ({"count": 400, "exclude": range(40)}, "400 is above the 380 candidates that can be chosen"),
        ({"sigma": -1.0}, "must be a positive number"),
    ],
)
def test_bad_arguments_are_one_clear_line(medrue, arguments, words):
    with pytest.raises(calib.InputError, match=words):
        select(medrue, Q, **({"count": 84} | arguments))


@pytest.mark.parametrize("use", [lambda robot: select(robot, Q[:0], 3), lambda robot: calib.check(robot, Q[:0])])
def test_no_poses_are_one_clear_line(medrue, use):
    with pytest.raises(calib.DataError, match="there are no poses; give at least one"):
        use(medrue)


def test_poses_next_to_a_singularity_are_named_too(medrue):
    strict = medrue.description.model_copy(update={"singularity_limit": 0.08})
    careful = replace(medrue, description=strict)
    smallest = int(np.argmin(medrue.singular_values(medrue.assemble(Q))))
    with pytest.raises(calib.UnreachablePoseError, match="from a singularity of the loops"):
        select(careful, Q, 84)
    selection = select(careful, Q, 84, skip_unreachable=True)
    assert any(line.startswith(f"pose {smallest}:") for line in selection.skipped)
    assert smallest not in selection.chosen


def test_minimal_count_still_determines_everything(medrue):
    selection = select(medrue, Q, 10, "O1")
    assert selection.after["O3"] > 0
    assert singular_values(medrue, selection.joints)[-1] > 0


@pytest.mark.quick(0)
@pytest.mark.parametrize("index", ["O1", "task"])
def test_candidates_that_do_not_fit_into_memory_go_through_a_file_and_in_parts(medrue, monkeypatch, index):
    inside = select(medrue, Q, 40, index)
    monkeypatch.setattr("calib.core.base.memory.free_memory", lambda: 1e5)
    monkeypatch.setattr("calib.planning.selection_problem._PART", 50)
    rows = build_candidates(medrue, as_poses(medrue, Q))
    assert np.shares_memory(pairs_of(groups_of(medrue, "all", 40), rows).rows, rows.rows)  # no copy in memory either
    monkeypatch.setattr("calib.shared.candidates._PART", 20)
    monkeypatch.setattr("calib.core.numerics.identifiability._AT_ONCE", 50)
    outside = select(medrue, Q, 40, index)
    assert outside.before == pytest.approx(inside.before, rel=1e-9)
    assert outside.after[index] == pytest.approx(inside.after[index], rel=1e-9)
    assert outside.bound == pytest.approx(inside.bound, rel=1e-6)


def test_what_has_no_room_says_where_it_would_have_been(medrue, monkeypatch):
    monkeypatch.setattr("calib.core.base.memory.free_memory", lambda: 1e5)
    with pytest.raises(InputError, match=r"looks at all candidates at once; it needs about .* GB of memory, and"):
        select(medrue, Q[:100], 20, "O3")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("calib.core.base.memory.os.posix_fallocate", full)
    with pytest.raises(InputError, match=r"rows of 100 candidates need .* has only .* free; .* in TMPDIR"):
        select(medrue, Q[:100], 20, "O1")

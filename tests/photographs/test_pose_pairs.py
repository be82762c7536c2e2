"""Hand-eye calibration from pairs of poses, beside a closed form and what is known of set-ups."""

import json

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from calib.core.data.tables import read_table
from calib.photographs.hand_eye_result import Frames
from calib.photographs.pose_pairs import content_of_pairs, judge_pairs, report_pairs, solve_pairs
from calib.photographs.tool_poses import pose_columns, poses_of
from tests.project import write_table


def pose(xyz, rotvec):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), xyz
    return result


CAMERA = {"tool": pose([0.03, -0.06, 0.09], [0.1, -0.2, 1.5]), "base": pose([1.1, 0.2, 0.7], [1.2, -1.3, 1.1])}
MARKER = {"tool": pose([0.7, 0.1, 0.02], [0.1, 0.0, 2.0]), "base": pose([0.01, 0.02, 0.11], [0.3, 0.1, -0.8])}


def pairs(rng, n=14, mount="tool", shift=0.0, turn=0.0, about_z=False):
    """Tool in base, marker in camera, (n, 4, 4); errors of what the camera reads."""
    turned = rng.normal(0, 0.45, (n, 3)) * ([0, 0, 1] if about_z else [1, 1, 1])
    tool = np.array([pose(rng.normal([0.5, 0, 0.5], 0.12), w) for w in turned])
    links = np.linalg.inv(tool) if mount == "tool" else tool
    seen = np.linalg.inv(CAMERA[mount]) @ links @ MARKER[mount]
    error = np.array([pose(np.zeros(3), w) for w in rng.normal(0, turn, (n, 3))])
    seen = seen @ error
    seen[:, :3, 3] += rng.normal(0, shift, (n, 3))
    return tool, seen


NAMES = [f"p{k}" for k in range(14)]


def park(links, seen):
    """AX = XB in closed form (Park and Martin 1994): rotations by vectors of relative turns, then translations."""
    turns, rows = [], []
    for i in range(len(links)):
        for j in range(i):
            a, b = np.linalg.inv(links[j]) @ links[i], seen[j] @ np.linalg.inv(seen[i])
            turns.append([Rotation.from_matrix(m[:3, :3]).as_rotvec() for m in (a, b)])
            rows.append((a, b))
    of_a, of_b = np.array(turns).transpose(1, 0, 2)
    rotation, _ = Rotation.align_vectors(of_a, of_b)
    left = np.vstack([a[:3, :3] - np.eye(3) for a, _ in rows])
    right = np.hstack([rotation.apply(b[:3, 3]) - a[:3, 3] for a, b in rows])
    return rotation.as_matrix(), np.linalg.lstsq(left, right, rcond=None)[0]


def apart(found, rotation, position):
    """How far a place that was found is from another one, (6,) [m, rad]."""
    turned = Rotation.from_matrix(found.pose[:3, :3].T @ rotation).as_rotvec()
    return np.abs(np.hstack([found.pose[:3, 3] - position, turned]))


@pytest.mark.parametrize("mount", ["tool", "base"])
def test_both_mounts_are_found_as_a_closed_form_finds_them(mount):
    tool, seen = pairs(np.random.default_rng(3), mount=mount, shift=3e-4, turn=1e-3)
    result = solve_pairs(NAMES, tool, seen)
    assert result.mount == mount
    assert judge_pairs(result).grade == "PASS", judge_pairs(result)
    assert "noise and priors" in content_of_pairs(result, Frames())["contains"]["position"]
    links = tool if mount == "tool" else np.linalg.inv(tool)
    assert np.all(apart(result.camera, *park(links, seen)) < 2 * result.camera.half)  # other weights than here
    world, half = MARKER[mount], result.marker.half
    assert np.all(apart(result.marker, world[:3, :3], world[:3, 3]) < 2 * half)


@pytest.mark.quick(0)
@pytest.mark.amount(8, 60)
def test_intervals_hold_what_is_true(amount):
    inside = []
    for seed in range(amount):
        mount = ("tool", "base")[seed % 2]
        tool, seen = pairs(np.random.default_rng(seed), mount=mount, shift=3e-4, turn=1e-3)
        result = solve_pairs(NAMES, tool, seen, (mount,))
        for found, true in ((result.camera, CAMERA[mount]), (result.marker, MARKER[mount])):
            inside += list(apart(found, true[:3, :3], true[:3, 3]) < found.half)
    least = scipy.stats.binom.ppf(1e-4, amount * 4, 0.95) / (amount * 4)  # of the 12 of a draw, some 4 are independent
    assert np.mean(inside) > least, np.mean(inside)


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_what_parallel_axes_leave_open_is_named_and_the_rest_is_found(seed):
    tool, seen = pairs(np.random.default_rng(seed), about_z=True, shift=2e-4, turn=5e-4)
    result = solve_pairs(NAMES, tool, seen)
    assert result.mount == "tool"
    assert result.camera.open.tolist() == [False, False, True, False, False, False]
    assert result.marker.open.tolist() == result.camera.open.tolist()
    known = ~result.camera.open
    half = result.camera.half[known]
    assert np.all(apart(result.camera, CAMERA["tool"][:3, :3], CAMERA["tool"][:3, 3])[known] < 1.5 * half)
    assert np.all(half < 1e-3)  # of 14 pairs with errors of 0.2 mm and 0.5 mrad
    (change,) = result.unseen
    assert change in ("camera z +1 mm, marker z +1 mm", "camera z -1 mm, marker z -1 mm")
    assert "z not determined" in report_pairs(result, Frames())
    assert judge_pairs(result).grade == "FAIL"


@pytest.mark.quick(0)
def test_inverted_poses_and_doubtful_mounts_are_named():
    tool, seen = pairs(np.random.default_rng(7), shift=2e-4, turn=5e-4)
    judgement = judge_pairs(solve_pairs(NAMES, tool, np.linalg.inv(seen), ("tool",)))
    assert judgement.grade == "FAIL"
    assert "poses of the camera in the marker" in judgement.reasons[0]


@pytest.mark.quick(0)
def test_a_real_four_axis_robot_leaves_a_height_open(shared_data):
    table = read_table(shared_data / "scara_handeye_4dof" / "poses.csv")
    tool, seen = (poses_of(table, place) for place in pose_columns(table).values())
    result = solve_pairs(table.text(table.names[0]), tool, seen)
    assert result.mount == "tool"
    assert result.camera.open.tolist() == [False, False, True, False, False, False]
    assert np.allclose(result.camera.pose[:2, 3], [-0.45681, 0.00350], atol=2e-4)  # by scipy's least_squares


def written(folder, form, tool, seen):
    """Pairs as people keep them."""
    quaternions = [np.hstack([m[:, :3, 3], Rotation.from_matrix(m[:, :3, :3]).as_quat()]) for m in (tool, seen)]
    if form == "two files":
        for name, cells in zip(("tool", "marker"), quaternions, strict=True):
            write_table(folder / f"{name}.csv", "pose,x [m],y [m],z [m],qx,qy,qz,qw", NAMES[: len(cells)], cells)
        return ["marker.csv", "--poses", "tool.csv"]
    if form == "one file":
        header = [f"{name}_{end}" for name in ("gripper", "target") for end in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        write_table(folder / "both.csv", header, *quaternions)
        return ["both.csv"]
    if form == "opencv":
        arrays = {
            "R_gripper2base": tool[:, :3, :3], "t_gripper2base": tool[:, :3, 3:],
            "R_target2cam": seen[:, :3, :3], "t_target2cam": seen[:, :3, 3:],
        }  # fmt: skip
        np.savez(folder / "a.npz", **arrays)
        return ["a.npz"]
    np.savez(folder / "b.npz", base_to_tool=tool, camera_to_marker=seen)
    return ["b.npz"]


@pytest.mark.parametrize("form", ["two files", "one file", "opencv", "matrices"])
def test_pairs_are_read_as_people_keep_them(tmp_path, run_calib, form):
    tool, seen = pairs(np.random.default_rng(11), n=10)
    result = run_calib("hand-eye", *written(tmp_path, form, tool, seen), "--out", "he", cwd=tmp_path)
    assert result.code == 0, result.out + result.err
    data = json.loads((tmp_path / "he" / "hand_eye.json").read_text())
    assert data["camera_on"] == "tool"
    errors = [pair["position_m"] + pair["rotation_rad"] for pair in data["pairs"]]
    assert np.allclose(errors, np.zeros((10, 6)), rtol=0, atol=1e-7)
    assert np.allclose(data["camera"]["matrix"], CAMERA["tool"], atol=1e-8)
    assert np.allclose(np.loadtxt(tmp_path / "he" / "camera_matrix.txt"), CAMERA["tool"], atol=1e-8)
    assert "static_transform.sh" in result.out + result.err


def test_poses_that_are_no_pairs_say_what_is_missing(tmp_path, run_calib):
    written(tmp_path, "two files", *pairs(np.random.default_rng(11), n=10))
    (tmp_path / "d.csv").write_text("pose,point,camera_u,camera_v\na,c0,1,2\n")
    for given, said in (
        (("marker.csv",), "give the poses of the tool with --poses"),
        (("d.csv", "--poses", "tool.csv"), "give the board with --board"),
    ):
        assert said in run_calib("hand-eye", *given, "--out", "he", cwd=tmp_path).refusal()

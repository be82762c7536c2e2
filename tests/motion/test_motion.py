"""Scenes, moves and routes: what is free is free by MuJoCo, too, which shares no code with the engine's shapes."""

import csv
import io
import itertools
import json
import re
from importlib.util import find_spec

import numpy as np
import pytest
import trimesh

import calib
from calib.core.base.errors import DescriptionError, InputError
from calib.core.data.in_memory import as_poses
from calib.core.data.measurement_files import read_poses
from calib.motion.planner import Planner, check_move
from calib.motion.poses import surroundings
from calib.motion.programs import LANGUAGES, Motion, write_program
from calib.motion.route import plan_route
from calib.programs.languages.languages import read_program
from calib.shared.pose_check import check_poses
from tests.project import EXAMPLES, copied, write_table
from tests.six_axis_arm import FREE, URDF, YAML
from tests.urdf_trees import plain, urdf_of
from viz.inputs import gather
from viz.scene_data import scene_data

mujoco = pytest.importorskip("mujoco", reason="extra 'mujoco'")

needs_ompl = pytest.mark.skipif(find_spec("ompl") is None, reason="ways around things need OMPL")

_LINKS = {
    "l0": ("0.08", "0.4", "0 0 0.2"),
    "l1": ("0.07", "0.1", "0.02 0 0.05"),
    "l2": ("0.05", "0.5", "0 0 0.3"),
    "l3": ("0.05", "0.2", "0.05 0 0.05"),
    "l4": ("0.04", "0.3", "0.2 0 0"),
    "l5": ("0.04", "0.08", "0.05 0 0"),
    "l6": ("0.03", "0.06", "0 0 0"),
}
_LYING = ("l4", "l5", "l6")
_BOXES = {"table": ((0.5, 0.8, 0.05), (0.6, 0.0, 0.3)), "post": ((0.06, 0.06, 1.2), (-0.4, 0.3, 0.6))}


def _shaped(boxes=()):
    """The arm with cylinders; boxes as further links."""
    text = URDF
    for name, (radius, length, xyz) in _LINKS.items():
        turned = 'rpy="0 1.5707963267948966 0"' if name in _LYING else ""
        shape = f'<collision><origin xyz="{xyz}" {turned}/><geometry><cylinder radius="{radius}" length="{length}"/>'
        text = text.replace(f'<link name="{name}"/>', f'<link name="{name}">{shape}</geometry></collision></link>')
    for name, (size, xyz) in dict(boxes).items():
        size, xyz = (" ".join(map(str, numbers)) for numbers in (size, xyz))
        shape = f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision>'
        joint = f'<joint name="{name}_j" type="fixed"><parent link="l0"/><child link="{name}"/></joint>'
        text = text.replace("</robot>", f'<link name="{name}">{shape}</link>{joint}</robot>')
    return text


def _obstacles(clearance="10 mm", boxes=_BOXES):
    return "obstacles:\n" + "".join(
        f"  {name}: {{box: {list(size)}, xyz: {list(xyz)}, clearance: {clearance}}}\n"
        for name, (size, xyz) in boxes.items()
    )


def _write(folder, more="", urdf=None):
    (folder / "arm.urdf").write_text(_shaped() if urdf is None else urdf)
    (folder / "arm.yaml").write_text(YAML + FREE + "sigma: 0.05 mm\n" + more)
    return folder / "arm.yaml"


def _names(scene):
    """Pairs of bodies that a scene looks at."""
    return [scene.name(k) for k in range(len(scene.pairs))]


def _table(path, *rows):
    """A table of poses: name and joint values of each."""
    return write_table(path, "pose,j1,j2,j3,j4,j5,j6", [name for name, *_ in rows], [q for _, q in rows])


class _MuJoCo:
    """Contacts between links that no joint connects, and with boxes; MuJoCo reads the URDF itself."""

    def __init__(self, boxes):
        self.model = mujoco.MjModel.from_xml_string(_shaped(boxes))
        self.data = mujoco.MjData(self.model)

    def touches(self, q):
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return any(contact.dist < 0 and self._counts(*contact.geom) for contact in self.data.contact)

    def _counts(self, *geoms):
        bodies = [int(self.model.geom_bodyid[geom]) for geom in geoms]
        of_world = [geom for geom, body in zip(geoms, bodies, strict=True) if body == 0]
        if of_world and of_world[0] > 0:  # a box: the base's cylinder comes first
            return True
        return abs(bodies[0] - bodies[1]) > 1


def test_free_is_what_mujoco_finds_free(tmp_path):
    robot = calib.load(_write(tmp_path, _obstacles("0 mm") + "self_clearance: 0 mm\n"))
    q, checker = robot.sample(400, 3), _MuJoCo(_BOXES)
    theirs, ours = np.array([checker.touches(row) for row in q]), ~check_poses(robot, q).is_free
    assert 0.1 < theirs.mean() < 0.9
    assert np.mean(ours != theirs) <= 0.01  # 1 %: contacts by less than what both round


@pytest.mark.quick(0)
@needs_ompl
@pytest.mark.parametrize("n_poses", [6, pytest.param(60, marks=pytest.mark.amount(0, 1))])
def test_no_contact_anywhere_on_a_route(route, n_poses):
    if n_poses > 6:
        route = plan_route(route.robot, calib.sample(route.robot, n_poses, 1))
    checker, reach = _MuJoCo(_BOXES), 1.8  # [m] the arm's, so 4 mm a step: half a clearance is more, on both sides
    assert len(route.stops) > n_poses / 2
    assert all(why.startswith("no free way leads there") for why in route.left_out.values())
    corners = route.corners()
    for one, other in itertools.pairwise(corners):
        for part in np.linspace(0, 1, 2 + int(reach * np.sum(np.abs(other - one)) / 0.004)):
            assert not checker.touches(one + part * (other - one))
    assert all(stop.clearance > 0.005 for stop in route.stops)


PLATE = {"plate": ((0.5, 0.001, 0.5), (0.75, 0.0, 1.1))}


@needs_ompl
def test_a_way_that_is_searched_from_a_nearer_pose_begins_at_the_start(tmp_path):
    robot = calib.load(_write(tmp_path, _obstacles("1 mm", PLATE)))
    nodes = np.array([-0.7, -0.4, 0.5])[:, None] * np.eye(6)[0]  # the plate is at 0, and the second is nearer
    planner = Planner(surroundings(robot).scene, nodes, robot.joint_limits, 0)
    assert len(planner.free_path(0, 1)) == 2  # from now on this move is known to be free
    way = planner.free_path(0, 2)
    np.testing.assert_array_equal(way[[0, -1]], nodes[[0, 2]])
    assert not any(planner.move(one, other).hit for one, other in itertools.pairwise(way))


def test_a_plate_between_two_free_poses_is_not_missed(tmp_path):
    scene = surroundings(calib.load(_write(tmp_path, _obstacles("1 mm", PLATE)))).scene
    one, other = np.array([-0.5, 0, 0, 0, 0, 0]), np.array([0.5, 0, 0, 0, 0, 0])
    assert scene.hits(np.array([one, other])) == ("", "")
    assert "plate" in check_move(scene, one, other).hit
    assert check_move(scene, one, np.array([-0.7, 0, 0, 0, 0, 0])).hit == ""


def test_no_pair_comes_nearer_than_the_bound_says(tmp_path):
    scene = surroundings(calib.load(_write(tmp_path, _obstacles()))).scene
    generator = np.random.default_rng(0)
    q = generator.uniform(-2, 2, (40, 6))
    moved = q + generator.uniform(-0.3, 0.3, q.shape)
    (before, _), (after, _) = scene.configurations(q), scene.configurations(moved)
    bound = np.abs(after - before) @ scene.reach(np.zeros(before.shape[1])).T
    change = np.abs(scene.distances(after) - scene.distances(before))
    apart = (scene.distances(before) + scene.margins > 0) & (scene.distances(after) + scene.margins > 0)
    assert np.all((change <= bound + 1e-6)[apart])
    assert np.max((change / bound)[apart]) > 0.2  # it is no bound that says nothing


def test_a_shape_inside_a_hollow_mesh_hits(tmp_path):
    hollow = trimesh.creation.annulus(0.5, 0.6, 1.0)  # a tube, whose hull has no hole
    hollow.export(tmp_path / "tube.stl")
    around = "obstacles:\n  tube: {mesh: tube.stl, frame: l0, xyz: [0.4 m, 0, 1.1 m], clearance: 0 mm}\n"
    ball = "  bead: {sphere: 20 mm, frame: l6, xyz: [50 mm, 0, 0]}\n"
    scene = surroundings(calib.load(_write(tmp_path, around + ball))).scene
    apart = scene.distances(scene.configurations(np.zeros((1, 6)))[0])[0]
    assert apart[_names(scene).index("tube - bead")] > 0.05  # in the hole: free
    trimesh.creation.box((1.0, 1.0, 1.0)).subdivide().export(tmp_path / "tube.stl")
    solid = surroundings(calib.load(tmp_path / "arm.yaml")).scene
    apart = solid.distances(solid.configurations(np.zeros((1, 6)))[0])[0]
    assert apart[_names(solid).index("tube - bead")] <= 0


@pytest.fixture(scope="module")
def route(tmp_path_factory):
    pytest.importorskip("ompl")
    robot = calib.load(_write(tmp_path_factory.mktemp("route"), _obstacles()))
    return plan_route(robot, calib.sample(robot, 6, 5))


def test_a_touch_is_approached_and_left_along_the_normal_of_its_surface(tmp_path, run_calib):
    touch = "instruments:\n  probe: {kind: touch, target: ball, surface: plane, radius: 3 mm, places: {wall: "
    place = "{frame: l0, xyz: [0.6 m, 0, 0.9 m], rpy: [0, -90 deg, 0]}}}\n"
    path = _write(tmp_path, touch + place + "self_clearance: 0 mm\n")
    assert run_calib("sample", path, "--count", 3, "--seed", 2, "--out", tmp_path / "poses.csv").code == 0
    assert run_calib("route", path, tmp_path / "poses.csv", "--out", tmp_path / "route").code == 0
    rows = [row.split(",") for row in (tmp_path / "route" / "route.csv").read_text().splitlines()[2:]]
    mjc, balls = _MuJoCo(()), []
    for row in rows:
        mjc.data.qpos[:] = np.radians(np.array(row[1:7], dtype=float))
        mujoco.mj_kinematics(mjc.model, mjc.data)
        link = mjc.model.body("l6").id
        balls.append(mjc.data.xpos[link] + mjc.data.xmat[link].reshape(3, 3) @ [0.05, 0.02, 0.1])
    stops = [k for k, row in enumerate(rows) if "via" not in row[0]]
    assert len(stops) >= 2
    for k in stops:
        assert balls[k][0] == pytest.approx(0.6 - 0.003, abs=1e-6)
        for beside in (k - 1, k + 1) if k < stops[-1] else (k - 1,):
            np.testing.assert_allclose(balls[beside] - balls[k], [-0.05, 0, 0], atol=1e-6)


def test_a_pose_that_only_a_joint_turned_round_reaches_is_visited_so_and_said(tmp_path):
    wall = {"wall": ((0.04, 4.0, 4.0), (-0.4, 0.0, 1.0))}  # behind the robot: it turns round to both sides, not through
    turning = _shaped().replace('lower="-3" upper="3"', 'lower="-5.5" upper="5.5"', 1)
    robot = calib.load(_write(tmp_path, _obstacles("1 mm", wall), turning))
    stretched = np.array([[-5.2, 1.2, 0.2, 0, 0, 0], [0.5, 1.2, 0.2, 0, 0, 0]])
    route = plan_route(robot, as_poses(robot, stretched, ["round", "straight"]), start=np.array([0.4, 1.0, 0, 0, 0, 0]))
    visited = {stop.name: stop.joints for stop in route.stops}
    np.testing.assert_allclose(visited["round"], stretched[0] + 2 * np.pi * np.eye(6)[0])
    np.testing.assert_array_equal(visited["straight"], stretched[1])
    assert any("whole turn" in remark and "round" in remark for remark in route.remarks)


def test_what_cannot_be_visited_is_replaced_by_the_next_best_and_nothing_else_is(tmp_path):
    robot = calib.load(_write(tmp_path, _obstacles()))
    free = [[0.1 * k, -0.1 * k, 0.2, 0.1, 0.3, 0.05 * k] for k in range(1, 6)]
    candidates = as_poses(robot, np.array([*free, [0, 2.5, 0, 0, 0, 0]]), ["a", "b", "c", "d", "e", "low"])
    plan = plan_route(robot, candidates.subset(np.array([0, 1])), candidates=candidates)
    assert (plan.left_out, plan.replaced, len(plan.stops)) == ({}, (), 2)
    plan = plan_route(robot, candidates.subset(np.array([0, 1, 5])), candidates=candidates)
    assert set(plan.left_out) == {"low"}
    assert len(plan.stops) == 3
    assert len(plan.replaced) == 1
    assert set(plan.replaced) <= {"c", "d", "e"}
    plan = plan_route(robot, candidates.subset(np.array([0, 5])), candidates=candidates.subset(np.array([0, 5])))
    said = "1 pose left out without a replacement: 0 free candidates were tried, and 0 are left"
    assert said in plan.remarks


_FIRST_MOVE = {"urscript": "movej", "rapid": "MoveAbsJ", "krl": "PTP {", "fanuc": "J P[1]"}
_CONFIRM = {"urscript": "popup(", "rapid": "Stop;", "krl": "HALT", "fanuc": "PAUSE"}


@pytest.mark.parametrize("language", _FIRST_MOVE)
def test_programs_ask_before_anything_moves_name_the_poses_and_are_read_back(route, language, tmp_path):
    text = write_program(route, language, Motion("plan"))
    assert 0 < text.index(_CONFIRM[language]) < text.index(_FIRST_MOVE[language])
    for stop in route.stops:
        assert f"pose {stop.name}, clearance {int(1e3 * stop.clearance)} mm" in text
    path = tmp_path / f"plan{LANGUAGES[language].suffix}"
    path.write_text(text)
    program = read_program(path)
    assert not program.left_out
    np.testing.assert_allclose([target.values for target in program.targets], route.corners()[1:], atol=1e-6)


def test_rapid_gets_speeds_as_numbers_since_it_has_no_name_for_most(route):
    """ABB's manual of RAPID: v200 and v300 are predefined, [v_tcp, 500, 5000, 1000]; v250 is not."""
    text = write_program(route, "rapid", Motion("plan", speed=0.25))
    assert text.count("]], [250, 500, 5000, 1000], fine, tool0;") == text.count("MoveAbsJ")


def test_a_third_joint_that_is_counted_from_the_second_link_is_written_as_fanuc_counts_it(route):
    assert "BAS(#VEL_PTP, 1)" in write_program(route, "krl", Motion("plan", speed=0.001))  # 0 % is no speed
    text = write_program(route, "fanuc", Motion("plan", third_joint="j2+j3"))
    moves = re.findall(r"UT : 1,([^}]*)\}", text)
    values = [[float(v) for v in re.findall(r"= (-?\d+\.\d+) deg", move)] for move in moves]
    expected = np.degrees(route.corners()[1:])
    expected[:, 2] -= expected[:, 1]
    np.testing.assert_allclose(values, expected, atol=1e-6)


def test_a_trajectory_of_ros_is_at_rest_at_every_stop(route):
    content = json.loads(write_program(route, "ros2", Motion("plan", dwell=0.5, reading=2.0)))
    starts = [point["time_from_start"] for point in content["points"]]
    times = [start["sec"] + 1e-9 * start["nanosec"] for start in starts]
    assert content["joint_names"] == list(route.robot.joint_names)
    assert np.all(np.diff(times) > 0)
    for stop, planned in zip(content["stops"], route.stops, strict=True):
        at = [k for k, time in enumerate(times) if abs(time - stop["arrival_s"]) < 1e-3]
        assert content["points"][at[0]]["positions"] == planned.joints.tolist()
        assert content["points"][at[0] + 1]["positions"] == planned.joints.tolist()
        assert times[at[0] + 1] - times[at[0]] == pytest.approx(2.5)


def test_robots_that_a_language_has_no_moves_for_are_said(route, tmp_path, run_calib):
    run = run_calib("route", "robot.yaml", "poses.csv", "--format", "fanuc", "--out", tmp_path / "route")
    assert "--third-joint" in run.refusal()
    two = plain(tmp_path, ("j", "revolute", "a", "b"))
    other = type(route)(two, np.zeros(1), route.stops, {}, (), ())
    with pytest.raises(InputError, match="six turning"):
        write_program(other, "krl", Motion("plan"))
    assert set(LANGUAGES) == {"urscript", "rapid", "krl", "fanuc", "ros2", "csv"}


def test_the_commands_give_free_poses_and_say_what_was_left_out(tmp_path, run_calib):
    yaml = _write(tmp_path, _obstacles())
    run = run_calib("sample", yaml, "-n", 60, "--out", tmp_path / "s.csv")
    assert re.search(r"Left out: \d+ of \d+ poses not free \(\d+ .*\); O1 is \d+\.\d % of what it would be", run.out)
    whole = calib.load(_write(tmp_path, "obstacles: unchecked\n"))
    with_, without = (calib.check(whole, poses).scaled["O1"] for poses in (tmp_path / "s.csv", calib.sample(whole, 60)))
    assert f"O1 is {100 * with_ / without:.1f} %" in run.out  # as `calib check` says
    robot, checker = calib.load(_write(tmp_path, _obstacles())), _MuJoCo(_BOXES)
    sampled = read_poses(tmp_path / "s.csv", robot)
    assert len(sampled) == 60
    assert not any(checker.touches(q) for q in sampled.joints)
    every = robot.sample(120, 7)
    chosen = calib.select(robot, every, 20)
    assert check_poses(robot, every).is_free[chosen.chosen].all()
    assert 0 < chosen.after["O1"] <= chosen.unobstructed["O1"] * 1.01  # the exchange need not find the very best


@pytest.mark.quick(0)
@needs_ompl
def test_the_route_command_writes_programs_and_a_table_that_joins_by_pose(tmp_path, run_calib):
    yaml = _write(tmp_path, _obstacles())
    run_calib("sample", yaml, "-n", 5, "--out", tmp_path / "s.csv")
    spare = ("--candidates", tmp_path / "s.csv")
    run = run_calib("route", yaml, tmp_path / "s.csv", *spare, "--format", "krl", "--out", tmp_path / "r")
    assert run.code == 0, run.err
    assert {path.name for path in (tmp_path / "r").iterdir()} >= {"calib_route.src", "route.csv", "readings.csv"}
    lines = [line for line in (tmp_path / "r/readings.csv").read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(io.StringIO("\n".join(lines))))
    planned = re.findall(r"^; pose (\d+), clearance", (tmp_path / "r/calib_route.src").read_text(), re.MULTILINE)
    assert [row["pose"] for row in rows] == planned
    assert 3 <= len(planned) == len(set(planned)) <= 5
    assert all(row["ball_x [mm]"] == "" for row in rows)
    check = run_calib("check", yaml, tmp_path / "r/route.csv")
    assert "not free" not in check.err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("obstacles:\n  rock: {sphere: 0.7 m, xyz: [0, 0, 0.4 m]}\n", "obstacle 'rock' is in the robot at every pose"),
        ("obstacles:\n  rock: {sphere: 50 mm, xyz: [0.75 m, 0, 1.15 m]}\n", "collides where it starts"),
        ("obstacles:\n  rock: {mesh: rock.stl}\n", "rock.stl' is not there"),
        ("obstacles:\n  rock: {plane: true, frame: l3}\n", "a plane cannot move"),
        ("obstacles:\n  rock: {sphere: 1 mm, frame: l33}\n", "no link or joint 'l33'"),
        ("obstacles: unchecked\n", "nobody should drive an unchecked way"),
    ],
)
def test_scenes_that_cannot_be_are_one_line(tmp_path, run_calib, more, said):
    poses = _table(tmp_path / "p.csv", ("a", [0.5, 0, 0, 0, 0, 0]))
    assert said in run_calib("route", _write(tmp_path, more), poses, "--out", tmp_path / "r").refusal()
    assert not (tmp_path / "r").exists()


def test_no_free_candidate_and_a_missing_mesh_are_said(tmp_path, run_calib):
    yaml, rows = _write(tmp_path, _obstacles()), [("a", [0, 2.5, 0, 0, 0, 0]), ("b", [0.1, 2.5, 0, 0, 0, 0])]
    poses = _table(tmp_path / "p.csv", *rows)
    run = run_calib("select", yaml, poses, "-n", 1, "--out", tmp_path / "c.csv")
    assert "none of the candidates is free: 2 of 2 poses not free" in run.refusal()
    free = _table(tmp_path / "f.csv", *rows, ("c", [0.1, 0, 0, 0, 0, 0]))
    run = run_calib("select", yaml, free, "-n", 2, "--out", tmp_path / "c.csv")
    assert "only 1 of the candidates are free, and 2 are to be chosen: 2 of 3 poses not free (2 " in run.refusal()
    run = run_calib("route", yaml, poses, "--out", tmp_path / "r")
    assert run.code == 3
    assert "none of 2 poses can be visited" in run.err
    urdf = _shaped().replace('<cylinder radius="0.05" length="0.5"/>', '<mesh filename="upper.stl"/>')
    run = run_calib("route", _write(tmp_path, _obstacles(), urdf), poses, "--out", tmp_path / "r")
    assert "mesh 'upper.stl' is not there" in run.refusal()
    run = run_calib("sample", _write(tmp_path, "", urdf), "-n", 3, "--out", tmp_path / "s.csv")
    assert run.code == 0
    assert "collisions are not checked: mesh 'upper.stl'" in run.err
    assert not (tmp_path / "r").exists()


def test_an_srdf_beside_the_urdf_is_read_and_one_of_another_robot_refused(tmp_path, run_calib):
    yaml = _write(tmp_path, _obstacles())

    def scene_with(srdf):
        (tmp_path / "arm.srdf").write_text(srdf)
        return surroundings(calib.load(yaml)).scene

    srdf = "<robot name='six axes'><disable_collisions link1='l2' link2='l4' reason='User'/></robot>"
    scene = scene_with(srdf)
    assert "l2 - l4" not in _names(scene)
    assert "l2 - l5" in _names(scene)
    assert scene_with(srdf.replace("six axes", "six_axes_description")).pairs == scene.pairs  # so is z1 of Unitree
    left = srdf.replace("</robot>", "<disable_collisions link1='l2' link2='right_arm'/></robot>")
    assert scene_with(left).pairs == scene.pairs  # of the whole robot, as that of Talos beside its left arm
    groups = "<robot name='other'><group name='arm'><joint name='j2'/></group></robot>"  # that of z1 disables nothing
    assert set(scene.pairs) < set(scene_with(groups).pairs)
    other = "<robot name='other'/>"
    for wrong in (groups.replace("j2", "wrist"), srdf.replace("six axes", "other").replace("l4", "wrist"), other):
        with pytest.raises(DescriptionError, match="is the SRDF of robot 'other'"):
            scene_with(wrong)
    with pytest.raises(DescriptionError, match=r"arm.srdf: is not XML \(no element found"):
        scene_with("<robot name='six axes'>")
    (tmp_path / "arm.srdf").write_text(other)
    poses = _table(tmp_path / "p.csv", ("a", [0.5, 0, 0, 0, 0, 0]))
    for command in (("route", yaml, poses), ("sample", yaml, "-n", 1), ("select", yaml, poses, "-n", 1)):
        assert "is the SRDF of robot 'other'" in run_calib(*command, "--out", tmp_path / "out").refusal()
        assert not (tmp_path / "out").exists()


def test_only_what_touches_at_a_home_within_the_limits_is_left_unchecked(tmp_path):
    # the wrist hits the forearm; 17 mm are left
    folded, near = np.array([[0, 0, 0, 0, -2.4, 0], [0, 0, 0, 0, -2.0, 0]])
    home = "self_clearance: 20 mm\nhome: {j5: %s}\n"
    touching = calib.load(_write(tmp_path, home % folded[4]))
    assert check_poses(touching, folded[None]).is_free
    assert "not checked, as they touch at home: l4 - l6" in surroundings(touching).scene.remarks
    up = as_poses(touching, np.zeros((1, 6)), ["up"])
    assert any("nothing around the robot is checked" in remark for remark in plan_route(touching, up).remarks)
    close = calib.load(_write(tmp_path, home % near[4]))
    assert check_poses(close, np.array([folded, near])).hits == ("l4 - l6", "")
    assert "checked without clearance, as they are nearer at home: l4 - l6" in surroundings(close).scene.remarks
    assert not check_move(surroundings(close).scene, near, np.zeros(6)).hit
    parts = _shaped().rsplit('lower="-3"', 2)  # of the fifth joint
    shorter = parts[0] + 'lower="-2.2"' + parts[1] + 'lower="-3"' + parts[2]
    impossible = calib.load(_write(tmp_path, home % folded[4], shorter))
    assert check_poses(impossible, folded[None]).hits == ("l4 - l6",)
    with pytest.raises(InputError, match=r"j5 = -137\.5 deg, beyond its limits \(-126\.1 deg to 171\.9 deg\)"):
        plan_route(impossible, up)


def test_a_gap_as_wide_as_the_clearance_is_free_in_every_pose(tmp_path):
    arm = '<origin xyz="0.105 0 0"/><axis xyz="1 0 0"/>'
    urdf = urdf_of(("j1", "revolute", "base", "turn", '<axis xyz="0 0 1"/>'), ("j2", "revolute", "turn", "arm", arm))
    ball = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
    (tmp_path / "turn.urdf").write_text(re.sub('(<link name="(base|arm)")/>', rf"\1>{ball}</link>", urdf))
    robot = calib.robot(tmp_path / "turn.urdf", self_clearance=0.005)
    checked = check_poses(robot, np.random.default_rng(0).uniform(-3.0, 3.0, (200, 2)))
    assert np.all(checked.is_free)
    assert checked.remarks == ("links without any shape, which are not checked: turn",)


@needs_ompl
def test_a_pose_that_no_way_leads_to_is_left_out_with_the_pair_that_blocks_the_straight_one(tmp_path):
    post = {"post": ((0.06, 0.06, 3.0), (0.0, 0.5, 1.0))}  # only the first joint moves, and the post is in its way
    first, *others = _shaped().split('lower="-3" upper="3"')
    urdf = 'lower="-3" upper="3"'.join([first, 'lower="1.1" upper="1.3"'.join(others[:2])])
    urdf = 'lower="-0.1" upper="0.1"'.join([urdf, *others[2:]])
    robot = calib.load(_write(tmp_path, _obstacles("1 mm", post) + "home: {j2: 1.2}\n", urdf))
    poses = as_poses(robot, np.array([[-1, 1.2, 0, 0, 0, 0], [2.6, 1.2, 0, 0, 0, 0]]), ["before", "behind"])
    route = plan_route(robot, poses)
    assert [stop.name for stop in route.stops] == ["before"]
    assert re.fullmatch(r"no free way leads there, l\d - post blocks the straight one", route.left_out["behind"])


def test_a_wall_and_a_turned_reflector_are_in_sight(tmp_path):
    sight = "sight: {xyz: [3 m, 0, 1.1 m]}\nobstacles:\n  wall: {box: [0.05, 1, 1], xyz: [2 m, 0, 1.1 m]}\n"
    robot = calib.load(_write(tmp_path, sight))
    up, behind = np.zeros(6), np.array([np.pi / 2, 0, 0, 0, 0, 0])
    hits = check_poses(robot, np.array([up, behind])).hits
    assert hits[0] == "wall in sight of ball"
    away = ("wall: {box: [0.05, 1, 1], xyz: [2 m", "wall: {sphere: 1, xyz: [9 m")
    turned = ("100 mm]}", "100 mm], acceptance: {angle: 30 deg, axis: [1, 0, 0]}}")
    (tmp_path / "other").mkdir()
    robot = calib.load(copied(tmp_path / "other", tmp_path / "arm.yaml", away, turned))
    assert check_poses(robot, np.array([up, behind])).hits == ("", "ball turned away")


EYE = """\
instruments:
  eye:
    {kind: pixel, target: ball, camera: {frame: l0, xyz: [3 m, 0, 1 m], rpy: [%s, 0, 90 deg]}, image: [1000, 800],
     intrinsics: {fx: 900, fy: 900, cx: 500, cy: 400}, board: {kind: chessboard, columns: 4, rows: 3, square: 20 mm}}
"""


def test_a_board_behind_the_arm_is_not_in_sight_of_a_camera_beside_it(tmp_path):
    robot = calib.load(_write(tmp_path, EYE % "-90 deg"))
    low = np.array([0, 0.8, 0.8, 0, 0, 0])
    hits = check_poses(robot, np.array([low, low + np.array([np.pi - 0.2, 0, 0, 0, 0, 0])])).hits
    assert hits[0] == ""
    assert re.fullmatch(r"l\d in sight of ball by eye", hits[1])


def test_what_hides_a_board_at_less_than_half_of_the_poses_is_checked(tmp_path):
    wall = "obstacles:\n  wall: {box: [0.05, 0.6, 0.6], xyz: [2.4 m, 0.3 m, 1.1 m]}\n"
    robot = calib.load(_write(tmp_path, EYE % "-90 deg" + wall))
    assert surroundings(robot).scene.remarks == ()  # each pose counts once, whatever the number of lines to the board
    assert "wall in sight of ball by eye" in check_poses(robot, robot.sample(100, seed=1)).hits


def test_a_camera_that_looks_away_sees_nothing_and_that_is_said(tmp_path, run_calib):
    upwards = _write(tmp_path, EYE % "0")
    run = run_calib("sample", upwards, "--count", 20, "--out", tmp_path / "poses.csv")
    assert run.code == 0, run.err
    assert "no reading there depends on a free parameter" in run.out
    assert "eye at 0 of 20" in run.err


@pytest.mark.quick(0)
@needs_ompl
@pytest.mark.parametrize("name", ["five_bar", "delta", "stewart"])
def test_closed_loops_are_routed_with_capsules_and_rods_on_both_sides_of_sliding_joints(name, tmp_path):
    far = "\nobstacles:\n  far: {sphere: 10 mm, xyz: [5 m, 0, 0]}\n"
    model = calib.load(copied(tmp_path, EXAMPLES / f"{name}.yaml", more=far))
    route = plan_route(model, calib.sample(model, 4, 1))
    assert len(route.stops) + len(route.left_out) == 4
    assert any("stand for" in remark for remark in route.remarks)
    assert np.all(model.close(route.corners()).ok)
    scene = surroundings(model).scene
    rods = [body for body in scene.bodies if body.name in ("leg_1_cylinder", "leg_1_tip")]
    if name == "stewart":
        assert {"leg_1_cylinder - far", "leg_1_tip - far"} <= set(_names(scene))
        assert [2 * body.solid.hull.halfLength for body in rods] == pytest.approx([0.4433621868572532] * 2)


def test_without_shapes_nothing_is_checked_and_that_is_said(tmp_path, run_calib):
    yaml = _write(tmp_path, "", URDF)
    run = run_calib("sample", yaml, "-n", 3, "--out", tmp_path / "s.csv")
    assert "collisions are not checked: the robot file has no collision shapes" in run.err
    s, m = tmp_path / "s.csv", tmp_path / "m.csv"
    run_calib("sample", yaml, "-n", 40, "--out", s, "--force")
    for command in (
        ("check", yaml, s),
        ("select", yaml, s, "-n", 30, "--out", tmp_path / "c.csv"),
        ("simulate", yaml, s, "--sigma-mm", 0.1, "--seed", 1, "--out", m),
        ("watch", yaml, m, "--goal", "1mm", "--once", "--candidates", s),
    ):
        assert run_calib(*command).err.count("collisions are not checked: the robot file has no collision shapes") == 1
    check = check_poses(calib.load(yaml), np.zeros((2, 6)))
    assert check.is_free.all()
    assert check.unchecked


def test_poses_are_shown_in_red_where_they_collide(tmp_path):
    robot = calib.load(_write(tmp_path, _obstacles()))
    poses = as_poses(robot, np.array([np.zeros(6), [0, 2.5, 0, 0, 0, 0]]), ["home", "low"])
    scene = gather(robot, data=poses).scene
    assert scene.poses.group == ("planned", "collides")
    assert re.fullmatch(r"low: .* - .*", scene.poses.labels[1])
    assert {"obstacle/table", "obstacle/post"} <= {shape.name for shape in scene.shapes}
    marks = {group["name"]: group["mark"] for group in scene_data(scene)["groups"]}
    assert marks["collides"] == "alarm"


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", ["position", "pose", "orientation", "distance", "touch", "joint_reading"])
def test_plain_poses_of_every_kind_are_shown(tmp_path, kind):
    place = "{frame: l0, xyz: [0.5 m, 0, 0.3 m], position: unknown, sigma: 10 mm}"
    more = {"distance": f"end: {place}", "touch": f"places: {{plate: {place}}}", "joint_reading": "joint: j2"}
    target = "" if kind == "joint_reading" else ", target: ball"
    section = f"instruments: {{own: {{kind: {kind}{target}, {more.get(kind, '')}}}}}\n".replace(", }", "}")
    poses = as_poses(calib.load(_write(tmp_path, section)), np.zeros((1, 6)), ["home"])
    assert set(gather(calib.load(tmp_path / "arm.yaml"), data=poses).scene.poses.group) <= {"planned", "collides"}


def test_a_route_by_a_forced_fit_that_failed_says_so(tmp_path, run_calib):
    arm = calib.load(EXAMPLES / "arm.yaml")
    data = calib.simulate(arm, arm.sample(30, 2), sigma=2e-2, seed=2)  # m: no robot is that bad
    failed = calib.fit(arm, data.joints, data.readings["reflector"].values)
    failed.save(tmp_path / "forced", force=True, pages=False)
    write_table(tmp_path / "poses.csv", arm.joint_names, 0.1 * np.arange(1.0, 7.0)[None])
    run = run_calib("route", tmp_path / "forced", tmp_path / "poses.csv", "--out", tmp_path / "route")
    assert f"Note: the fit in {tmp_path / 'forced'} failed\n" in run.out

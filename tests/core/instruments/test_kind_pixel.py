"""Pixels: cameras found from anywhere, a known truth found again, intervals, and input that cannot be."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.data.measurement_files import read_measurements
from calib.core.instruments.camera import is_in_front, project, rays
from calib.core.instruments.kind import Readings, View
from calib.core.rows.observed import predict_readings
from calib.core.rows.registration import register
from calib.shared.candidates import rows_of_poses
from tests.kind_checks import assert_found
from tests.project import write_table
from tests.six_axis_arm import HEAD, free, joints, write_six_axis

_GOLDEN = (1 + 5**0.5) / 2
_THIRD = np.array([[0.0, s, t * _GOLDEN] for s in (1, -1) for t in (1, -1)])
BODY = 0.03 * np.concatenate([_THIRD, _THIRD[:, [2, 0, 1]], _THIRD[:, [1, 2, 0]]])
"""Corners of an icosahedron [m]."""
NAMES = [f"p{k}" for k in range(len(BODY))]
POINTS = "{" + ", ".join(f"{n}: [{x!r}, {y!r}, {z!r}]" for n, (x, y, z) in zip(NAMES, BODY.tolist(), strict=True)) + "}"
CAMERA = np.array([2400, 2410, 1000, 800, -0.1, 0.05, 0.001, -0.0005, 0.01])
INTRINSICS = "{fx: 2400, fy: 2410, cx: 1000, cy: 800, k1: -0.1, k2: 0.05, p1: 0.001, p2: -0.0005, k3: 0.01}"
TRUTH = {"j2.ry": 0.01, "j3.ry": -0.02, "j3.z": 0.602, "j4.rx": 0.01, "j5.ry": 0.015, "j5.x": 0.397}
FREE = free(*TRUTH)
YAML = f"""\
{HEAD}priors: false
base: {{frame: l0}}
targets: {{body: {{frame: l6, position: unknown, orientation: unknown}}}}
instruments:
  eye: {{kind: pixel, target: body, camera: {{frame: l0}}, intrinsics: {INTRINSICS}, image: [2000, 1600],
        points: {POINTS}}}
parametrisation:
{FREE}"""
SIGMA = 0.3


def image(points):
    """Where OpenCV puts points in the camera's frame, as its documentation says."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = CAMERA
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r = x**2 + y**2
    bend = 1 + k1 * r + k2 * r**2 + k3 * r**3
    u = x * bend + 2 * p1 * x * y + p2 * (r + 2 * x**2)
    v = y * bend + p1 * (r + 2 * y**2) + 2 * p2 * x * y
    return np.stack([fx * u + cx, fy * v + cy], axis=1)


def places(seed):
    """A camera anywhere around the arm that looks at it, turned anyhow; a body anywhere near the flange."""
    rng = np.random.default_rng(seed)
    away = rng.normal(size=3)
    centre = np.array([0.4, 0, 0.8]) + rng.uniform(-0.2, 0.2, 3)
    camera, body = np.eye(4), np.eye(4)
    camera[:3, 3] = centre + away / np.linalg.norm(away) * rng.uniform(1.8, 3)
    z = centre - camera[:3, 3]
    x = np.cross(z, rng.normal(size=3))
    frame = np.stack([x, np.cross(z, x), z], axis=1)
    camera[:3, :3] = frame / np.linalg.norm(frame, axis=0)
    body[:3, :3], body[:3, 3] = Rotation.random(None, rng).as_matrix(), rng.uniform(-0.2, 0.2, 3)
    return camera, body


def photographs(truth, q, camera, body, most=12, seed=0):
    """What the camera sees at poses q: visit, point and pixels without noise; the far side of the body is hidden."""
    rng, results = np.random.default_rng(seed), []
    for k, link in enumerate(truth.forward(q, "l6")):
        pose = np.linalg.inv(camera) @ link @ body
        points = BODY @ pose[:3, :3].T + pose[:3, 3]
        seen = (points[:, 2] > 0.2) & (np.einsum("na,na->n", BODY @ pose[:3, :3].T, points) < 0)
        pixels = image(np.where(seen[:, None], points, [0, 0, 1]))
        chosen = np.flatnonzero(seen & np.all(np.abs(pixels - [1000, 800]) < [1000, 800], axis=1))
        chosen = rng.permutation(chosen)[:most]
        results += [(k, point, *pixels[point]) for point in chosen]
    return np.array(results)


def data_of(robot, q, table, sigma=0.0, seed=0):
    noise = sigma * np.random.default_rng(seed).standard_normal((len(table), 2))
    n = len(table)
    readings = Readings(table[:, 0].astype(int), np.zeros(n, int), table[:, 2:] + noise, None, table[:, 1:2])
    data = calib.as_measurements(robot, q, {"eye": readings})
    return data.subset(np.unique(readings.visits))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML))


def test_a_camera_projects_as_opencv_does_and_back():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (50, 2)), rng.uniform(1, 2, 50)])
    pixels = project(points, CAMERA)[0]
    np.testing.assert_allclose(pixels, image(points), atol=1e-9)
    np.testing.assert_allclose(rays(pixels, CAMERA), points[:, :2] / points[:, 2:], atol=1e-12)


def test_points_behind_a_camera_have_finite_pixels_that_lead_back_to_its_front():
    points = np.random.default_rng(2).normal(size=(500, 3))
    pixels, by_point, by_number = project(np.vstack([points, np.zeros(3)]), CAMERA)
    assert all(np.isfinite(part).all() for part in (pixels, by_point, by_number))
    falling = np.stack([np.full(50, 0.3), np.zeros(50), np.linspace(1.0, -1.0, 50)], axis=1)
    falling /= np.linalg.norm(falling, axis=1, keepdims=True)
    assert np.all(np.diff((project(falling, CAMERA)[0][:, 0] - 1000) / falling[:, 0]) > 0)
    assert is_in_front(np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]])).tolist() == [True, False, False]


def standing(robot, camera, body):
    """The robot with its camera and body there: six numbers each."""
    values = {}
    for name, pose in (("eye", camera), ("body", body)):
        turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
        parts = zip(("x", "y", "z", "rx", "ry", "rz"), (*pose[:3, 3], *turn), strict=True)
        values |= {f"{name}.{component}": float(value) for component, value in parts}
    return robot.with_parameters(values)


def test_a_camera_beside_the_robot_reads_what_opencv_says(arm):
    camera, body = places(4)
    q = joints(12, 4)
    data = data_of(arm, q, photographs(arm, q, camera, body, most=2))
    there = standing(arm, camera, body)
    predicted = predict_readings(there, there.assemble(data.joints), data.readings)["eye"].values
    np.testing.assert_allclose(predicted, data.readings["eye"].values, atol=1e-7)


@pytest.mark.quick(0)
@pytest.mark.amount(2, 4)
@pytest.mark.parametrize("most", [12, 4, 2])
def test_cameras_anywhere_are_found_with_an_unknown_body(arm, most, amount):
    truth = arm.with_parameters(TRUTH)
    for seed in range(amount):
        camera, body = places(seed)
        q = joints(60, seed)
        data = data_of(arm, q, photographs(truth, q, camera, body, most), SIGMA, seed)
        placed = register(arm, data)
        result = placed.mechanism.placement("eye").homogeneous
        assert np.linalg.norm(result[:3, 3] - camera[:3, 3]) < 0.2, seed
        assert Rotation.from_matrix(result[:3, :3].T @ camera[:3, :3]).magnitude() < 0.1, seed


@pytest.mark.quick(0)
@pytest.mark.parametrize("known", ["camera", "body"])
def test_one_end_is_found_where_the_other_is_known(tmp_path, known):
    camera, body = places(6)
    there = camera if known == "camera" else body
    turn = Rotation.from_matrix(there[:3, :3]).as_euler("xyz")
    stated = f"xyz: {there[:3, 3].tolist()}, rpy: {turn.tolist()}"
    if known == "camera":
        yaml = YAML.replace("camera: {frame: l0}", f"camera: {{frame: l0, {stated}, pose: known}}")
    else:
        yaml = YAML.replace("position: unknown, orientation: unknown", stated)
    robot = calib.load(write_six_axis(tmp_path, yaml))
    q = joints(30, 6)
    placed = register(robot, data_of(robot, q, photographs(robot, q, camera, body, 5)))
    np.testing.assert_allclose(placed.mechanism.placement("eye").homogeneous, camera, atol=1e-6)
    np.testing.assert_allclose(placed.mechanism.placement("body").homogeneous, body, atol=1e-6)


@pytest.mark.quick(0)
def test_the_truth_is_found_with_intrinsics_that_are_not_known(tmp_path):
    yaml = YAML.replace("fx: 2400, fy: 2410", "fx: 2380, fy: 2440")
    yaml = yaml.replace(", image:", ", unknown_intrinsics: {fx: 20, fy: 20}, image:")
    robot = calib.load(write_six_axis(tmp_path, yaml))
    camera, body = places(7)
    q = joints(80, 7)
    fit = calib.fit(robot, data_of(robot, q, photographs(robot.with_parameters(TRUTH), q, camera, body)))
    assert_found(fit.robot, TRUTH, 1e-7)
    assert_found(fit.robot, {"eye.fx": 2400, "eye.fy": 2410}, 0.02)


def test_what_a_camera_cannot_see_is_no_reading_and_says_nothing(arm):
    camera, body = places(9)
    there = standing(arm, camera, body)
    q = joints(30, 9)
    simulated = calib.simulate(there, q, 0.0, np.random.default_rng(0)).readings["eye"]
    assert 0 < len(simulated) < 30 * len(BODY)
    assert np.all((simulated.values > -1) & (simulated.values < [2000, 1600]))
    behind = camera.copy()
    behind[:3, :3] = camera[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    blind = standing(arm, behind, body)
    assert "eye" not in calib.simulate(blind, q, 0.0, np.random.default_rng(0)).readings
    assert not np.any(rows_of_poses(blind, blind.assemble(q), None).rows)


TWO = (
    YAML.replace("  eye: {kind: pixel,", "  left: {kind: pixel, columns: px,")
    .replace("parametrisation:", YAML[YAML.index("  eye:") : YAML.index("parametrisation:")] + "parametrisation:")
    .replace("  eye: {kind: pixel,", "  right: {kind: pixel, columns: px,")
)


def edit_cell(path, line, cell, change):
    """Replace a cell of a table, both counted from 0, by what becomes of it; return the cells of its line."""
    lines = path.read_text().splitlines()
    cells = lines[line].split(",")
    cells[cell] = change(cells[cell])
    lines[line] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    return cells


def written(folder, header="pose,camera,point,px_u [px],px_v [px]", rows=None):
    """Files of two cameras: one with joints, one long one with pixels."""
    robot = calib.load(write_six_axis(folder, TWO))
    q = joints(60, 10)
    lines = []
    for name, seed in (("left", 11), ("right", 12)):
        camera = places(seed)[0]
        for visit, point, u, v in photographs(robot, q, camera, places(11)[1], 4):
            lines.append(f"v{int(visit)},{name},{NAMES[int(point)]},{u:.12g},{v:.12g}")
    write_table(folder / "joints.csv", "pose,j1,j2,j3,j4,j5,j6", [f"v{k}" for k in range(60)], q)
    (folder / "pixels.csv").write_text("\n".join([header, *(lines if rows is None else rows)]) + "\n")
    return robot, [folder / "joints.csv", folder / "pixels.csv"]


@pytest.mark.quick(0)
def test_check_reads_the_files_that_fit_reads(tmp_path, run_calib):
    robot, files = written(tmp_path)
    data = read_measurements(files, robot)
    run = run_calib("check", robot.path, *files, "--json", tmp_path / "check.json")
    assert run.code == 0, run.err
    content = json.loads((tmp_path / "check.json").read_text())
    assert content["n_rows"] == 2 * sum(len(readings) for readings in data.readings.values())
    assert content["poses"] == f"{files[0]}, {files[1]}"
    (tmp_path / "again.csv").write_text(Path(files[0]).read_text())
    none = run_calib("check", robot.path, files[0], tmp_path / "again.csv")
    assert (none.code, none.out) == (2, "")
    assert "has no column of any instrument" in none.err


@pytest.mark.quick(0)
def test_two_cameras_share_the_columns_of_a_long_file_and_see_one_body(tmp_path):
    robot, files = written(tmp_path)
    data = read_measurements(files, robot)
    assert data.ignored == ()
    assert min(len(data.readings[name]) for name in ("left", "right")) > 40
    placed = register(robot, data)
    np.testing.assert_allclose(placed.mechanism.placement("body").homogeneous, places(11)[1], atol=1e-5)
    np.testing.assert_allclose(placed.mechanism.placement("left").homogeneous, places(11)[0], atol=1e-5)
    np.testing.assert_allclose(placed.mechanism.placement("right").homogeneous, places(12)[0], atol=1e-5)


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("pose,camera,point,px_u,px_v", "v0,lft,p1,1,2", "column 'camera': no camera 'lft'; did you mean 'left'"),
        ("pose,camera,point,px_u,px_v", "v0,left,q1,1,2", "line 2, column 'point': 'left' has no point 'q1'"),
        ("pose,point,px_u,px_v", "v0,p1,1,2", "no column 'camera', which tells left and right apart"),
        ("pose,camera,px_u,px_v", "v0,left,1,2", "no column 'point'"),
        ("pose,camera,point,px_u [mm],px_v", "v0,left,p1,1,2", "unit 'mm' is for a length"),
        ("pose,camera,point,px_u,px_v", "w0,left,p1,1,2", "no file with joint values has a pose 'w0'"),
    ],
)
def test_files_that_cannot_be(tmp_path, header, row, said):
    robot, files = written(tmp_path, header, [row])
    with pytest.raises(calib.CalibrationError) as caught:
        read_measurements(files, robot)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("point,x [mm],y [mm],z [mm]\na,1,2,3\na,1,2,4\n", "line 3: point 'a' comes twice"),
        ("point,x,y,z\na,1,2\n", "line 2: 3 cells for 4 columns"),
        ("point,x [deg],y,z\na,1,2,3\n", "column 'x': unit 'deg' is for an angle"),
        ("point,x,y,z\n", "has no points"),
    ],
)
def test_files_of_points_that_cannot_be(tmp_path, text, said):
    (tmp_path / "points.csv").write_text(text)
    path = write_six_axis(tmp_path, YAML.replace(f"points: {POINTS}", "points_file: points.csv"))
    with pytest.raises(calib.CalibrationError) as caught:
        calib.load(path)
    assert said in str(caught.value)


def test_points_may_come_from_a_file(tmp_path):
    rows = "".join(f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(NAMES, 1e3 * BODY, strict=True))
    (tmp_path / "points.csv").write_text("point,x [mm],y [mm],z [mm]\n" + rows)
    robot = calib.load(write_six_axis(tmp_path, YAML.replace(f"points: {POINTS}", "points_file: points.csv")))
    np.testing.assert_allclose(list(robot.instrument("eye").points_of_body.values()), BODY, atol=1e-15)


def test_points_may_be_those_of_a_printed_board(tmp_path):
    board = "kind: chessboard\ncolumns: 4\nrows: 3\nsquare: 20 mm\n"
    (tmp_path / "board.yaml").write_text(board)
    for given in ("board.yaml", "{kind: chessboard, columns: 4, rows: 3, square: 20 mm}", '"chessboard:4x3:20mm"'):
        robot = calib.load(write_six_axis(tmp_path, YAML.replace(f"points: {POINTS}", f"board: {given}")))
        points = robot.instrument("eye").points_of_body
        assert list(points) == ["c0", "c1", "c2", "c3", "c4", "c5"]
        np.testing.assert_allclose(points["c5"], (0.06, 0.04, 0.0), atol=1e-15)
    (tmp_path / "board.yaml").write_text(board.replace("rows: 3", "rows: 4"))
    with pytest.raises(calib.CalibrationError, match=r"board.yaml: a chessboard of 4 x 4 squares looks the same"):
        calib.load(write_six_axis(tmp_path, YAML.replace(f"points: {POINTS}", "board: board.yaml")))


def test_a_camera_that_is_said_to_look_away_is_named(tmp_path):
    camera, body = places(13)
    yaml = YAML.replace("{frame: l0}, intr", "{frame: l0, pose: known, rpy: [0, 3.1, 0]}, intr")
    yaml = yaml.replace("position: unknown, orientation: unknown", "position: known")
    robot = calib.load(write_six_axis(tmp_path, yaml))
    q = joints(20, 13)
    with pytest.raises(calib.CalibrationError, match=r"camera 'eye': .* would lie behind it. Check the poses"):
        register(robot, data_of(robot, q, photographs(robot, q, camera, body)))


def test_an_image_that_was_turned_against_its_intrinsics_is_named(arm):
    camera, body = places(14)
    q = joints(60, 14)
    data = data_of(arm, q, photographs(arm, q, camera, body), SIGMA)
    instrument, readings = arm.instrument("eye"), data.readings["eye"]
    assert instrument.doubts(readings) == ()
    turned = replace(readings, values=np.stack([readings.values[:, 1], 4000 - readings.values[:, 0]], axis=1))
    (said,) = instrument.doubts(turned)
    assert said.startswith("camera 'eye': ")
    assert "outside an image of 2000 x 1600 px" in said
    assert "turned by 90 degrees" in said


BOARDS = {
    "chessboard": "{kind: chessboard, columns: 9, rows: 6, square: 25 mm}",
    "charuco": "{kind: charuco, columns: 9, rows: 6, square: 25 mm, marker: 18 mm, dictionary: DICT_5X5_100}",
}


@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_readings_of_a_board_are_predicted_where_a_photograph_shows_it(tmp_path, kind):
    yaml = YAML.replace(f"points: {POINTS}", f"board: {BOARDS[kind]}, focus: [300 mm, 900 mm]")
    eye = calib.load(write_six_axis(tmp_path, yaml)).instrument("eye")
    n = len(eye.points_of_body)

    def seen(xyz, rpy=(0, 0, 0)):  # of the middle of the board in the camera
        turn = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
        at = np.array(xyz) - turn @ [0.1125, 0.075, 0.0]
        view = View(np.tile(turn, (n, 1, 1)), np.tile(at, (n, 1)))
        values = eye.predict(view, np.array([]), np.arange(n)[:, None].astype(float))
        return int(np.sum(np.isfinite(values).all(axis=1)))

    assert seen((0, 0, 0.6)) == n
    assert seen((0, 0, 0.6), (55, 0, 0)) == n
    assert seen((0, 0, 0.6), (70, 0, 0)) == 0  # nearly from the side
    assert seen((0, 0, 0.6), (180, 0, 0)) == 0  # from behind: through the paper
    assert seen((0, 0, 1.0)) == 0  # not sharp
    assert seen((0, 0, -0.6)) == 0
    part = seen((0.22, 0, 0.6))  # the image less its margin ends 0.244 m from its axis there: 5 columns of 8
    assert part == (0 if kind == "chessboard" else 25)
    assert seen((0.33, 0, 0.6)) == 0


def test_what_distortion_folds_back_into_the_image_is_not_seen(tmp_path):
    yaml = YAML.replace("k1: -0.1, k2: 0.05, p1: 0.001, p2: -0.0005, k3: 0.01", "k1: -0.3")
    eye = calib.load(write_six_axis(tmp_path, yaml)).instrument("eye")
    away = np.tan(np.deg2rad(61.0))  # r - 0.3 r^3 falls beyond r = 1.05, and is 0.05 here
    view = View(np.eye(3)[None], np.array([[away, 0.0, 1.0]]) - BODY[0])
    assert 0 < 2400 * (away - 0.3 * away**3) < 1000
    assert np.all(np.isnan(eye.predict(view, np.array([]), np.zeros((1, 1)))))


@pytest.mark.quick(0)
def test_poses_are_sampled_at_which_a_camera_sees_its_board(tmp_path, run_calib):
    yaml = YAML.replace(f"points: {POINTS}", f"board: {BOARDS['charuco']}")
    yaml = yaml.replace("fx: 2400, fy: 2410", "fx: 1800, fy: 1800")
    yaml = yaml.replace("camera: {frame: l0}", "camera: {frame: l6, rpy: [0, 90 deg, 0]}")
    yaml = yaml.replace("body: {frame: l6, ", "body: {frame: l0, xyz: [0.9, -0.1, 0.4], rpy: [0, 100 deg, 0], ")
    path = write_six_axis(tmp_path, yaml)
    robot = calib.load(path)
    poses = calib.sample(robot, 15, 3)
    assert len(np.unique(calib.simulate(robot, poses, 0.0).readings["eye"].visits)) == 15
    run = run_calib("sample", path, "--count", 15, "--seed", 3, "--out", "good.csv", cwd=tmp_path)
    assert run.code == 0
    assert "few of these poses see" not in run.err
    tried = robot.sample(40, 4)
    blind = tried[np.setdiff1d(np.arange(40), calib.simulate(robot, tried, 0.0).readings["eye"].visits)]
    write_table(tmp_path / "blind.csv", robot.joint_names, [*blind, *poses.joints])
    run = run_calib("select", path, "blind.csv", "--count", 12, "--out", "chosen.csv", cwd=tmp_path)
    assert run.code == 0, run.err
    assert f"few of these poses see what is to be measured: eye at 15 of {len(blind) + 15};" in run.err
    away = write_six_axis(tmp_path, yaml.replace("[0.9, -0.1, 0.4]", "[40, 0, 0]"))
    run = run_calib("sample", away, "--count", 15, "--out", "none.csv", cwd=tmp_path)
    assert run.code == 0
    assert "few of these poses see what is to be measured: eye at 0 of 15; check `xyz` and `rpy`" in run.err


@pytest.mark.quick(0)
def test_a_reading_that_is_off_is_named_by_the_file_in_which_it_stands(tmp_path):
    robot, files = written(tmp_path)
    cells = edit_cell(files[1], 40, 3, lambda cell: repr(float(cell) + 20.0))
    fit = calib.fit(robot, read_measurements(files, robot))
    assert fit.outliers[0].label == f"{files[1]}, line 41 (pose {cells[0]})"


def test_a_pixel_beyond_any_image_is_named_with_its_place(tmp_path, run_calib):
    robot, files = written(tmp_path)
    edit_cell(files[1], 7, 4, lambda cell: "-1e308")
    run = run_calib("fit", robot.path, *files, "--no-pages", "--out", tmp_path / "out")
    assert (run.code, run.out) == (2, "")
    assert "line 8, column 'px_v'" in run.err
    assert "-1e308" in run.err

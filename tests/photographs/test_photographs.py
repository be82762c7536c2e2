import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.errors import DataError, DescriptionError, InputError
from calib.core.instruments.board import validate_board
from calib.photographs.camera_files import read_camera
from calib.photographs.commands.boards import read_board_option
from calib.photographs.estimation import turning
from calib.photographs.tool_poses import read_tool_poses
from tests.project import EXAMPLES, write_table

cv2 = pytest.importorskip("cv2")
from calib.photographs.commands.hand_eye import _read_detected  # noqa: E402
from calib.photographs.detection import detect  # noqa: E402
from calib.photographs.images import shots  # noqa: E402
from calib.photographs.opencv import decode, read_image  # noqa: E402
from calib.photographs.printing import Paper, page  # noqa: E402
from calib.photographs.rendering import example  # noqa: E402

CHARUCO = "charuco:6x8:30mm:21mm:DICT_5X5_100"
BOARDS = {
    "charuco": CHARUCO,
    "chessboard": "chessboard:9x6:24mm",
    "circles": "circles:4x11:20mm",
    "aruco": "aruco:4x3:40mm:10mm:DICT_4X4_50",
    "apriltag": "apriltag:4x3:40mm:10mm",
}


def seen(board, homography=None):
    """A photograph by OpenCV's own warping, of pixels of 0.4 mm, and the homography from the board [m] to it."""
    x, y = ((np.arange(np.ceil((length + 0.06) / 4e-4)) + 0.5) * 4e-4 - 0.03 for length in board.size)
    places = np.stack(np.meshgrid(x, y), axis=-1)
    flat = np.where(Paper(board).black(places.reshape(-1, 2)), 0, 255).astype(np.uint8).reshape(places.shape[:2])
    if homography is None:
        homography = np.array([[0.95, -0.18, 160.0], [0.12, 0.9, 40.0], [1e-4, -1e-4, 1.0]])
    image = cv2.warpPerspective(flat, homography, (900, 760), borderValue=130)
    to_raster = np.array([[1 / 4e-4, 0, 0.03 / 4e-4 - 0.5], [0, 1 / 4e-4, 0.03 / 4e-4 - 0.5], [0, 0, 1]])
    return cv2.GaussianBlur(image, (0, 0), 0.8), homography @ to_raster


@pytest.mark.parametrize("text", ["chessboard:9x6:24.7mm", "charuco:7x5:30.3mm:22mm:DICT_5X5_100"])
def test_a_printed_board_changes_colour_exactly_at_its_corners(text):
    board = read_board_option(text)
    corners, paper = np.array(list(board.points().values()))[:, :2], Paper(board)
    around = 1e-7 * np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)])
    low, right, left, high = (paper.black(corners + way) for way in around)
    assert np.all((low == high) & (right == left) & (low != right))


@pytest.mark.parametrize("legacy", [False, True])
def test_a_charuco_board_is_drawn_as_opencv_draws_it(legacy):
    board = read_board_option("charuco:6x8:30mm:21mm:DICT_5X5_100").model_copy(update={"legacy": legacy})
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    own = cv2.aruco.CharucoBoard((6, 8), 30.0, 21.0, known)
    own.setLegacyPattern(legacy)
    x, y = ((np.arange(n * 60) + 0.5) * 5e-4 for n in (6, 8))  # a pixel is 0.5 mm, and six are a cell of a marker
    black = Paper(board).black(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(len(y), len(x))
    np.testing.assert_array_equal(own.generateImage((6 * 60, 8 * 60), marginSize=0) == 0, black)


def last(board, *images):
    return detect(board, [(f"image {k}", image) for k, image in enumerate(images)])


@pytest.mark.parametrize("kind", BOARDS)
def test_points_are_found_where_the_homography_puts_them(kind):
    board = read_board_option(BOARDS[kind])
    image, homography = seen(board)
    (result,) = last(board, image).images
    assert len(result.points) == len(board.points())
    places = np.array([board.points()[name] for name in result.points])
    expected = np.hstack([places[:, :2], np.ones((len(places), 1))]) @ homography.T
    assert np.max(np.abs(result.pixels - expected[:, :2] / expected[:, 2:])) < 0.8  # px; markers are the worst
    assert not result.remark


def test_the_older_layout_is_told_by_trying_both():
    older = read_board_option(CHARUCO).model_copy(update={"legacy": True})
    detection = last(read_board_option(CHARUCO), seen(older)[0])
    assert detection.board.legacy is True
    assert detection.n_points == 35


def test_photographs_of_a_simulated_robot_show_its_board_where_its_camera_sees_it(tmp_path, run_calib):
    def calib_(*arguments):
        done = run_calib(*arguments, cwd=tmp_path)
        assert done.code == 0, done.err
        return done.out

    def pixels(*files):
        data = calib.read_measurements([tmp_path / file for file in files], calib.load(tmp_path / "arm.yaml"))
        item = data.readings["camera"]
        return {
            (data.names[visit], number): pixel
            for visit, (number,), pixel in zip(item.visits, item.details, item.values, strict=True)
        }

    calib_("init", EXAMPLES / "arm.urdf", "--measure", "camera", "--out", "arm.yaml")
    calib_("sample", "arm.yaml", "--count", 3, "--seed", 1, "--out", "poses.csv")
    printed = calib_("simulate", "arm.yaml", "poses.csv", "--photographs", "shots", "--out", "joints.csv")
    assert printed.splitlines()[-1] == "3 simulated photographs written to shots"
    calib_("simulate", "arm.yaml", "poses.csv", "--sigma-mm", 0, "--out", "exact.csv")
    calib_("detect", "shots", "--board", "arm_board.yaml", "--out", "pixels.csv")
    exact, seen = pixels("exact.csv"), pixels("joints.csv", "pixels.csv")
    off = np.array([seen[key] - exact[key] for key in seen if key in exact])
    assert len(off) > 20
    assert np.max(np.abs(off)) < 0.5  # px; what is found of a corner that is seen at a steep angle
    assert np.sqrt(np.mean(off**2)) < 0.2
    without = ("simulate", EXAMPLES / "arm.yaml", "poses.csv", "--photographs", "no", "--out", "x")
    assert "has 0 cameras that can photograph" in run_calib(*without, cwd=tmp_path).refusal()
    assert not (tmp_path / "no").exists()


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("described", "shown", "words"),
    [
        ("charuco:8x6:30mm:21mm:DICT_5X5_100", "", "its 24 markers fit a board of 6 columns"),
        ("charuco:7x8:30mm:21mm:DICT_5X5_100", "", "its 24 markers fit a board of 6 columns"),
        ("charuco:6x8:30mm:21mm:DICT_6X6_250", "", "but some of DICT_5X5_50; correct 'dictionary'"),
        (CHARUCO, "mirrored", "the image is mirrored"),
        (CHARUCO, "empty", "no marker of DICT_5X5_100; the image has no contrast (grey values from 127 to 127 of 255)"),
        ("chessboard:8x5:24mm", "chessboard", "but one of 9 x 6 squares"),
        ("circles:4x9:20mm", "circles", "but one of 4 x 11 dots"),
        ("aruco:3x4:40mm:10mm:DICT_4X4_50", "aruco", "its 12 markers fit a board of 4 columns"),
    ],
)
def test_why_no_board_is_found_is_said(described, shown, words):
    image = seen(read_board_option(BOARDS.get(shown, CHARUCO)))[0]
    if shown == "mirrored":
        image = np.ascontiguousarray(image[:, ::-1])
    if shown == "empty":
        image = np.full((300, 400), 127, np.uint8)
    assert words in last(read_board_option(described), image).images[0].remark


def test_blur_and_strange_markers_are_said():
    board = read_board_option(CHARUCO)
    blurred = cv2.GaussianBlur(seen(board)[0], (0, 0), 3.0)
    (result,) = last(board, blurred).images
    assert "blurred: edges are" in result.remark
    (result,) = last(board.model_copy(update={"first_marker": 3}), seen(board)[0]).images
    assert "marker 0 is in the image, and the board as described has markers 3 to 26" in result.remark


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("chesboard:9x6:20mm", "did you mean 'chessboard'"),
        ("chessboard:9by6:20mm", "write it as chessboard:COLUMNSxROWS:SQUARE"),
        ("chessboard:1x6:20mm", "needs two or more columns"),
        ({"kind": "chessbord", "columns": 9, "rows": 6}, "did you mean 'chessboard'"),
        ({"kind": "chessboard", "columns": 9, "rows": 7, "square": "20 mm"}, "an odd and an even number"),
        ({"kind": "chessboard", "columns": 9, "rows": 6}, "needs 'square'"),
        ({"kind": "chessboard", "columns": 9, "rows": 6, "square": "20 mm", "marker": "9 mm"}, "has no 'marker'"),
        ({"kind": "circles", "columns": 4, "rows": 10, "spacing": "20 mm"}, "odd number of rows"),
        ({"kind": "charuco", "columns": 5, "rows": 7, "square": 0.02, "marker": 0.03, "dictionary": "D"}, "smaller"),
        ({"kind": "chessboard", "columns": 9, "rows": 6, "squares": "20 mm"}, "did you mean 'square'"),
        ({"kind": "chessboard", "columns": 9, "square": "20 mm"}, "key 'rows' is missing"),
        ({"kind": "chessboard", "columns": 9, "rows": 6, "square": "20 kg"}, "square"),
        ([], "is not a mapping"),
    ],
)
def test_bad_boards_are_one_line(given, words):
    is_text = isinstance(given, str)
    with pytest.raises(DescriptionError) as error:
        read_board_option(given) if is_text else validate_board(given, "board.yaml")
    assert words in str(error.value)
    assert str(error.value).startswith(f"--board {given}: " if is_text else "board.yaml: ")


def test_too_little_turned_and_points_that_no_image_shows_are_said(tmp_path, run_calib):
    board = read_board_option("charuco:5x6:30mm:22mm:DICT_5X5_100")
    for k in range(4):
        flat = seen(board, np.array([[1.0, 0.0, 100.0 + 9 * k], [0.0, 1.0, 60.0], [2e-5, 0.0, 1.0]]))[0]
        cv2.imwrite(str(tmp_path / f"{k}.png"), flat)
    larger = ("--board", "charuco:5x7:30mm:22mm:DICT_5X5_100")
    said = run_calib("detect", tmp_path, *larger, "--out", tmp_path / "p.csv").out
    assert "deg about a second\nThat is too little to find where the camera is: tilt the tool by 20 to 40 deg" in said
    assert "In no image: 4 points of the board (c20, c21, c22, c23); check columns and rows" in said


def test_simulated_photographs_show_all_of_a_board_without_markers():
    for text in (BOARDS["chessboard"], BOARDS["circles"]):
        board = read_board_option(text)
        shown = example(board, 3, np.random.default_rng(0))
        images = [decode(content, name) for name, content in shown.items() if name.endswith(".png")]
        assert all(len(image.points) == len(board.points()) for image in last(board, *images).images)


def test_pages_to_print_have_the_true_size():
    board = read_board_option(CHARUCO)
    svg = page(board, "svg", "a3").decode()
    assert 'width="297mm" height="420mm"' in svg
    assert page(board, "pdf", None).startswith(b"%PDF")
    with pytest.raises(InputError, match="take larger paper"):
        page(read_board_option("chessboard:9x6:50mm"), "pdf", "a4")


ROS = """image_width: 1280
image_height: 960
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [900, 0, 640, 0, 905, 470, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.05, 0.001, -0.002, 0.01]}
"""


def test_intrinsics_are_read_from_opencv_and_ros(tmp_path):
    stored = cv2.FileStorage(str(tmp_path / "opencv.yaml"), cv2.FILE_STORAGE_WRITE)
    for name, value in yaml.safe_load(ROS.replace("camera_name: narrow\n", "")).items():
        stored.write(name, np.array(value["data"]).reshape(-1, value["cols"]) if isinstance(value, dict) else value)
    stored.release()
    (tmp_path / "ros.yaml").write_text(ROS)
    for file in ("opencv.yaml", "ros.yaml"):
        camera = read_camera(tmp_path / file)
        assert camera.intrinsics.tolist() == [900, 905, 640, 470, -0.1, 0.05, 0.001, -0.002, 0.01]
        assert camera.image == (1280, 960)


def test_all_ways_to_write_a_rotation_give_the_same(tmp_path):
    rotation = cv2.Rodrigues(np.array([0.3, -0.4, 0.5]))[0]
    r = Rotation.from_matrix(rotation)
    x, y, z, w = r.as_quat()
    roll, pitch, yaw = r.as_euler("xyz", degrees=True)
    forms = {
        "qx,qy,qz,qw": (x, y, z, w),
        "q1,q2,q3,q4": (w, x, y, z),
        "roll [deg],pitch [deg],yaw [deg]": (roll, pitch, yaw),
        "W [deg],P [deg],R [deg]": (roll, pitch, yaw),
        "A [deg],B [deg],C [deg]": (yaw, pitch, roll),
        "rx,ry,rz": (0.3, -0.4, 0.5),
    }
    for header, numbers in forms.items():
        columns = f"image,x [mm],y [mm],z [mm],{header}"
        file = write_table(tmp_path / "poses.csv", columns, ["a.png"], [[100, 200, 300, *numbers]])
        names, poses = read_tool_poses(file, angles="rotvec")
        assert names == ["a"]
        assert np.allclose(poses[0, :3, :3], rotation, atol=1e-12)
        assert np.allclose(poses[0, :3, 3], [0.1, 0.2, 0.3])


BAD_FILES = {
    read_camera: [
        (ROS.replace("plumb_bob", "equidistant"), "fish-eye"),
        (ROS.replace("plumb_bob", "cubic"), "'cubic' is not known"),
        (ROS.replace("cols: 5, data: [-0.1, 0.05, 0.001, -0.002, 0.01]", "cols: 6, data: [0, 0, 0, 0, 0, 0.1]"), "k4"),
        (ROS.replace("900, 0, 640", "900, 3, 640"), "skew"),
        (
            ROS.replace("0, 640, 0, 905, 470, 0, 0, 1]", "0, 0, 0, 905, 0, 640, 470, 1]"),
            "transpose it if it is MATLAB's",
        ),
        (ROS.replace("900, 0, 640", "-900, 0, 640"), "positive"),
        (ROS.replace("0, 0, 1]", "0, 0]"), "a camera matrix has 9"),
        (ROS.replace("900", "nine"), "not a number"),
        ("a: [1", "not valid YAML"),
        ("just text", "holds no intrinsics"),
        ("image_width: 12\n", "has no camera_matrix"),
    ],
    read_tool_poses: [
        ("image,x,y,qx,qy,qz,qw\na,0,0,0,0,0,1\n", "no column 'z'"),
        ("image,x,y,z\na,0,0,0\n", "no rotation"),
        ("image,x,y,z,qx,qy,qz,qw\na,0,0,0,0,0,1,1\n", "not a quaternion of length 1"),
        ("image,x,y,z,rx,ry,rz\na,0,0,0,0,0,1\n", "--angles rotvec or --angles rpy"),
        ("x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n", "no column 'image' or 'pose'"),
        ("image,x,y,z,qx,qy,qz,qw\na,0,0,0,0,0,0,1\na,0,0,0,0,0,0,1\n", "'a' comes twice"),
        ("image,x,y,z,qx,qy,qz,qw\na,zero,0,0,0,0,0,1\n", "zero"),
    ],
}


@pytest.mark.parametrize(("read", "text", "words"), [(read, *case) for read, of in BAD_FILES.items() for case in of])
def test_bad_cameras_and_poses_are_one_line(tmp_path, read, text, words):
    (tmp_path / "file").write_text(text)
    with pytest.raises((DescriptionError, DataError)) as error:
        read(tmp_path / "file")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_images_that_cannot_be_read_are_said_and_the_rest_goes_on(tmp_path, run_calib):
    board = read_board_option(CHARUCO)
    cv2.imwrite(str(tmp_path / "shot_2.png"), seen(board)[0])
    (tmp_path / "shot_10.png").write_bytes(b"no image")
    (tmp_path / "shot_1.png").write_bytes(b"")
    (tmp_path / "shot_11.png").write_bytes((tmp_path / "shot_2.png").read_bytes()[:-500])
    cv2.imwrite(str(tmp_path / "shot_12.png"), seen(board)[0][:-9])
    cv2.imwrite(str(tmp_path / "shot_13.png"), seen(board)[0])
    assert [shot.name for shot in shots([str(tmp_path)])] == [f"shot_{k}" for k in (1, 2, 10, 11, 12, 13)]
    done = run_calib("detect", ".", "--board", CHARUCO, "--out", "out.csv", "--json", "d.json", cwd=tmp_path)
    assert done.code == 0
    assert "left out: shot_10: is not an image that can be read" in done.err
    assert "left out: shot_11: is cut off" in done.err
    assert "left out: shot_12: is 900 x 751 px, and most images are 900 x 760" in done.err
    assert "70 points in 2 of 6 images" in done.out
    assert "shot_2,c0," in (tmp_path / "out.csv").read_text()
    assert json.loads((tmp_path / "d.json").read_text())["n_points"] == 70
    with pytest.raises(DataError, match="no such file"):
        read_image(tmp_path / "none.png")
    for given in (["none/*.png"], [str(tmp_path / "none.png")]):
        with pytest.raises(InputError, match="no such image"):
            shots(given)


def test_ten_minutes_to_hand_eye(tmp_path, run_calib):
    """Board, simulated photographs, one command: the camera where the simulation has it."""
    (tmp_path / "board.yaml").write_text(
        "kind: charuco\ncolumns: 5\nrows: 7\nsquare: 30 mm\nmarker: 22 mm\ndictionary: DICT_5X5_100\n"
    )
    board = ("--board", "board.yaml")
    assert run_calib("board", *board, "--out", "b.pdf", "--photographs", "shots", cwd=tmp_path).code == 0
    _, poses = read_tool_poses(tmp_path / "shots" / "poses.csv")
    found = ("detect", "shots", *board, "--out", "p.csv", "--json", "-", "--page", "found.html")
    turned = json.loads(run_calib(*found, cwd=tmp_path).out)["turned_rad"]
    assert np.allclose(turned, turning(poses), atol=0.02)  # the lens is not known there: a degree
    assert (tmp_path / "found.html").read_text().count("<svg") == len(poses)
    command = ("hand-eye", "shots", *board, "--poses")
    done = run_calib(*command, "shots/poses.csv", "--out", "out", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "camera on the tool" in done.out
    result = json.loads((tmp_path / "out" / "hand_eye.json").read_text())
    assert result["verdict"] == "PASS"
    assert result["next"][0].startswith("no more photographs are needed for poses like these")
    truth = json.loads((tmp_path / "shots" / "truth.json").read_text())
    away = np.array(result["camera"]["matrix"])[:3, 3] - np.array(truth["camera_in_tool"])[:3, 3]
    assert np.linalg.norm(away) < 1.5e-3
    page = (tmp_path / "out" / "photographs.html").read_text()
    assert 'class="verdict PASS"' in page
    # each belongs to a mark of the plots
    assert page.count("<svg") == page.count('data-row="') == len(result["images"])
    assert all(f'id="{name}"' in page for name in ("images", "pixels", "tool"))
    assert run_calib(*command, "board.yaml", "--out", "other", cwd=tmp_path).code == 2
    assert not (tmp_path / "other").exists()
    first = tmp_path / "shots" / "shot_01.png"
    cv2.imwrite(str(first), cv2.imread(str(first))[:, ::-1])
    for more in sorted((tmp_path / "shots").glob("shot_*.png"))[8:]:
        more.unlink()
    doubted = run_calib(*command, "shots/poses.csv", "--camera-on", "tool", "--out", "other", cwd=tmp_path)
    assert "Verdict: CHECK" in doubted.out
    assert "mirrored images were left out: shot_01" in " ".join(doubted.out.split())


def test_mistakes_of_options_are_one_line_and_nothing_is_written(tmp_path, run_calib):
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((60, 80), 127, np.uint8))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "shot_03.png").write_bytes(b"mine")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    cases = [
        (("detect", "empty.png", "--board", CHARUCO, "--columns", "a,b"), "--columns 'a,b': give one word"),
        (("detect", "empty.png", "--board", "none.yaml"), "none.yaml: no such file; give a board"),
        (("detect", "empty.png", "--board", CHARUCO), "no board in 1 image; empty: no board found: no marker of"),
        (("hand-eye", "empty.png", "--board", CHARUCO), "give the pose of the tool at each image with --poses FILE"),
        (("board", "--board", CHARUCO, "--photographs", "mine"), "shot_03.png: was not written by this program"),
    ]
    for words, said in cases:
        done = run_calib(*words, "--out", "out.pdf" if words[0] == "board" else "out.csv", cwd=tmp_path)
        assert done.code == 2
        assert said in done.err.splitlines()[-1]
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("turns", range(4))
def test_a_square_grid_of_dots_begins_at_its_larger_dot(turns):
    board = read_board_option("dots:7x5:20mm")
    image, homography = seen(board)
    turned = np.ascontiguousarray(np.rot90(image, turns))
    (result,) = last(board, turned).images
    places = np.array([board.points()[name][:2] for name in result.points])
    expected = cv2.perspectiveTransform(places[None], homography)[0]
    for _ in range(turns):  # a quarter turn of the image to the left takes (x, y) to (y, width - 1 - x)
        expected = np.column_stack([expected[:, 1], image.shape[1] - 1 - expected[:, 0]])
        image = np.rot90(image)
    assert len(result.points) == 35
    assert np.max(np.linalg.norm(result.pixels - expected, axis=1)) < 1.0


def test_one_marker_alone_is_a_board():
    board = read_board_option("aruco:1x1:80mm:10mm:DICT_4X4_50")
    content = {"kind": "aruco", "columns": 1, "rows": 1, "marker": "80 mm", "gap": "10 mm", "dictionary": "DICT_4X4_50"}
    assert board == validate_board(content, "b")
    (result,) = last(board, seen(board)[0]).images
    assert result.points == ("m0.0", "m0.1", "m0.2", "m0.3")


def test_a_target_of_kalibr_is_counted_from_the_bottom(tmp_path):
    (tmp_path / "grid.yaml").write_text(
        "target_type: 'aprilgrid'\ntagCols: 4\ntagRows: 3\ntagSize: 0.04\ntagSpacing: 0.25\n"
    )
    board = read_board_option(str(tmp_path / "grid.yaml"))
    assert (board.kind, board.columns, board.rows, board.marker, board.gap) == ("apriltag", 4, 3, 0.04, 0.01)
    assert np.allclose(board.points()["m0.0"], (0, 0.1, 0))  # the first tag lies in the last row
    assert np.allclose(board.points()["m8.0"], (0, 0, 0))
    image, _ = seen(board)
    assert len(last(board, image).images[0].points) == 48
    (other,) = last(read_board_option("apriltag:4x3:40mm:10mm"), image).images
    assert "its markers are counted from the bottom row; write first_row: bottom" in other.remark
    circles = "target_type: 'circlegrid'\ntargetCols: 4\ntargetRows: 11\nspacingMeters: 0.02\n"
    (tmp_path / "grid.yaml").write_text(f"{circles}asymmetricGrid: True\n")
    assert str(read_board_option(str(tmp_path / "grid.yaml"))) == str(read_board_option("circles:4x11:20mm"))
    (tmp_path / "grid.yaml").write_text(f"{circles}asymmetricGrid: False\n")
    with pytest.raises(DescriptionError, match="is a target file of Kalibr, of which aprilgrid"):
        read_board_option(str(tmp_path / "grid.yaml"))


def test_a_grid_of_ros_industrial_begins_at_its_larger_dot_at_the_bottom_left(tmp_path):
    (tmp_path / "grid.yaml").write_text("target_finder: {type: M, rows: 5, cols: 7, spacing: 0.02}\n")
    board = read_board_option(str(tmp_path / "grid.yaml"))
    # 7 across and 5 down, once its larger dot is at the bottom left
    image, _ = seen(read_board_option("dots:5x7:20mm"))
    assert board.kind == "dots"
    assert len(last(board, np.ascontiguousarray(np.rot90(image))).images[0].points) == 35


def test_pixels_may_have_their_unit(tmp_path):
    board = read_board_option("aruco:1x1:80mm:0.1mm:DICT_4X4_50")
    rows = "".join(f"a,m0.{k},{10 * k},{20 * k}\n" for k in range(4))
    (tmp_path / "d.csv").write_text(f"# image: 640 x 480 px\npose,point,camera_u [px],camera_v [px]\n{rows}")
    (image,) = _read_detected(str(tmp_path / "d.csv"), board)
    assert image.pixels.tolist() == [[0, 0], [10, 20], [20, 40], [30, 60]]

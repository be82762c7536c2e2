import ast
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calib.core.base.contributions import contributions_to
from calib.core.base.errors import DataError, NotIdentifiableError
from calib.photographs import starts
from calib.photographs.camera_alone import free_boards, intrinsics_at_first, point_errors
from calib.photographs.estimation import plain, rms, solve, weigh_images
from calib.photographs.hand_eye import calibrate
from calib.photographs.hand_eye_result import Frames, content, files, judge, report
from calib.photographs.mistakes import other_readings
from calib.photographs.opencv import opencv
from calib.photographs.robot_errors import ErrorSizes
from calib.photographs.scene import POSES, HandEyePlacement, HandEyeUnknowns, plane_errors_on_board, residuals, rows
from tests.photographs.camera_scenes import BOARD, CAMERA, INTRINSICS, pixels_from, pose, scene

pytest.importorskip("cv2", reason="extra 'camera'")


def codes(result):
    return [mistake.code for mistake in result.mistakes]


@pytest.fixture(scope="module")
def clean():
    return scene(12, "tool", seed=3, noise=0.3, shift=2e-4, turn=2e-4)


@pytest.fixture(scope="module")
def good(clean):
    return calibrate(clean, INTRINSICS, mounts=("tool",))


def test_good_photographs_show_no_mistake(good):
    assert (codes(good), judge(good).grade, good.lens_found) == ([], "PASS", False)


def test_intervals_and_limit_name_what_they_contain(good):
    assert all(own <= contributions_to(number) for number, own in good.contains.items())
    named = content(good, Frames())["contains"]
    assert named["position"] == ["noise and priors", "scatter of poses", "unexplained joint errors"]
    assert named["claim"] == ["poses left out"]


@pytest.mark.parametrize("mount", ["tool", "base"])
def test_camera_board_and_mount_are_found_without_any_guess(mount):
    exact = scene(8, mount, noise=0.0)
    begin = starts.start(exact, INTRINSICS)
    assert begin.scene.mount == mount
    solution = solve(begin.scene, begin.placed, POSES, ErrorSizes())
    assert np.allclose(solution.camera, CAMERA[mount], atol=1e-9)
    assert np.allclose(solution.board, BOARD[mount], atol=1e-9)


def test_derivatives_agree_with_central_differences():
    for mount in ("tool", "base"):
        view = scene(3, mount, noise=0.5, shift=1e-3)
        placed = HandEyePlacement(CAMERA[mount], BOARD[mount], INTRINSICS, 1.01)
        unknowns, h = HandEyeUnknowns((0, 1, 2, 3, 4, 5), INTRINSICS[:6], np.full(6, np.inf), scaled=True), 1e-6
        _, by_unknown, by_error = rows(view, placed, unknowns)
        for k in range(19):
            step = np.zeros(19)
            step[k] = h
            ahead, back = (residuals(view, placed.step(sign * step, unknowns)) for sign in (1, -1))
            assert np.allclose(by_unknown[:, :, k], (ahead - back) / (2 * h), atol=2e-3, rtol=1e-5)
        for k in range(6):
            twist = np.zeros(6)
            twist[k] = h
            turned = [view.tool @ pose(sign * twist[:3], np.rad2deg(sign * twist[3:])) for sign in (1, -1)]
            ahead, back = (residuals(replace(view, tool=tool), placed) for tool in turned)
            assert np.allclose(by_error[:, :, k], (ahead - back) / (2 * h), atol=2e-3, rtol=1e-5)


@pytest.mark.parametrize("weighed", [False, True])
def test_an_image_left_out_is_predicted_by_a_fit_of_the_others(weighed):
    """The fit without it is linear around that of all; its errors of the second order are a thousandth."""
    view = scene(12, "tool", noise=0.4, shift=5e-4, turn=3e-4)
    whole = plain(view, HandEyePlacement(CAMERA["tool"], BOARD["tool"], INTRINSICS))
    whole = weigh_images(whole) if weighed else whole
    for left in range(12):
        of_image, others = view.image == left, np.arange(12) != left
        alone = solve(view.select_images(others), whole.placed, POSES, whole.weights)
        pixels, board = residuals(view, alone)[of_image], plane_errors_on_board(view, alone)[of_image]
        assert rms(whole.left_out.pixels[of_image] - pixels) < 2e-3 * rms(pixels)
        assert rms(whole.left_out.board[of_image] - board) < 5e-3 * rms(board)


def test_of_three_images_no_two_predict_the_third():
    """Two poses leave a turn and a shift of the camera open, so that no error of new images is known."""
    result = calibrate(scene(3, "tool", noise=0.2, shift=2e-4), INTRINSICS, mounts=("tool",))
    assert np.all(np.isnan(result.left_out.pixels))
    assert judge(result).grade == "CHECK"
    assert "no image follows from the others: there are too few images" in report(result, Frames())
    assert "nan" not in report(result, Frames())
    assert content(result, Frames())["on_board_m"]["left_out"] is not None


def test_rounding_of_computed_photographs_decides_nothing():
    result = calibrate(scene(8, "tool", noise=0.0), INTRINSICS, mounts=("tool",))
    assert (result.lens_found, result.weighed, codes(result)) == (False, False, [])
    assert rms(result.left_out.pixels) < 1e-9


def test_millimetres_on_the_board_are_where_rays_meet_its_plane():
    view = scene(2, "tool", noise=0.0)
    placed = HandEyePlacement(CAMERA["tool"], BOARD["tool"], INTRINSICS)
    assert np.max(np.abs(plane_errors_on_board(view, placed))) < 1e-9
    moved = replace(view, body=view.body + np.array([1e-3, -2e-3, 0.0]))
    assert np.allclose(plane_errors_on_board(moved, placed), [-1e-3, 2e-3], atol=1e-9)


def test_the_lens_is_found_where_none_is_given():
    result = calibrate(scene(8, "base", noise=0.2), None, mounts=("base",))
    assert result.lens_found
    assert np.allclose(result.fitted.placed.intrinsics[:4], INTRINSICS[:4], atol=2.0)
    assert rms(result.pixels) < 0.3


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_focal_length_is_found_from_tilted_boards_and_refused_from_those_seen_from_the_front(noise):
    tilted = scene(8, "tool", noise=noise)
    assert intrinsics_at_first(tilted)[0] == pytest.approx(INTRINSICS[0], rel=0.06)  # the lens has distortion
    flat = [pose((0.0, 0.01 * k, 0.5 + 0.02 * k), (0, 0, 20 * k)) for k in range(8)]
    pixels = pixels_from(flat)
    pixels += noise * np.random.default_rng(0).standard_normal(pixels.shape)
    with pytest.raises(NotIdentifiableError, match="do not determine the focal length"):
        intrinsics_at_first(replace(tilted, pixels=pixels))


@pytest.mark.quick(0)
def test_the_robots_part_is_told_from_the_cameras():
    view = scene(12, "tool", noise=0.2, shift=4e-4, turn=3e-4)
    result = calibrate(view, INTRINSICS, mounts=("tool",), lens="given")
    noise = result.fitted.noise
    assert noise.pixel == pytest.approx(0.2, rel=0.1)
    assert noise.shift == pytest.approx(4e-4, rel=0.4)  # 60 squares: 12 images of 6, less 12 unknowns
    assert rms(result.residuals_without_robot) < 0.35 < rms(result.pixels)
    assert "comes from the robot's poses" in report(result, Frames())
    exact = calibrate(scene(8, "tool", noise=0.2), INTRINSICS, mounts=("tool",), lens="given")
    assert exact.fitted.noise.shift < 5e-5


def test_what_new_images_stay_below_holds_for_errors_that_an_image_shares(good):
    generator, size = np.random.default_rng(5), 7e-4
    n, m = len(good.scene), len(good.scene.pixels)
    held, widths = [], []
    for _ in range(400):
        used, new = size * generator.standard_normal((2, n, 2))
        left = replace(good.left_out, pixels=np.full((m, 2), 50.0), board=used[good.scene.image])
        limit = replace(good, left_out=left).limit
        held.append(np.sqrt(np.mean(np.sum(new**2, axis=1))) < limit)
        widths.append(limit / np.sqrt(np.mean(np.sum(used**2, axis=1))))
    assert np.mean(held) > 0.97  # more than 0.95: these errors, unlike those of a fit, are independent
    # F for 12 and 12, from tables, an image being one
    assert np.median(widths) == pytest.approx(np.sqrt(2.69), rel=0.03)


def test_order_names_and_the_boards_origin_do_not_matter():
    view = scene(5, "tool", noise=0.3, shift=3e-4)
    result = calibrate(view, INTRINSICS, mounts=("tool",), lens="given")
    order = np.random.default_rng(1).permutation(len(view.image))
    order = order[np.argsort(view.image[order], kind="stable")]
    body = view.body[order] - [0.09, 0.12, 0.0]
    other = replace(view, names=tuple("abcde"), body=body, pixels=view.pixels[order])
    moved = calibrate(other, INTRINSICS, mounts=("tool",), lens="given")
    back = moved.fitted.placed.board @ pose((-0.09, -0.12, 0.0), (0, 0, 0))
    assert np.allclose(moved.fitted.placed.camera, result.fitted.placed.camera, atol=1e-9)
    assert np.allclose(back, result.fitted.placed.board, atol=1e-9)


@pytest.mark.amount(1, 6)
def test_each_mistake_is_named_and_none_passes(amount):
    """The images of which a mistake is made, what is named and said, and the grade."""
    view = scene(8, "tool", noise=0.2, shift=2e-4, turn=2e-4)
    base = scene(8, "base", noise=0.2, shift=2e-4, turn=2e-4)
    swapped = INTRINSICS[[0, 1, 3, 2, 4, 5, 6, 7, 8]] + [0, 0, -40, 120, 0, 0, 0, 0, 0]
    late = np.arange(8)[:, None, None]
    moved = np.where(late >= 5, pose((4e-3, 0, 0), (0, 0, 0)) @ view.tool, view.tool)
    far = np.where(late >= 4, base.tool @ pose((0.03, 0.01, 0.0), (0, 0, 4)), base.tool)
    cases = (
        ("moved", replace(view, tool=moved), INTRINSICS, "", ("CHECK", "FAIL")),
        ("pairs_shifted", replace(view, tool=np.roll(view.tool, 1, axis=0)), INTRINSICS, "", ("CHECK", "FAIL")),
        ("principal_point", view, swapped, "", ("CHECK", "FAIL")),
        ("square_size", replace(view, body=view.body / 1.02), INTRINSICS, "", ("CHECK", "FAIL")),
        ("square_size", replace(view, body=1.2 * view.body), INTRINSICS, "17 % smaller", ("FAIL",)),
        ("moved", replace(base, tool=far), INTRINSICS, "the board moved before image shot_05", ("FAIL",)),
    )
    for code, case, intrinsics, said, grades in cases[:amount]:
        result = calibrate(case, intrinsics, mounts=(case.mount,))
        judgement = judge(result)
        assert code in (codes(result)[:1] if said else codes(result))
        assert said in judgement.reasons[0]
        assert judgement.grade in grades


@pytest.mark.quick(0)
@pytest.mark.amount(1, 2)
def test_exchanged_intrinsics_are_named_and_do_not_spoil_the_lens_found(amount):
    view = scene(6, "base", noise=0.2)
    for order, words in (((2, 1, 0, 3), "fx and cx"), ((0, 1, 3, 2), "cx and cy"))[:amount]:
        swapped = INTRINSICS[[*order, 4, 5, 6, 7, 8]]
        result = calibrate(view, swapped, mounts=("base",))
        assert codes(result) == ["lens_given"]
        assert f"({words} are exchanged)" in judge(result).reasons[0]
        assert judge(result).grade == "CHECK"
        assert np.allclose(result.fitted.placed.intrinsics[:4], INTRINSICS[:4], atol=2.0)
        kept = calibrate(view, swapped, lens="given", mounts=("base",))
        assert codes(kept)[0] == "lens_given"
        assert judge(kept).grade == "FAIL"


def misread(exact):
    """An exact scene as it is read where files mean something else, by words of what is wrong."""
    rotation = Rotation.from_matrix(exact.tool[:, :3, :3])
    quaternions = rotation.as_quat()
    ways = {
        "real part first": Rotation.from_quat(np.roll(quaternions, 1, axis=1)),
        "real part last": Rotation.from_quat(np.roll(quaternions, -1, axis=1)),
        "rotations are inverted": rotation.inv(),
        "the new y and the new z": Rotation.from_euler("xyz", rotation.as_euler("XYZ")),
        "first angle is about z": Rotation.from_euler("xyz", rotation.as_euler("xyz")[:, ::-1]),
    }
    for words, read in ways.items():
        tool = exact.tool.copy()
        tool[:, :3, :3] = read.as_matrix()
        yield words, replace(exact, tool=tool)
    yield "10 times as large", replace(exact, body=0.1 * exact.body)
    yield "mirrored", replace(exact, pixels=exact.pixels * [-1, 1] + [exact.size[0] - 1, 0])


def same(scene, other):
    return all(np.allclose(getattr(scene, part), getattr(other, part)) for part in ("tool", "body", "pixels"))


def test_of_other_readings_just_the_one_that_is_named_gives_the_scene_back():
    """What is tried and found to explain the images: it is the real scene, whatever finds it."""
    exact = scene(9, "tool", noise=0.0)
    for words, wrong in misread(exact):
        tried = other_readings(wrong, ("tool",))
        (fits,) = [text for _, text, other in tried if len(other) == len(exact) and same(other, exact)]
        assert words in fits


@pytest.mark.amount(0, 6)
def test_another_reading_is_named_with_what_it_leaves(amount):
    for words, wrong in list(misread(scene(7, "tool", noise=0.2, shift=2e-4, turn=2e-4)))[:amount]:
        judgement = judge(calibrate(wrong, INTRINSICS, mounts=("tool",)))
        assert judgement.grade == "FAIL"
        assert words in judgement.reasons[0]


@pytest.mark.quick(0)
@pytest.mark.amount(1, 2)
def test_inverted_poses_are_named_where_the_mount_is_stated_and_doubted_where_it_is_not(amount):
    for mount in ("base", "tool")[:amount]:
        exact = scene(5, mount, noise=0.2, shift=2e-4, turn=2e-4)
        inverted = replace(exact, tool=np.linalg.inv(exact.tool))
        stated = calibrate(inverted, INTRINSICS, mounts=(mount,))
        assert "poses_inverted" in codes(stated)
        assert judge(stated).grade == "FAIL"
        assert codes(calibrate(inverted, INTRINSICS)) == ["exchanged"]


@pytest.mark.amount(1, 3)
def test_distortion_that_single_images_show_is_found_behind_the_robots_errors(amount):
    for seed in range(amount):
        result = calibrate(scene(8, "tool", seed=seed, noise=0.15, shift=3e-4, turn=3e-4), None, mounts=("tool",))
        assert len(result.fitted.unknowns.free) == 6
        assert result.fitted.placed.intrinsics[4] == pytest.approx(INTRINSICS[4], abs=0.03)


def test_one_wrong_image_is_set_aside_by_name_with_how_far_its_pose_is_off():
    view = scene(9, "base", noise=0.2, shift=2e-4)
    tool = view.tool.copy()
    tool[4] = tool[4] @ pose((0.0, 0.012, 0.0), (0, 0, 0))
    result = calibrate(replace(view, tool=tool), INTRINSICS, mounts=("base",), lens="given")
    assert [image.name for image in result.outlying_images] == ["shot_05"]
    assert result.outlying_images[0].shift_m == pytest.approx(0.012, rel=0.15)
    assert judge(result).grade == "CHECK"
    assert "shot_05" not in result.scene.names


def test_turning_about_one_axis_alone_is_refused_or_said():
    item = scene(8, "tool", noise=0.1)
    spin = np.array([item.tool[0] @ pose((0, 0, 0), (0, 0, 10 * k)) for k in range(8)])
    pixels = pixels_from(np.linalg.inv(CAMERA["tool"]) @ np.linalg.inv(spin) @ BOARD["tool"])
    with pytest.raises(NotIdentifiableError, match="about two axes or more"):
        calibrate(replace(item, tool=spin, pixels=pixels), INTRINSICS, mounts=("tool",), lens="given")


def test_too_few_images_are_an_error():
    with pytest.raises(DataError, match="give at least 3"):
        calibrate(scene(2, "tool"), INTRINSICS)


@pytest.mark.parametrize("mount", ["tool", "base"])
def test_exported_files_hold_the_same_transform_in_the_direction_of_their_format(mount, good):
    result = replace(good, scene=replace(good.scene, mount=mount))
    made = {name: text.decode() for name, text in files(result, Frames("world", "flange", "cam", "chart")).items()}
    want, parent = result.fitted.placed.camera, {"tool": "flange", "base": "world"}[mount]
    at = made["static_transform.sh"].split("static_transform_publisher ")[1].split()
    publisher = dict(zip(at[::2], at[1::2], strict=True))
    launched = ast.literal_eval(re.search(r"arguments=(\[.*\])", made["camera_pose.launch.py"])[1])
    compile(made["camera_pose.launch.py"], "camera_pose.launch.py", "exec")
    assert dict(zip(launched[::2], launched[1::2], strict=True)) == publisher
    assert (publisher["--frame-id"], publisher["--child-frame-id"]) == (parent, "cam")  # tf2: the child in the parent
    first, second = (yaml.safe_load(made[name]) for name in ("easy_handeye.yaml", "easy_handeye2.calib"))
    json_camera = json.loads(made["hand_eye.json"])["camera"]
    assert (json_camera["parent"], json_camera["child"]) == (parent, "cam")
    keys = ("x", "y", "z", "qx", "qy", "qz", "qw")
    moved, turned = (second["transform"][part] for part in ("translation", "rotation"))
    forms = [
        [float(publisher[f"--{key}"]) for key in keys],
        [first["transformation"][key] for key in keys],
        [*(moved[key] for key in "xyz"), *(turned[key] for key in "xyzw")],
        [json_camera[key] for key in keys],
    ]
    for numbers in forms:
        assert np.allclose(numbers[:3], want[:3, 3], rtol=0, atol=1e-11)
        assert np.allclose(Rotation.from_quat(numbers[3:]).as_matrix(), want[:3, :3], rtol=0, atol=1e-11)
    assert np.allclose(np.loadtxt(made["camera_matrix.txt"].splitlines()), want, rtol=0, atol=1e-14)
    assert np.allclose(json_camera["matrix"], want, rtol=0, atol=0)
    hand = mount == "tool"
    # easy_handeye passes the keys to a constructor, which needs the first and knows these alone
    assert first["parameters"] == {
        "namespace": f"/easy_handeye_eye_on_{'hand' if hand else 'base'}/",
        "move_group_namespace": "/",
        "move_group": "manipulator",
        "eye_on_hand": hand,
        "robot_base_frame": "world",
        "robot_effector_frame": "flange",
        "tracking_base_frame": "cam",
        "tracking_marker_frame": "chart",
    }
    assert second["parameters"]["calibration_type"] == ("eye_in_hand" if hand else "eye_on_base")
    assert content(result, Frames())["camera_on"] == mount


@pytest.mark.quick(0)
def test_corners_that_are_off_go_by_themselves_and_are_no_doubt(clean, good):
    assert not np.any(point_errors(clean, INTRINSICS, (0, 1, 2, 3, 4, 5)))
    off = {7: (6.0, 0.0), 11: (0.0, -5.0), 105: (-4.0, 4.0), 184: (9.0, 3.0)}  # two of them in one image
    pixels = clean.pixels.copy()
    pixels[list(off)] += list(off.values())
    result = calibrate(replace(clean, pixels=pixels), INTRINSICS, mounts=("tool",))
    told = {(point.image, (point.u, point.v)) for point in result.points_off}
    assert told == {(clean.names[clean.image[k]], tuple(pixels[k].tolist())) for k in off}
    distances = sorted((point.distance_px for point in result.points_off), reverse=True)
    assert np.allclose(distances, sorted((np.hypot(*step) for step in off.values()), reverse=True), atol=1.2)  # 4 sigma
    assert judge(result).grade == "PASS"
    assert rms(result.left_out.board) < 1.02 * rms(good.left_out.board)
    assert f"4 of {len(pixels)}: " in report(result, Frames())
    assert len(content(result, Frames())["points_left_out"]) == 4


@pytest.mark.quick(0)
def test_so_many_corners_off_are_a_reason_to_look():
    images = scene(8, "tool", seed=4, noise=0.1)
    generator, pixels = np.random.default_rng(1), images.pixels.copy()
    chosen = np.concatenate([np.flatnonzero(images.image == i)[[1, 8, 17]] for i in range(8)])
    pixels[chosen] += generator.choice([-6.0, 6.0], (len(chosen), 2))
    result = calibrate(replace(images, pixels=pixels), INTRINSICS, mounts=("tool",), lens="given")
    assert len(result.points_off) >= len(chosen) - 2
    assert judge(result).grade == "CHECK"
    assert any("points do not fit the others of their image" in reason for reason in judge(result).reasons)


def test_a_place_that_is_known_to_a_twentieth_of_the_distance_is_no_pass(good):
    """The same photographs, with a covariance as of poses that say little."""
    shift, turn = good.uncertainty()["camera"]
    assert max(shift / good.distance, turn) < 0.01
    for times, grade in ((0.045, "PASS"), (0.055, "CHECK")):
        wider = (times / max(max(part[0] / good.distance, part[1]) for part in good.uncertainty().values())) ** 2
        wide = replace(good, fitted=replace(good.fitted, covariance=wider * good.fitted.covariance))
        assert judge(wide).grade == grade
    assert any("is known to only" in reason for reason in judge(wide).reasons)
    assert 0.4 < good.distance < 0.7  # where the set-up has the board


def test_the_free_boards_are_the_same_to_the_last_bit_however_many_threads_opencv_has():
    cv2 = opencv()
    threads, images = cv2.getNumThreads(), scene(40, "tool", seed=3, noise=0.3)
    lenses = []
    for count in (1, 3, 4):
        cv2.setNumThreads(count)
        lenses.append(free_boards(images, INTRINSICS, (0, 1, 2, 3, 4, 5)).placed.intrinsics)
        assert cv2.getNumThreads() == count
    cv2.setNumThreads(threads)
    np.testing.assert_array_equal(lenses[1:], [lenses[0]] * 2)

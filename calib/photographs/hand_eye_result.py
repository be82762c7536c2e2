"""A hand-eye calibration in words, as data, and as files of other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.contributions import Contributions, Uncertainty, names_of
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun, json_file, listing
from calib.core.instruments.camera import NAMES
from calib.photographs.estimation import LITTLE_TURN, rms, turning
from calib.photographs.hand_eye import HandEye
from calib.photographs.scene import LITTLE_COVERAGE, SIDES, Mount

FEW = 10  # images; a result of fewer gets CHECK
_MANY = 0.1  # the photographs are wrong if more than this part of the points was left out
_ROBOT_SHARE = 0.5
WIDE = 0.05
"""The pose of camera or board counts as unknown if half of a 95 % interval is wider than this: that of its angle [rad],
or that of its position, as a part of the distance between camera and board. If both are equal, they move what the
camera sees equally far. Good photographs give less than a third of this."""
_CLAIM_ABOVE = 0.5  # the images are too few if left-out ones are worse than used ones by more than this part


@dataclass(frozen=True)
class Frames:
    """Names of frames in exported files."""

    base: str = "base_link"
    tool: str = "tool0"
    camera: str = "camera_optical_frame"
    board: str = "board"

    def parents(self, mount: Mount) -> tuple[str, str]:
        """Return the frames to which camera and board are fixed."""
        return (self.tool, self.base) if mount == "tool" else (self.base, self.tool)


@dataclass(frozen=True)
class HandEyeJudgement:
    """PASS, CHECK or FAIL, with reasons and advice."""

    grade: str
    reasons: tuple[str, ...]
    advice: tuple[str, ...]

    @staticmethod
    def from_reasons(reasons: Sequence[tuple[str, str]], advice: Sequence[str]) -> HandEyeJudgement:
        """Return the judgement by reasons, each with its grade; the worst grade counts."""
        ordered = sorted(reasons, key=lambda reason: ("FAIL", "CHECK", "PASS").index(reason[0]))
        grade = ordered[0][0] if ordered else "PASS"
        return HandEyeJudgement(grade, tuple(text for _, text in ordered), tuple(dict.fromkeys(advice)))

    def lines(self) -> list[str]:
        """Return the grade and the reasons in words."""
        texts = [f"  {'     ' if k else self.grade}: {text}" for k, text in enumerate(self.reasons)]
        return [f"Verdict: {self.grade}", *texts]

    def content(self) -> dict[str, object]:
        """Return the judgement as data."""
        return {"verdict": self.grade, "reasons": list(self.reasons), "next": list(self.advice)}


def judge(result: HandEye) -> HandEyeJudgement:
    """Return the judgement of a calibration.

    FAIL: a mistake that spoils everything. CHECK: another mistake, outlying images, too few images, or too little
    rotation. PASS: none of these, so that the error of new images is as stated.
    """
    scene, advice = result.scene, list[str]()
    reasons = [mistake.text for mistake in result.mistakes if not mistake.whole]
    for image in result.outlying_images:
        reasons.append(
            f"image {image.name} is off by {image.rms_px:.0f} px, as if the tool were"
            f" {quantity_text(image.shift_m, 'mm', '.1f')} and {quantity_text(image.turn_rad, 'deg', '.2f')} elsewhere;"
            " it was left out: look at it, and at its pose"
        )
    gone, points = len(result.points_off), len(result.points_off) + len(scene.pixels)
    if gone > _MANY * points:
        reasons.append(
            f"{gone} of {points} points do not fit the others of their image: so many cannot be chance; look at the"
            " photographs (blur, reflections, a board that is not flat)"
        )
    axes = turning(scene.tool)
    if len(scene) < FEW:
        reasons.append(f"{count_noun(len(scene), 'image')} are few to judge by")
        advice.append(f"take {FEW} to 20 images")
    if axes[1] < LITTLE_TURN:
        reasons.append(
            f"the tool turned by {quantity_text(axes[0], 'deg', '.0f')} about one axis, and by"
            f" {quantity_text(axes[1], 'deg', '.0f')} about others: lengths along the first axis are poorly known"
        )
        advice.append("tilt the tool by 20 to 40 deg about two more axes")
    covered = scene.coverage
    if covered < LITTLE_COVERAGE:
        advice.append(f"bring the board into more of the image (it was seen in {100 * covered:.0f} %)")
        if result.lens_found:
            reasons.append(f"the lens was found from {100 * covered:.0f} % of the image")
    for name, (shift, turn) in result.uncertainty().items():
        if not max(shift / result.distance, turn) < WIDE:
            reasons.append(
                f"the place of the {name} is known to only ± {quantity_text(shift, 'mm', '.0f')} and ±"
                f" {quantity_text(turn, 'deg', '.1f')} (95 %). Use this calibration only for what the camera sees at"
                f" poses like these, about {quantity_text(result.distance, 'mm', '.0f')} away"
            )
            advice.append("turn the tool further, about two axes or more, at more poses; or calibrate the kinematics")
    used, left = rms(result.board), rms(result.left_out.board)
    if not left * _CLAIM_ABOVE < used:
        times = f"errors of images left out are {left / used:.1f} times those of images used"
        worse = times if np.isfinite(left) else "no image follows from the others"
        reasons.append(f"{worse}: there are too few images")
        advice.append("take more images")
    graded = [("FAIL", mistake.text) for mistake in result.mistakes if mistake.whole]
    graded += [("CHECK", text) for text in reasons]
    if not graded and not advice:
        advice.append("no more photographs are needed for poses like these; for work elsewhere, take some there")
    return HandEyeJudgement.from_reasons(graded, advice)


def contents(contains: Mapping[Uncertainty, Contributions]) -> dict[str, list[str]]:
    """Return the names of the contributions to each number, as `result.json` of a fit has them."""
    return {number.name.lower(): names_of(own) for number, own in contains.items()}


def transform(pose: FloatArray) -> dict[str, float]:
    """Return x, y, z [m] and the quaternion qx, qy, qz, qw of a pose (4, 4), qw not negative."""
    quaternion = scipy.spatial.transform.Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)
    keys = ("x", "y", "z", "qx", "qy", "qz", "qw")
    return dict(zip(keys, map(float, [*pose[:3, 3], *quaternion]), strict=True))


def report(result: HandEye, frames: Frames) -> str:
    """Return the report of a calibration in words."""
    scene, fitted = result.scene, result.fitted
    judgement, half = judge(result), result.uncertainty()
    lines = [f"Hand-eye calibration of {count_noun(len(scene), 'image')}: camera {SIDES[scene.mount]}"]
    lines += judgement.lines()
    if judgement.grade != "FAIL" and np.isfinite(result.limit):
        lines.append(
            f"Points of new images like these are {quantity_text(rms(result.left_out.board), 'mm', '.3f')} off on the"
            f" board, {rms(result.left_out.pixels):.3f} px in the image (RMS of images left out in turn). With 95 %"
            f" probability, the RMS of as many new images is below {quantity_text(result.limit, 'mm', '.3f')}"
        )
    errors, by_image = np.linalg.norm(result.board, axis=1), scene.rms_by_image(result.pixels)
    lines.append(
        f"Images used: {rms(result.pixels):.3f} px RMS; on the board {quantity_text(rms(result.board), 'mm', '.3f')}"
        f" RMS, mean {quantity_text(errors.mean(), 'mm', '.3f')}, largest {quantity_text(errors.max(), 'mm', '.3f')}"
        f" ({len(scene.pixels)} points)"
    )
    if result.points_off:
        named = [f"{p.image} at {p.u:.0f}, {p.v:.0f} px ({p.distance_px:.1f} px off)" for p in result.points_off]
        lines.append(
            f"Points left out, which do not fit the others of their image: {len(named)} of"
            f" {len(named) + len(scene.pixels)}: {listing(named, '; ', 2)}"
        )
    lines.append(_shares(result, judgement.grade != "FAIL"))
    worst = np.argsort(-by_image)[:3]
    lines.append("Largest: " + listing([f"image {scene.names[i]} {by_image[i]:.2f} px" for i in worst]))
    if result.intrinsics_given is not None and result.lens_found:
        given = f"; {result.rms_given:.3f} px with the intrinsics given" if np.isfinite(result.rms_given) else ""
        lines.append(f"Lens: found from these images (left out: {rms(result.left_out.pixels):.3f} px{given}):")
    elif result.lens_found:
        lines.append("Lens: found from these images, because none was given:")
    else:
        lines.append("Lens: as given")
    if result.lens_found:
        numbers = []
        for k, std in zip(fitted.unknowns.free, np.sqrt(np.diag(fitted.covariance)[fitted.unknowns.lens]), strict=True):
            digits = 2 if k < 4 else 4
            numbers.append(f"{NAMES[k]} {fitted.placed.intrinsics[k]:.{digits}f} ± {std:.{digits}f}")
        lines.append(f"  {', '.join(numbers)}")
    for name, above in zip(("camera", "board"), frames.parents(scene.mount), strict=True):
        pose, (shift, turn) = transform(getattr(fitted.placed, name)), half[name]
        lines.append(
            f"{name.capitalize()} in {above}: x {millimetres(pose['x']):.3f} y {millimetres(pose['y']):.3f} z"
            f" {quantity_text(pose['z'], 'mm', '.3f')},"
            f" quaternion (x y z w) {pose['qx']:.6f} {pose['qy']:.6f} {pose['qz']:.6f} {pose['qw']:.6f}; 95 %: ±"
            f" {quantity_text(shift, 'mm', '.2f')} along and ± {quantity_text(turn, 'deg', '.3f')} about the worst"
            " axis, including errors of the robot that depend on its pose"
        )
    lines += [f"Next: {text}" for text in judgement.advice]
    return "\n".join(lines)


def _shares(result: HandEye, usable: bool) -> str:
    """Sentences on the errors of the camera alone and with the robot; with advice if `usable`."""
    all_, alone = rms(result.pixels), rms(result.residuals_without_robot)
    if not np.isfinite(alone):
        return "The error of the camera alone is not known: images show fewer than six points"
    share = max(0.0, 1.0 - (alone / all_) ** 2)
    rest = quantity_text(rms(result.board) * np.sqrt(share), "mm", ".3f")
    text = (
        f"The camera alone (board placed freely in each image) leaves {alone:.3f} px. The rest comes from the"
        f" robot's poses: {100 * share:.0f} % of the squared error, {all_ * np.sqrt(share):.3f} px or {rest}"
    )
    if usable and share > _ROBOT_SHARE:
        text += "; calibrating the robot with joint values (calib init --measure camera) can remove part of that"
    return text


def content(result: HandEye, frames: Frames) -> dict[str, object]:
    """Return a calibration as data [m, rad, px]."""
    scene, fitted, half = result.scene, result.fitted, result.uncertainty()
    above = frames.parents(scene.mount)
    errors = (result.pixels, result.left_out.pixels, result.board, result.left_out.board)
    images = zip(scene.names, scene.counts, *map(scene.rms_by_image, errors), strict=True)
    return {
        **judge(result).content(),
        "contains": contents(result.contains),
        "camera_on": scene.mount,
        "camera": _place(above[0], frames.camera, fitted.placed.camera, half["camera"]),
        "board": _place(above[1], frames.board, fitted.placed.board, half["board"]),
        "intrinsics": dict(zip(NAMES, map(float, fitted.placed.intrinsics), strict=True))
        | {"found": [NAMES[k] for k in fitted.unknowns.free], "image": list(scene.size)},
        "pixels": {"rms": rms(result.pixels), "left_out": rms(result.left_out.pixels),
                   "camera_alone": rms(result.residuals_without_robot),
                   "left_out_with_given_intrinsics": result.rms_given},
        "on_board_m": {"rms": rms(result.board), "left_out": rms(result.left_out.board), "limit95": result.limit},
        "noise": {"pixel": fitted.noise.pixel, "tool_shift_m": fitted.noise.shift, "tool_turn_rad": fitted.noise.turn,
                  "arm_m_and_rad": fitted.noise.arm},
        "weighed": result.weighed,
        "images": [
            {"name": name, "points": int(n), "rms_px": px, "left_out_px": lpx, "rms_m": mm, "left_out_m": lmm}
            for name, n, px, lpx, mm, lmm in images
        ],
        "set_aside": [asdict(image) for image in result.outlying_images],
        "points_left_out": [asdict(point) for point in result.points_off],
        "mistakes": [{"code": mistake.code, "text": mistake.text} for mistake in result.mistakes],
    }  # fmt: skip


def _place(parent: str, child: str, pose: FloatArray, half: tuple[float, float]) -> dict[str, object]:
    return {
        "parent": parent, "child": child, **transform(pose), "matrix": pose.tolist(),
        "half_width95_m": half[0], "half_width95_rad": half[1],
    }  # fmt: skip


def files(result: HandEye, frames: Frames) -> dict[str, bytes]:
    """Return the transform of the camera as files of other programs, by name."""
    intrinsics = result.fitted.placed.intrinsics
    width, height = result.scene.size
    return {
        "hand_eye.json": json_file(content(result, frames)),
        **transform_files(result.fitted.placed.camera, result.scene.mount, frames),
        "camera_info.yaml": (
            f"image_width: {width}\nimage_height: {height}\ncamera_name: camera\n"
            f"camera_matrix: {{rows: 3, cols: 3, data: [{intrinsics[0]:.6f}, 0, {intrinsics[2]:.6f}, 0,"
            f" {intrinsics[1]:.6f}, {intrinsics[3]:.6f}, 0, 0, 1]}}\n"
            "distortion_model: plumb_bob\n"
            f"distortion_coefficients:"
            f" {{rows: 1, cols: 5, data: [{', '.join(f'{value:.9g}' for value in intrinsics[4:])}]}}\n"
        ).encode(),
    }  # fmt: skip


def transform_files(camera: FloatArray, mount: Mount, frames: Frames) -> dict[str, bytes]:
    """Return the pose of a camera, (4, 4) [m], in its parent frame, as files of other programs."""
    pose, above = transform(camera), frames.parents(mount)[0]
    numbers = {key: f"{value:.12f}" for key, value in pose.items()}
    arguments = [text for key, value in numbers.items() for text in (f"--{key}", value)]
    arguments += ["--frame-id", above, "--child-frame-id", frames.camera]
    hand = mount == "tool"
    matrix = "".join(" ".join(f"{value:.15g}" for value in row) + "\n" for row in camera)
    namespace = f"/easy_handeye_eye_on_{'hand' if hand else 'base'}/"
    frame_lines = (
        f"  robot_base_frame: {frames.base}\n  robot_effector_frame: {frames.tool}\n"
        f"  tracking_base_frame: {frames.camera}\n  tracking_marker_frame: {frames.board}\n"
    )
    inside = "".join(f"  {key}: {number}\n" for key, number in numbers.items())
    return {
        "camera_matrix.txt": matrix.encode(),
        "static_transform.sh": (
            "#!/bin/sh\n# the camera for ROS 2\n"
            f"exec ros2 run tf2_ros static_transform_publisher {' '.join(arguments)}\n"
        ).encode(),
        "camera_pose.launch.py": (
            f'"""The camera {SIDES[mount]}, as MoveIt launches it."""\n\nfrom launch import LaunchDescription\n'
            "from launch_ros.actions import Node\n\n\n"
            "def generate_launch_description():\n    return LaunchDescription([\n"
            '        Node(package="tf2_ros", executable="static_transform_publisher", output="log",\n'
            f"             arguments={arguments}),\n    ])\n"
        ).encode(),
        "easy_handeye.yaml": (
            f"parameters:\n  namespace: {namespace}\n  move_group_namespace: /\n  move_group: manipulator\n"
            f"  eye_on_hand: {str(hand).lower()}\n{frame_lines}transformation:\n{inside}"
        ).encode(),
        "easy_handeye2.calib": (
            f"parameters:\n  name: camera\n  calibration_type: {'eye_in_hand' if hand else 'eye_on_base'}\n"
            f"{frame_lines}  freehand_robot_movement: true\n"
            f"transform:\n  translation: {{x: {numbers['x']}, y: {numbers['y']}, z: {numbers['z']}}}\n"
            f"  rotation: {{x: {numbers['qx']}, y: {numbers['qy']}, z: {numbers['qz']}, w: {numbers['qw']}}}\n"
        ).encode(),
    }  # fmt: skip

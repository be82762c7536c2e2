"""`calib hand-eye`: pose of a camera on or beside a robot, from photographs of a board."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import click
import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.contributions import names_of
from calib.core.base.errors import ComputationError, DataError, InputError, nearest
from calib.core.base.files import write_folder
from calib.core.base.units import quantity_text
from calib.core.base.words import json_file, listing
from calib.core.commands.common import Output, load_robot, shared_options
from calib.core.data.tables import read_table
from calib.core.instruments.board import Board
from calib.core.robots.robot import Robot
from calib.photographs.camera_files import read_camera
from calib.photographs.choices import LENSES
from calib.photographs.commands.boards import board_if_any, read_board_option
from calib.photographs.commands.detect import detect_board, summary
from calib.photographs.detection import DetectedImage
from calib.photographs.hand_eye import HandEye, calibrate, require_images
from calib.photographs.hand_eye_result import Frames, content, files, judge, report, transform_files
from calib.photographs.images import Shot, joint_columns, shots, with_joints
from calib.photographs.mistakes import Mistake
from calib.photographs.pages import exaggeration, figure
from calib.photographs.pose_pairs import PosePairs, content_of_pairs, judge_pairs, report_pairs, solve_pairs
from calib.photographs.scene import Mount, scene_of
from calib.photographs.tool_poses import ANGLES, image_names, pose_columns, poses_of, poses_of_images
from calib.pictures import installed

_NO_POSES = (
    "give the pose of the tool at each image with --poses FILE; or photographs in a bag with joint states, and"
    " --robot ROBOT"
)
_OF_CAMERA = re.compile("cam|marker|target|board|tag|aruco|object|tvec", re.IGNORECASE)
TABLES = (".csv", ".txt", ".xlsx", ".npz", ".mat")
_SIZE = re.compile(r"image: (\d+) x (\d+) px")
FILES = (
    "hand_eye.json",
    "camera_matrix.txt",
    "static_transform.sh",
    "camera_pose.launch.py",
    "easy_handeye.yaml",
    "easy_handeye2.calib",
    "camera_info.yaml",
    "photographs.html",
)
"""Files of the result folder."""


@click.command("hand-eye")
@click.argument("images", nargs=-1, required=True)
@board_if_any
@click.option(
    "--poses", metavar="FILE", help="CSV file with the pose of the tool at each image; or joint values (--robot)."
)
@click.option(
    "--robot",
    metavar="ROBOT",
    help="Robot (YAML description or URDF), if --poses has joint values; it is not calibrated.",
)
@click.option("--angles", type=click.Choice(ANGLES), help="Meaning of columns rx, ry, rz.")
@click.option("--camera", metavar="FILE", help="Intrinsics: YAML of OpenCV or camera_info of ROS; found if not given.")
@click.option(
    "--lens",
    type=click.Choice(LENSES),
    default="auto",
    show_default=True,
    help="Intrinsics as given, or found from these images; auto: those that predict left-out images better.",
)
@click.option("--camera-on", type=click.Choice(["tool", "base"]), help="Where the camera is; found if not given.")
@click.option("--topic", metavar="NAME", help="Topic of the images, if a ROS 2 bag has several.")
@click.option("--frames", metavar="BASE,TOOL,CAMERA", help="Names of frames in the exported files.")
@click.option("-o", "--out", required=True, metavar="DIR", help="Folder for the result.")
@shared_options(json_output=True, forced="Write the transform even if the verdict is FAIL, and replace files.")
def command(
    images: tuple[str, ...],
    board: str | None,
    poses: str | None,
    robot: str | None,
    angles: str | None,
    camera: str | None,
    lens: str,
    camera_on: str | None,
    topic: str | None,
    frames: str | None,
    out: str,
    output: Output,
) -> None:
    """Find where a camera is, on the tool of a robot or beside it, from IMAGES of a printed board.

    IMAGES are files, a folder, a pattern or a ROS 2 bag; or one CSV file of calib detect; or, without --board, a table
    of the marker's poses in the camera. --poses has the pose of the tool at each image, as the teach pendant shows it:
    position and quaternion, or angles; with --robot, it has joint values. This command does not change the kinematics
    of the robot: calib fit calibrates them.
    """
    named, model = _frames(frames), None if robot is None else load_robot(robot, output)
    mounts: tuple[Mount, ...] = ("tool", "base") if camera_on is None else (cast(Mount, camera_on),)
    if len(images) == 1 and (pairs := _pairs(images[0], poses, model, angles, output)) is not None:
        output.check(folders=(out,), names=FILES)
        _write_pairs(solve_pairs(*pairs, mounts), named, out, output)
        return
    if board is None:
        raise InputError("give the board with --board FILE; only pairs of poses need none")
    described = read_board_option(board)
    lens_file = None if camera is None else read_camera(camera)
    photographs: list[Shot] = []
    small: dict[str, bytes] = {}
    mirrored: list[str] = []
    if len(images) == 1 and Path(images[0]).suffix.lower() == ".csv":
        output.check(folders=(out,), names=FILES)
        detected_images = _read_detected(images[0], described)
    else:
        photographs = shots(images, topic)
        if poses is None:
            photographs = with_joints(photographs)
            if model is None or not any(shot.joints for shot in photographs):
                raise InputError(_NO_POSES)
        output.check(folders=(out,), names=FILES)
        detection, copies = detect_board(described, photographs, output, pictures=True)
        small = {shot.name: copy for shot, copy in zip(photographs, copies, strict=True)}
        detected_images, described = list(detection.usable), detection.board
        mirrored = [image.name for image in detection.images if image.mirrored]
        for line in summary(detection)[0]:
            output.say(line)
    tool = _tool_poses(detected_images, poses, model, angles, photographs, output)
    by_name = {image.name: image for image in detected_images}
    detected_images = [by_name[name] for name in tool]
    require_images(len(detected_images))
    scene = scene_of(detected_images, described, np.array(list(tool.values())))
    if lens_file is not None and lens_file.image is not None and lens_file.image != scene.size:
        raise InputError(
            f"{camera}: is for images of {lens_file.image[0]} x {lens_file.image[1]} px, and these have"
            f" {scene.size[0]} x {scene.size[1]}; give the intrinsics of these images, or leave --camera out"
        )
    with output.working("calibrating") as progress:
        result = calibrate(
            scene, None if lens_file is None else lens_file.intrinsics, lens=lens, mounts=mounts, progress=progress
        )
    if mirrored:
        text = f"mirrored images were left out: {listing(mirrored)}; switch that off in the camera, or flip them back"
        result = replace(result, mistakes=(*result.mistakes, Mistake("mirrored", text)))
    judgement = judge(result)
    output.say(report(result, named))
    pages = {"photographs.html": _page(result, named, detected_images, small)}
    refused = judgement.grade == "FAIL" and not output.force
    write_folder(out, pages if refused else files(result, named) | pages, force=output.force)
    if not refused:
        output.say(f"Written to {out}: {', '.join(FILES)}")
    output.json(content(result, named))
    if refused:
        raise ComputationError(f"verdict FAIL: {judgement.reasons[0]}; no transform was written (--force writes it)")


def _frames(text: str | None) -> Frames:
    if text is None:
        return Frames()
    names = [name.strip() for name in text.split(",")]
    if len(names) != 3 or not all(re.fullmatch(r"[\w/.-]+", name) for name in names):
        raise InputError(f"--frames {text}: give three names, such as base_link,tool0,camera_optical_frame")
    return Frames(*names)


def _pairs(
    path: str, poses: str | None, model: Robot | None, angles: str | None, output: Output
) -> tuple[list[str], FloatArray, FloatArray] | None:
    """Names, tool in base and marker in camera from tables of poses; None if `path` is no such table.

    One table may hold both; its rows are then pairs, and column names tell camera from tool.
    """
    if Path(path).suffix.lower() not in TABLES or not Path(path).is_file():
        return None
    table = read_table(path, {})
    places = pose_columns(table)
    if poses is not None and len(places) == 1:
        seen = dict(zip(image_names(table), poses_of(table, next(iter(places.values())), angles), strict=True))
        tool, remarks = poses_of_images(list(seen), poses, robot=model, angles=angles)
        output.remarks([f"left out: {text}" for text in remarks])
        names = [name for name in seen if name in tool]
        return names, np.array([tool[name] for name in names]), np.array([seen[name] for name in names])
    if poses is None and len(places) == 2:
        of_camera = [name for name in places if _OF_CAMERA.search(name)]
        if len(of_camera) != 1:
            raise DataError(
                f"{path}: holds poses {listing(list(places))}, and their names do not say which is the marker in the"
                " camera; call the columns camera_x, ... and tool_x, ..., or give the tool poses with --poses FILE"
            )
        of_tool = next(name for name in places if name not in of_camera)
        output.say(f"{path}: taken for the marker in the camera: {of_camera[0]}; for the tool in the base: {of_tool}")
        rows = [str(k + 1) for k in range(len(table.lines))]
        return rows, poses_of(table, places[of_tool], angles), poses_of(table, places[of_camera[0]], angles)
    if places:
        need = "with --poses, give only the marker's" if poses else "give the poses of the tool with --poses FILE"
        raise DataError(f"{path}: has poses {listing(list(places))}; {need}")
    return None


def _write_pairs(result: PosePairs, frames: Frames, out: str, output: Output) -> None:
    judgement = judge_pairs(result)
    output.say(report_pairs(result, frames))
    data = content_of_pairs(result, frames)
    written = {"hand_eye.json": json_file(data)}
    whole = not np.any(result.camera.open) and (judgement.grade != "FAIL" or output.force)
    if whole:
        written |= transform_files(result.camera.pose, result.mount, frames)
    write_folder(out, written, force=output.force)
    output.say(f"Written to {out}: {', '.join(written)}")
    output.json(data)
    if not whole:
        raise ComputationError(f"verdict FAIL: {judgement.reasons[0]}; no transform was written")


def _tool_poses(
    detected_images: Sequence[DetectedImage],
    poses: str | None,
    model: Robot | None,
    angles: str | None,
    photographs: Sequence[Shot],
    output: Output,
) -> dict[str, FloatArray]:
    """The pose of the tool, (4, 4), at each image that has one, by name in the order of the rows."""
    seen = [image.name for image in detected_images]
    if poses is not None:
        tool, remarks = poses_of_images(seen, poses, robot=model, angles=angles)
        output.remarks([f"left out: {text}" for text in remarks])
        return tool
    if model is None or not photographs:
        raise InputError(_NO_POSES)
    names, values = joint_columns(photographs, seen)
    missing = next((name for name in model.joint_names if name not in names), None)
    if missing is not None:
        raise DataError(f"the bag has no joint '{missing}'{nearest(missing, names)}")
    joints = values[:, [names.index(name) for name in model.joint_names]]
    return dict(zip(seen, model.forward(joints), strict=True))


def _read_detected(path: str, board: Board) -> list[DetectedImage]:
    table = read_table(path, {})
    size = next((match for text in table.comments if (match := _SIZE.search(text))), None)
    if size is None:
        raise DataError(f"{path}: does not say how large the images are; put '# image: 1600 x 1200 px' at its head")
    pixel = next((name.removesuffix("_u") for name in table.names if name.endswith("_u")), "")
    key = next((name for name in ("pose", "image") if name in table.names), "pose")
    if not {key, "point", f"{pixel}_u", f"{pixel}_v"} <= set(table.names):
        raise DataError(f"{path}: needs columns pose, point, camera_u and camera_v, as calib detect writes them")
    pixels = np.stack([table.column(f"{pixel}_{axis}", "pixel") for axis in "uv"], axis=1)
    names, points, known = table.text(key), table.text("point"), board.points()
    strange = next((k for k, name in enumerate(points) if name not in known), None)
    if strange is not None:
        raise DataError(
            f"{path}, line {table.lines[strange]}, column 'point': the board has no point '{points[strange]}'"
            f"{nearest(points[strange], known)}"
        )
    images: dict[str, dict[str, FloatArray]] = {name: {} for name in names}
    for name, point, place in zip(names, points, pixels, strict=True):
        if point in images[name]:
            raise DataError(f"{path}: image {name} has point {point} twice")
        images[name][point] = place
    whole = int(size[1]), int(size[2])
    return [DetectedImage(name, whole, tuple(seen), np.array([*seen.values()])) for name, seen in images.items()]


def _page(result: HandEye, frames: Frames, detected_images: Sequence[DetectedImage], small: dict[str, bytes]) -> bytes:
    scene, images = result.scene, {image.name: image for image in detected_images}
    factor = exaggeration(result.pixels, scene.size[0])
    each, on = scene.rms_by_image(result.pixels), scene.rms_by_image(result.board)
    figures = []
    for i, name in enumerate(scene.names):
        points = scene.image == i
        arrows = scene.pixels[points] + factor * result.pixels[points]
        shown = replace(images[name], pixels=scene.pixels[points])
        caption = f"{each[i]:.2f} px, {quantity_text(on[i], 'mm', '.2f')} on the board"
        figures.append((i, figure(shown, small.get(name, b""), caption, arrows)))
    for image in result.outlying_images:  # they belong to no mark of a plot
        caption = f"left out: {image.rms_px:.1f} px off"
        figures.append((-1, figure(images[image.name], small.get(image.name, b""), caption, is_outlying=True)))
    text = f"Arrows: from where points were found to where they should be, {factor:g} times as long"
    text += "".join(f"\n{number.value}: counts {', '.join(names_of(own))}" for number, own in result.contains.items())
    return installed("--html").answer(result, "Hand-eye calibration", f"{report(result, frames)}\n{text}", figures)

"""`calib detect`: pixels of a printed board's points in photographs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import click
import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError
from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.commands.common import Output, shared_options
from calib.core.data.table_writing import format_table
from calib.core.instruments.board import Board
from calib.photographs.camera_alone import LEAST_IMAGES, views
from calib.photographs.commands.boards import board_option, read_board_option
from calib.photographs.detection import DetectedImage, Detection, detect
from calib.photographs.estimation import LITTLE_TURN, turning
from calib.photographs.image_coverage import LITTLE_COVERAGE, image_coverage
from calib.photographs.images import Shot, joint_columns, shots, with_joints
from calib.photographs.opencv import GreyImage
from calib.photographs.pages import figure, small_copy
from calib.photographs.scene import scene_of
from calib.pictures import installed


@click.command("detect")
@click.argument("images", nargs=-1, required=True)
@board_option
@click.option("--topic", metavar="NAME", help="Topic of the images, if a ROS 2 bag has several.")
@click.option(
    "--columns", metavar="NAME", default="camera", show_default=True, help="Names of the columns: NAME_u, NAME_v."
)
@click.option("--page", "page_file", metavar="FILE", help="HTML page that shows what was found in each image.")
@click.option("-o", "--out", required=True, metavar="FILE", help="CSV file to write: pose, point, and its pixels.")
@shared_options(json_output=True)
def command(
    images: tuple[str, ...],
    board: str,
    topic: str | None,
    columns: str,
    page_file: str | None,
    out: str,
    output: Output,
) -> None:
    """Find a printed board in IMAGES: files, a folder, a pattern such as 'shots/*.png', or a ROS 2 bag.

    Each image is a pose, named after its file. Of a bag, one image of each stop of the robot is used, and the joint
    values of that moment are written too. Images without a board are named and left out.
    """
    if not re.fullmatch(r"[^\s,;\[\]#]+", columns):
        raise InputError(f"--columns '{columns}': give one word, such as camera")
    described, photographs = read_board_option(board), with_joints(shots(images, topic))
    output.check(out, page_file)
    detection, small = detect_board(described, photographs, output, pictures=page_file is not None)
    if not detection.usable:
        raise nothing_found(detection)
    output.write(out, pixel_table(detection, photographs, columns))
    lines = summary(detection)
    if page_file:
        figures = []
        for image, copy in zip(detection.images, small, strict=True):
            caption = image.remark or count_noun(len(image.points), "point")
            figures.append((-1, figure(image, copy, caption, is_outlying=not image.usable)))
        title = f"Photographs of a board: {detection.board}"
        output.write(page_file, installed("--page").answer(detection, title, "\n".join(lines), figures))
    for line in lines:
        output.say(line)
    output.say(f"Written to {out}")
    output.json(content(detection))


def detect_board(
    board: Board, photographs: Sequence[Shot], output: Output, *, pictures: bool
) -> tuple[Detection, list[bytes]]:
    """Find a board in images, and report each image without one; return small copies too if `pictures`."""
    small: list[bytes] = []

    def read() -> Iterator[tuple[str, GreyImage | str]]:
        for shot in photographs:
            image = shot.read()
            small.append(small_copy(image) if pictures else b"")
            yield shot.name, image

    with output.working("looking for the board") as progress:
        detections = detect(board, read())
        for k, _ in enumerate(photographs):
            next(detections)
            progress(k + 1, len(photographs))
        result = next(detections)  # in the whole set
    assert isinstance(result, Detection)
    for image in result.images:
        if image.remark:
            output.note(f"{'note' if image.usable else 'left out'}: {image.name}: {image.remark}")
    return result, small


def nothing_found(detection: Detection) -> DataError:
    """Return the error of a set of images without a board."""
    first = detection.images[0]
    return DataError(f"no board in {count_noun(len(detection.images), 'image')}; {first.name}: {first.remark}")


def pixel_table(detection: Detection, photographs: Sequence[Shot], columns: str) -> str:
    """Return the detected points as a table, with one row for each point."""
    by_name = {shot.name: shot for shot in photographs}
    usable = detection.usable
    names, joints = joint_columns([by_name[image.name] for image in usable])
    counts = [len(image.points) for image in usable]
    pixels = np.concatenate([image.pixels for image in usable])
    table: list[tuple[str, Sequence[object]]] = [
        ("pose", [image.name for image in usable for _ in image.points]),
        ("point", [point for image in usable for point in image.points]),
        (f"{columns}_u", [round(float(value), 4) for value in pixels[:, 0]]),
        (f"{columns}_v", [round(float(value), 4) for value in pixels[:, 1]]),
    ]
    table += [(name, [repr(float(value)) for value in np.repeat(joints[:, k], counts)]) for k, name in enumerate(names)]
    width, height = usable[0].size
    return format_table(table, (f"image: {width} x {height} px", f"board: {detection.board}"))


def _number(point: str) -> list[int]:
    return [int(part) for part in point[1:].split(".")]


def summary(detection: Detection) -> list[str]:
    """Return a summary of the detection in words, with its shortcomings."""
    usable, whole = detection.usable, len(detection.board.points())
    lines = [
        f"{count_noun(detection.n_points, 'point')} in {len(usable)} of {count_noun(len(detection.images), 'image')}"
        f" ({detection.board}; {sum(len(image.points) == whole for image in usable)} show the whole board)"
    ]
    if detection.board.kind == "charuco" and detection.board.legacy:
        lines.append("The board has the layout of OpenCV before 4.6 (legacy: true)")
    covered = coverage(usable)
    lines.append(f"The board was seen in {100 * covered:.0f} % of the image")
    if covered < LITTLE_COVERAGE:
        lines.append(
            "That is too little to find the lens: bring the board into the corners and edges of the image, near and far"
        )
    spreads = camera_rotation_spread(detection)
    if np.all(np.isfinite(spreads)):
        first, second = (quantity_text(spread, "deg", ".0f") for spread in spreads[:2])
        lines.append(
            f"The robot turned the view of the board by about {first} about one axis, and by {second} about a second"
        )
        if spreads[1] < LITTLE_TURN:
            lines.append(
                "That is too little to find where the camera is: tilt the tool by 20 to 40 deg about two axes or more"
            )
    missing = sorted(set(detection.board.points()) - {name for image in usable for name in image.points}, key=_number)
    if missing and len(usable) >= LEAST_IMAGES:
        lines.append(
            f"In no image: {count_noun(len(missing), 'point')} of the board ({listing(missing)}); check columns and"
            " rows, and that nothing covers them"
        )
    return lines


def camera_rotation_spread(detection: Detection) -> FloatArray:
    """Return the spread of camera rotations relative to the board, largest first, (3,) [rad]; NaN for < 3 images."""
    if len(detection.usable) < LEAST_IMAGES:
        return np.full(3, np.nan)
    nothing = np.tile(np.eye(4), (len(detection.usable), 1, 1))
    return turning(views(scene_of(detection.usable, detection.board, nothing)))


def coverage(usable: Sequence[DetectedImage]) -> float:
    """Return the part of the image area in which the board was seen, 0 to 1."""
    return image_coverage(np.concatenate([image.pixels for image in usable]), usable[0].size) if usable else 0.0


def content(detection: Detection) -> dict[str, object]:
    """Return the detection as data for JSON."""
    return {
        "board": detection.board.model_dump(exclude_none=True),
        "n_points": detection.n_points,
        "coverage": coverage(detection.usable),
        "turned_rad": camera_rotation_spread(detection).tolist(),
        "images": [
            {
                "name": image.name,
                "points": len(image.points),
                "edge_px": image.edge,
                "remark": image.remark,
                "used": image.usable,
            }
            for image in detection.images
        ],
    }

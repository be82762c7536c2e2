"""`calib detect`: pixels of a printed board's points in photographs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import click
import numpy as np

from calib.core.base.errors import DataError, InputError
from calib.core.base.units import quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.commands.common import Output, shared_options
from calib.core.data.table_writing import format_table
from calib.core.instruments.board import Board
from calib.photographs.camera_alone import LEAST_IMAGES, views
from calib.photographs.commands.boards import board_option, read_board_option
from calib.photographs.detection import Detection, detect
from calib.photographs.estimation import LITTLE_TURN, turning
from calib.photographs.images import Shot, joint_columns, shots, with_joints
from calib.photographs.opencv import GreyImage
from calib.photographs.pages import figure, small_copy
from calib.photographs.scene import LITTLE_COVERAGE, scene_of
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
    output.write(out, _pixel_table(detection, photographs, columns))
    lines, content = summary(detection)
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
    output.json(content)


def detect_board(
    board: Board, photographs: Sequence[Shot], output: Output, *, pictures: bool
) -> tuple[Detection, list[bytes]]:
    """Find a board in images, and report each image without one; return small copies too if `pictures`.

    Raises:
        DataError: No image shows the board.
    """
    small: list[bytes] = []
    with output.working("looking for the board") as progress:

        def read() -> Iterator[tuple[str, GreyImage | str]]:
            for k, shot in enumerate(photographs):
                progress(k, len(photographs))
                image = shot.read()
                small.append(small_copy(image) if pictures else b"")
                yield shot.name, image

        result = detect(board, read())
    for image in result.images:
        if image.remark:
            output.note(f"{'note' if image.usable else 'left out'}: {image.name}: {image.remark}")
    if not result.usable:
        first = result.images[0]
        raise DataError(f"no board in {count_noun(len(result.images), 'image')}; {first.name}: {first.remark}")
    return result, small


def _pixel_table(detection: Detection, photographs: Sequence[Shot], columns: str) -> str:
    """The detected points as a table, with one row for each point."""
    usable = detection.usable
    names, joints = joint_columns(photographs, [image.name for image in usable])
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


def summary(detection: Detection) -> tuple[list[str], dict[str, object]]:
    """Return the detection in words, with its shortcomings, and as data for JSON."""
    board, usable, points = detection.board, detection.usable, detection.board.points()
    scene = scene_of(usable, board, np.tile(np.eye(4), (len(usable), 1, 1)))
    spreads = turning(views(scene)) if len(usable) >= LEAST_IMAGES else np.full(3, np.nan)
    lines = [
        f"{count_noun(detection.n_points, 'point')} in {len(usable)} of {count_noun(len(detection.images), 'image')}"
        f" ({board}; {sum(len(image.points) == len(points) for image in usable)} show the whole board)"
    ]
    if board.kind == "charuco" and board.legacy:
        lines.append("The board has the layout of OpenCV before 4.6 (legacy: true)")
    lines.append(f"The board was seen in {100 * scene.coverage:.0f} % of the image")
    if scene.coverage < LITTLE_COVERAGE:
        lines.append(
            "That is too little to find the lens: bring the board into the corners and edges of the image, near and far"
        )
    if np.all(np.isfinite(spreads)):
        first, second = (quantity_text(spread, "deg", ".0f") for spread in spreads[:2])
        lines.append(
            f"The robot turned the view of the board by about {first} about one axis, and by {second} about a second"
        )
        if spreads[1] < LITTLE_TURN:
            lines.append(
                "That is too little to find where the camera is: tilt the tool by 20 to 40 deg about two axes or more"
            )
    missing = sorted(
        set(points) - {name for image in usable for name in image.points},
        key=lambda point: [int(part) for part in point[1:].split(".")],
    )
    if missing and len(usable) >= LEAST_IMAGES:
        lines.append(
            f"In no image: {count_noun(len(missing), 'point')} of the board ({listing(missing)}); check columns and"
            " rows, and that nothing covers them"
        )
    images = [
        {
            "name": image.name,
            "points": len(image.points),
            "edge_px": image.edge,
            "remark": image.remark,
            "used": image.usable,
        }
        for image in detection.images
    ]
    content = {
        "board": board.model_dump(exclude_none=True),
        "n_points": detection.n_points,
        "coverage": scene.coverage,
        "turned_rad": spreads.tolist(),
        "images": images,
    }
    return lines, content

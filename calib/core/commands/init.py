"""`calib init`: a robot description to start from."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
import scipy
import yaml

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, InputError
from calib.core.base.files import write_files
from calib.core.base.units import millimetres, quantity
from calib.core.base.words import counted
from calib.core.commands.common import Output, shared_options
from calib.core.data.dh_files import read_dh
from calib.core.data.measurement_columns import header
from calib.core.data.table_writing import format_table
from calib.core.instruments.camera import NAMES
from calib.core.robots.description import Description, schema_text
from calib.core.robots.first_description import MEASURES, Measure, description_text
from calib.core.robots.loading import describe, load
from calib.core.robots.robot import Robot
from calib.core.robots.templates import TEMPLATES, loop_files, read_lengths
from calib.core.robots.urdf.arm_chain import arm_chain
from calib.core.robots.urdf.denavit_hartenberg import CONVENTIONS, LAST_LINK, urdf_text
from calib.core.robots.urdf.mjcf_reading import MjcfRobot, is_mjcf, read_mjcf
from calib.core.robots.urdf.text import UrdfText, parse_urdf, read_urdf
from calib.photographs.camera_files import read_camera
from calib.photographs.commands.boards import given_board
from calib.printers.files import printer_table, read_printer
from calib.printers.linear_delta import linear_delta_description, linear_delta_plan, linear_delta_urdf
from calib.printers.rows import PrinterFile, expected_geometry

_BOARD = "charuco:7x5:30mm:22mm:DICT_5X5_100"
_IMAGE, _FOCAL = (1280, 960), 1000.0  # px, where no file says them
_OFF_GUESSED, _OFF_GIVEN = 0.1, 0.01  # of the focal length
_AWAY = 1.8  # diagonals of the board between it and the camera
_TRIED, _PLACES = 600, 60  # poses; those before which a board may be
_AHEAD, _FACING = 0.93, 0.6  # cosines to the camera's axis, and to that of the board
_LENGTHS = "; ".join(
    f"{name}: " + ", ".join(f"{key} {millimetres(value):g} mm" for key, value in template.lengths.items())
    for name, template in TEMPLATES.items()
)


@click.command("init")
@click.argument("urdf", required=False)
@click.option("--target", metavar="NAME", help="Link that carries the measured point; the arm's end if not given.")
@click.option(
    "--measure",
    type=click.Choice(tuple(MEASURES)),
    help="How you measure: writes the instrument into the description, and beside it the file to fill in.",
)
@click.option(
    "--board",
    metavar="FILE|TEXT",
    help="With --measure camera: the board, as for calib board; an example if not given.",
)
@click.option(
    "--camera", metavar="FILE", help="With --measure camera: its intrinsics, YAML of OpenCV or camera_info of ROS."
)
@click.option("--dh", metavar="FILE", help="Denavit-Hartenberg table (CSV) in place of a URDF, which is then written.")
@click.option("--convention", type=click.Choice(CONVENTIONS), help="Convention of the table, if it does not state it.")
@click.option("--template", type=click.Choice(tuple(TEMPLATES)), help="A robot with loops in place of a URDF.")
@click.option("--klipper", metavar="FILE", help="Delta printer: its printer.cfg, with what the probe measured.")
@click.option("--marlin", metavar="FILE", help="Delta printer: a file with Marlin's M665 and M666.")
@click.option("--duet", metavar="FILE", help="Delta printer: a file with M665 and M666 of RepRapFirmware.")
@click.option(
    "--length",
    "lengths",
    multiple=True,
    metavar="NAME=VALUE",
    help=f"Length of the template, such as rod=300mm; once for each. Names and defaults are: {_LENGTHS};"
    " of a printer: arm, as designed or measured.",
)
@click.option(
    "--schema",
    is_flag=True,
    help="Write the JSON schema of robot descriptions instead; editors use it to check descriptions.",
)
@click.option(
    "-o",
    "--out",
    metavar="FILE",
    help="YAML file to write. Default: in the current folder, with the name of what is given. The URDF of --dh,"
    " --template or a printer goes beside it, and its measurements (.csv).",
)
@shared_options()
def command(
    urdf: str | None,
    target: str | None,
    measure: str | None,
    board: str | None,
    camera: str | None,
    dh: str | None,
    convention: str | None,
    template: str | None,
    klipper: str | None,
    marlin: str | None,
    duet: str | None,
    lengths: tuple[str, ...],
    schema: bool,
    out: str | None,
    output: Output,
) -> None:
    """Write a commented robot description to start from, for a URDF or a MuJoCo file (MJCF).

    If --target is not given, the description has the longest chain of joints with motors, but no fingers of a gripper.
    A note says what is left out. Other options start from something else and write the URDF, too. --dh: a
    Denavit-Hartenberg table, with columns theta, d, a, alpha (and beta), with units, one row for each joint.
    --template: a robot with loops, with your --length. --klipper: the printer.cfg of a delta printer; its measurements
    are also written. --marlin, --duet: the settings of a delta printer.
    """
    printers = {name: file for name, file in (("klipper", klipper), ("marlin", marlin), ("duet", duet)) if file}
    if schema:
        if urdf or dh or template or printers:
            raise InputError("--schema is the same for all robots; give nothing but --out")
        out = out or "robot.schema.json"
        output.check(out)
        write_files({Path(out): schema_text().encode()}, force=output.force)
        output.say(f"{out} written; first line of a description: # yaml-language-server: $schema={Path(out).name}")
        return
    if sum(source is not None for source in (urdf, dh, template, *printers.values())) != 1:
        raise InputError(
            "give one of these: a URDF, a Denavit-Hartenberg table (--dh), a --template, or a printer (--klipper,"
            " --marlin or --duet)"
        )
    out = out or next(f"{Path(source).stem}.yaml" for source in (urdf, dh, template, *printers.values()) if source)
    if template and target:
        raise InputError("--target is for a URDF or a table; a template has its own targets")
    if (template or printers) and measure:
        raise InputError("--measure is for a URDF or a table; a template has its own targets, a printer its nozzle")
    if (board or camera) and measure != "camera":
        raise InputError("--board and --camera are for --measure camera")
    if lengths and not (template or printers):
        raise InputError("--length is for a robot of --template, or a printer")
    if convention and not dh:
        raise InputError("--convention is for a table given with --dh")
    if Path(out).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{out}: the name of a robot description ends in .yaml")
    for firmware, file in printers.items():
        _write_printer(read_printer(file, firmware), target, lengths, Path(out), output)
        return
    beside = Path(out).with_suffix(".urdf") if dh or template else None
    if template and beside:
        output.check(out, str(beside))
        _write_template(template, lengths, beside, Path(out), output)
        output.say(f"{beside} and {out} written; they work as they are, and comments say what to change")
        return
    if dh and beside:
        text = parse_urdf(urdf_text(read_dh(dh, convention), Path(dh).stem).encode(), str(beside))
    else:
        text = read_urdf(str(urdf))
    how = MEASURES[measure] if measure else None
    sheet = Path(out).with_name(f"{Path(out).stem}_measurements.csv") if how and how.comments else None
    to_print = (
        Path(out).with_name(f"{Path(out).stem}_board.yaml") if measure == "camera" and not _is_file(board) else None
    )
    output.check(out, *(str(file) for file in (beside, sheet, to_print) if file is not None))
    relative = os.path.relpath(Path(text.path).resolve(), Path(out).resolve().parent)
    mjcf = read_mjcf(text.path) if not dh and is_mjcf(Path(text.path).read_bytes()) else None
    described, remark = _described(text, mjcf, target or (LAST_LINK if dh else None), relative)
    files, words = {beside: text.source} if beside else {}, None
    if measure == "camera":
        plain = _loaded(text, description_text(text, described))
        boards, words = _camera_words(plain, board, camera, to_print, Path(out))
        files |= boards
    description = description_text(text, described, remark, measure, words).encode()
    files[Path(out)] = description
    if sheet and how:
        filled = plain if how.read_apart else _loaded(text, description.decode())
        files[sheet] = _empty_sheet(filled, how).encode()
    write_files(files, force=output.force)
    if beside:
        output.say(f"{beside} written, from the table")
    output.say(f"{out} written; it works as it is, and its comments say what to change")
    if to_print is not None:
        output.say(f"{to_print} written: the board; change it to yours, then print it: calib board --board {to_print}")
    if sheet is not None and how is not None:
        then = "; pixels come from calib detect" if how.read_apart else f"; then: calib check {out} {sheet}"
        output.say(f"{sheet} written, with the header for your measurements{then}")
    if remark:
        output.say(remark)


def _described(text: UrdfText, mjcf: MjcfRobot | None, target: str | None, relative: str) -> tuple[Description, str]:
    """What a file describes: its arm, or the whole robot of an MJCF file with loops; and what to say of the choice."""
    if mjcf is None or not mjcf.loops:
        chain = arm_chain(text, target)
        return describe(chain, relative), "; ".join(filter(None, [*(mjcf.remarks if mjcf else ()), chain.remark]))
    if target is None:
        raise InputError(f"{text.path}: has loops; say what is measured: --target, a body or a site of the file")
    if not mjcf.motors:
        raise InputError(f"{text.path}: has loops, and no joint has an actuator; add actuators to those with motors")
    closed = {
        "name_mot": mjcf.motors,
        "closed_loop": tuple(loop.links for loop in mjcf.loops),
        "type": tuple(loop.kind for loop in mjcf.loops),
        "closed_loop_axes": tuple(loop.axes for loop in mjcf.loops),
        "home": mjcf.home,
    }
    described = describe(arm_chain(text, target), relative).model_copy(update=closed)
    _loaded(text, description_text(text, described))
    return described, "; ".join(mjcf.remarks)


def _empty_sheet(robot: Robot, measure: Measure) -> str:
    """The header of the measurements of a robot, with what to know while they are taken above it."""
    columns = ["pose", *(header(name, robot.mechanism.dimensions[name]) for name in robot.joint_names)]
    for instrument in () if measure.read_apart else robot.instruments:
        columns += [
            *(header(column.name, column.dimension) for column in instrument.columns()),
            *instrument.text_columns(),
        ]
    return format_table([(column, ()) for column in dict.fromkeys(columns)], measure.comments)


def _loaded(urdf: UrdfText, description: str) -> Robot:
    """The robot of a description that is not written yet; only a loaded one knows its columns and where it reaches."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "robot.urdf").write_bytes(urdf.source)
        said = yaml.safe_load(description) | {"urdf": "robot.urdf"}
        (Path(folder) / "robot.yaml").write_text(yaml.safe_dump(said), encoding="utf-8")
        return load(Path(folder) / "robot.yaml")


def _is_file(board: str | None) -> bool:
    return board is not None and Path(board).suffix.lower() in (".yaml", ".yml")


def _camera_words(
    robot: Robot, board: str | None, camera: str | None, to_print: Path | None, out: Path
) -> tuple[dict[Path, bytes], dict[str, str]]:
    """The file of the board, if it is not there yet, and what the description says of board and camera."""
    described = given_board(_BOARD if board is None else board)
    given = None if camera is None else read_camera(camera)
    image = _IMAGE if given is None or given.image is None else given.image
    if given is None:
        intrinsics = np.array([_FOCAL, _FOCAL, (image[0] - 1) / 2, (image[1] - 1) / 2, 0, 0, 0, 0, 0])
    else:
        intrinsics = given.intrinsics
    off = (_OFF_GUESSED if given is None else _OFF_GIVEN) * intrinsics[0]
    numbers = {name: float(f"{value:.8g}") for name, value in zip(NAMES, intrinsics, strict=True)}
    free = {name: float(f"{off:.2g}") for name in NAMES[:4]} | dict.fromkeys(NAMES[4:6], 0.1)
    middle = np.array([*described.size, 0.0]) / 2
    away = _AWAY * float(np.hypot(*described.size)) * max(1.0, intrinsics[0] / max(image))
    xyz, rpy = _about_seen(robot, middle, away)
    path = to_print if to_print is not None else Path(str(board))
    words = {
        "board_file": json.dumps(os.path.relpath(path.resolve(), out.resolve().parent), ensure_ascii=False),
        "board_text": str(described),
        "board_xyz": f"[{', '.join(f'{millimetres(value):.0f} mm' for value in xyz)}]",
        "board_rpy": f"[{', '.join(f'{value:.0f} deg' for value in np.rad2deg(rpy))}]",
        "image": str(list(image)),
        "intrinsics": _yaml(numbers),
        "unknown_intrinsics": _yaml(free),
    }
    if to_print is None:
        return {}, words
    values = described.model_dump(exclude_none=True, exclude_defaults=True)
    lines = [
        f"{key}: {millimetres(value):.9g} mm" if isinstance(value, float) else f"{key}: {value}"
        for key, value in values.items()
    ]
    comment = "# A printed board: measure what you have, or print this one (calib board).\n"
    return {to_print: (comment + "\n".join(lines) + "\n").encode()}, words


def _yaml(values: Mapping[str, float]) -> str:
    return "{" + ", ".join(f"{name}: {value:.10g}" for name, value in values.items()) + "}"


def _about_seen(robot: Robot, middle: FloatArray, away: float) -> tuple[FloatArray, FloatArray]:
    """Where a board is seen from most poses, by a camera that looks along z of the target: xyz [m], rpy [rad]."""
    poses = robot.forward(robot.sample(_TRIED, 0))
    boards = poses[:_PLACES].copy()
    boards[:, :3, 3] += away * boards[:, :3, 2]
    apart = boards[:, None, :3, 3] - poses[None, :, :3, 3]
    distance = np.maximum(np.linalg.norm(apart, axis=2), 1e-9)
    ahead = np.einsum("bka,ka->bk", apart, poses[:, :3, 2]) / distance
    facing = np.einsum("bka,ba->bk", apart, boards[:, :3, 2]) / distance
    visible = (ahead > _AHEAD) & (facing > _FACING) & (distance > 0.7 * away) & (distance < 1.6 * away)
    best = boards[int(np.argmax(np.sum(visible, axis=1)))]
    corner = np.round(best[:3, 3] - best[:3, :3] @ middle, 2) + 0.0
    angles = scipy.spatial.transform.Rotation.from_matrix(best[:3, :3]).as_euler("xyz")
    return corner, np.deg2rad(np.round(np.rad2deg(angles))) + 0.0


def _write_template(name: str, given: Sequence[str], urdf: Path, description: Path, output: Output) -> None:
    """Write the two files of a template, if the robot that they describe can be used."""
    texts = dict(zip((urdf, description), loop_files(name, read_lengths(name, given), urdf.name), strict=True))
    with TemporaryDirectory() as folder:
        for file, text in texts.items():
            (Path(folder) / file.name).write_text(text, encoding="utf-8")
        try:
            load(Path(folder) / description.name)
        except DescriptionError as error:
            message = str(error).replace(f"{Path(folder) / description.name}: ", "")
            raise InputError(f"template {name}: with these lengths, {message}") from None
    write_files({file: text.encode() for file, text in texts.items()}, force=output.force)


def _write_printer(printer: PrinterFile, target: str | None, given: Sequence[str], out: Path, output: Output) -> None:
    """Write the description, the URDF and the measurements of a printer."""
    if target:
        raise InputError("--target is for a URDF or a table; a printer has its nozzle")
    arm = None
    for text in given:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals or key != "arm" or arm is not None:
            raise InputError(f"--length {text}: a printer has one length; write it once, such as arm=288mm")
        arm, said = quantity(value, "length", "--length arm"), max(printer.geometry.arms)
        if not said / 2 < arm < said * 2:
            raise InputError(
                f"--length {text}: is {millimetres(arm):g} mm, and {printer.path} has arms of {millimetres(said):g} mm;"
                " correct it, with its unit, such as arm=288mm"
            )
    geometry = expected_geometry(printer, arm)
    heights = sorted({row.value for row in printer.rows if len(row.places) == 1})
    plan = linear_delta_plan(geometry, 2 if any(len(row.places) == 2 for row in printer.rows) else 1)
    urdf, title = out.with_suffix(".urdf"), " ".join(Path(printer.path).name.replace("--", "-").split())
    files = {
        urdf: linear_delta_urdf(plan, f"linear delta, cut open: {title}"),
        out: linear_delta_description(plan, title, urdf.name, heights, len(printer.rows)),
        **({out.with_suffix(".csv"): printer_table(printer)} if printer.rows else {}),
    }
    output.check(*map(str, files))
    write_files({file: text.encode() for file, text in files.items()}, force=output.force)
    spans = len(printer.rows) - sum(len(row.places) == 1 for row in printer.rows)
    rows = f", with {counted(len(printer.rows) - spans, 'height')} and {counted(spans, 'distance')}"
    output.say(f"{', '.join(map(str, files))} written{rows if printer.rows else ''}")
    if printer.rows:
        output.say(f"next: calib fit {out} {out.with_suffix('.csv')} --out out/{out.stem}")

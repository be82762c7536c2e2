"""`calib init`: a robot description to start from."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import click

from calib.core.base.errors import DescriptionError, InputError
from calib.core.base.files import write_files
from calib.core.base.registry import load_entry, load_group
from calib.core.base.sections import parse_yaml
from calib.core.base.units import quantity_text
from calib.core.commands.common import Output, shared_options
from calib.core.data.measurement_columns import header
from calib.core.data.table_writing import format_table
from calib.core.robots.description import validate_description
from calib.core.robots.loading import build, first_description
from calib.core.robots.robot import Robot
from calib.core.robots.urdf.text import UrdfText, parse_urdf, read_urdf
from calib.shared.denavit_hartenberg import CONVENTIONS
from calib.shared.first_files import FirstFiles
from calib.starting.descriptions import MEASURES, Measure, description_text, schema_text
from calib.starting.dh_tables import LAST_LINK, urdf_of_table
from calib.starting.templates import TEMPLATES, read_lengths

_LENGTHS = "; ".join(
    f"{name}: " + ", ".join(f"{key} {quantity_text(value, 'mm', 'g')}" for key, value in template.lengths.items())
    for name, template in TEMPLATES.items()
)
_SOURCES: dict[str, FirstFiles] = dict(load_group("calib.first_descriptions", "first description"))
_LENGTHS_OF_SOURCES = "; ".join(dict.fromkeys(source.lengths for source in _SOURCES.values() if source.lengths))


def _source_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add an option for each kind of file from which a capability makes a robot."""
    for name, source in reversed(_SOURCES.items()):
        function = click.option(f"--{name}", metavar="FILE", help=source.help)(function)
    return function


@click.command("init")
@click.argument("urdf", required=False)
@click.option("--target", metavar="NAME", help="Link that carries the measured point; the arm's end if not given.")
@click.option(
    "--measure",
    type=click.Choice(tuple(MEASURES)),
    help="How you measure. The description gets this instrument; a file to fill in is written beside it.",
)
@click.option(
    "--board",
    metavar="FILE|TEXT",
    help="With --measure camera: the board, as for calib board; an example if not given.",
)
@click.option(
    "--camera", metavar="FILE", help="With --measure camera: its intrinsics, YAML of OpenCV or camera_info of ROS."
)
@click.option(
    "--xacro", multiple=True, metavar="NAME:=VALUE", help="Argument of a xacro file, kept in FILE; may be repeated."
)
@click.option("--dh", metavar="FILE", help="Denavit-Hartenberg table (CSV) in place of a URDF; the URDF is written.")
@click.option("--convention", type=click.Choice(CONVENTIONS), help="Convention of the table, if it does not state it.")
@click.option("--template", type=click.Choice(tuple(TEMPLATES)), help="A robot with loops in place of a URDF.")
@_source_options
@click.option(
    "--length",
    "lengths",
    multiple=True,
    metavar="NAME=VALUE",
    help=f"Length of the template, such as rod=300mm; may be repeated. Names and defaults are: {_LENGTHS};"
    f" {_LENGTHS_OF_SOURCES}.",
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
    help="YAML file to write. Default: in the current folder, named after the input. Beside it: the URDF of --dh,"
    " --template or a printer, and a printer's measurements (.csv).",
)
@shared_options()
def command(
    urdf: str | None,
    target: str | None,
    measure: str | None,
    board: str | None,
    camera: str | None,
    xacro: tuple[str, ...],
    dh: str | None,
    convention: str | None,
    template: str | None,
    lengths: tuple[str, ...],
    schema: bool,
    out: str | None,
    output: Output,
    **given: str | None,
) -> None:
    """Write a commented robot description to start from, for a URDF or a MuJoCo file (MJCF).

    If --target is not given, the description has the longest chain of joints with motors, but no fingers of a gripper.
    A note says what is left out. Other options start from something else and write the URDF, too. --dh: a
    Denavit-Hartenberg table, with columns theta, d, a, alpha (and beta), with units, one row for each joint.
    --template: a robot with loops, with your --length. --klipper, --marlin, --duet: the settings of a delta printer,
    whose measurements are written too.
    """
    others = {name: file for name, file in given.items() if file}
    arguments = _arguments(xacro)
    if schema:
        if urdf or dh or template or others:
            raise InputError("--schema is the same for all robots; give nothing but --out")
        out = out or "robot.schema.json"
        output.check(out)
        write_files({Path(out): schema_text().encode()}, force=output.force)
        output.say(f"{out} written; first line of a description: # yaml-language-server: $schema={Path(out).name}")
        return
    if sum(source is not None for source in (urdf, dh, template, *others.values())) != 1:
        raise InputError(
            "give one of these: a URDF, a Denavit-Hartenberg table (--dh), a --template, or a file of"
            f" {', '.join(f'--{name}' for name in _SOURCES)}"
        )
    out = out or next(f"{Path(source).stem}.yaml" for source in (urdf, dh, template, *others.values()) if source)
    for wrong, message in (
        (template and target, "--target is for a URDF or a table; a template has its own targets"),
        ((template or others) and measure, "--measure is for a URDF or a table; others have their own targets"),
        ((board or camera) and measure != "camera", "--board and --camera are for --measure camera"),
        (arguments and not urdf, "--xacro is for a xacro file in place of the URDF"),
        (
            lengths and not (template or others),
            "--length is for a robot of --template, and not for a URDF or a table",
        ),
        (convention and not dh, "--convention is for a table given with --dh"),
    ):
        if wrong:
            raise InputError(message)
    if Path(out).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{out}: the name of a robot description ends in .yaml")
    for name, file in others.items():
        if target:
            raise InputError(f"--target is for a URDF or a table; {_SOURCES[name].target}")
        _SOURCES[name].write(file, lengths, Path(out), output)
        return
    urdf_out = Path(out).with_suffix(".urdf") if dh or template else None
    if template and urdf_out:
        output.check(out, str(urdf_out))
        _write_template(template, lengths, urdf_out, Path(out), output)
        output.say(f"{urdf_out} and {out} written; they work as they are, and comments say what to change")
        return
    if dh and urdf_out:
        text = parse_urdf(urdf_of_table(dh, convention).encode(), str(urdf_out))
    else:
        text = read_urdf(str(urdf), arguments)
    how = MEASURES[measure] if measure else None
    sheet = Path(out).with_name(f"{Path(out).stem}_measurements.csv") if how and how.comments else None
    has_board = board is not None and Path(board).suffix.lower() in (".yaml", ".yml")
    to_print = Path(out).with_name(f"{Path(out).stem}_board.yaml") if measure == "camera" and not has_board else None
    output.check(out, *(str(file) for file in (urdf_out, sheet, to_print) if file is not None))
    relative = os.path.relpath(Path(text.path).resolve(), Path(out).resolve().parent)
    described, remark = first_description(text, relative, target or (LAST_LINK if dh else None))
    described = described.model_copy(update={"xacro": arguments}) if arguments else described
    files, words = {urdf_out: text.source} if urdf_out else {}, None
    if measure == "camera":
        plain = _load_unwritten(text, description_text(text, described))
        boards, words = load_entry("calib.measures", measure)(plain, board, camera, to_print, Path(out))
        files |= boards
    description = description_text(text, described, remark, measure, words).encode()
    files[Path(out)] = description
    if sheet and how:
        filled = plain if how.read_apart else _load_unwritten(text, description.decode())
        files[sheet] = _empty_sheet(filled, how).encode()
    write_files(files, force=output.force)
    if urdf_out:
        output.say(f"{urdf_out} written, from the table")
    output.say(f"{out} written; it works as it is, and its comments say what to change")
    if to_print is not None:
        output.say(f"{to_print} written: the board; change it to yours, then print it: calib board --board {to_print}")
    if sheet is not None and how is not None:
        then = "; pixels come from calib detect" if how.read_apart else f"; then: calib check {out} {sheet}"
        output.say(f"{sheet} written, with the header for your measurements{then}")
    if remark:
        output.say(remark)


def _arguments(given: Sequence[str]) -> dict[str, str]:
    """Arguments of a xacro file in the form of its own command."""
    wrong = next((text for text in given if not text.partition(":=")[0].isidentifier() or ":=" not in text), None)
    if wrong is not None:
        raise InputError(f"--xacro {wrong}: is not an argument; write it as prefix:=ur5e_")
    return {name: value for name, _, value in (text.partition(":=") for text in given)}


def _empty_sheet(robot: Robot, measure: Measure) -> str:
    """The header of a robot's measurements, below comments for the person who measures."""
    columns = ["pose", *(header(name, robot.mechanism.dimensions[name]) for name in robot.joint_names)]
    for instrument in () if measure.read_apart else robot.instruments:
        columns += [
            *(header(column.name, column.dimension) for column in instrument.columns()),
            *instrument.text_columns(),
        ]
    return format_table([(column, ()) for column in dict.fromkeys(columns)], measure.comments)


def _load_unwritten(urdf: UrdfText, description: str) -> Robot:
    """The robot of a description that is not written yet, whose columns and reach are then known."""
    return build(validate_description(parse_yaml(description, urdf.path), urdf.path), urdf, urdf.path)


def _write_template(name: str, given: Sequence[str], urdf: Path, description: Path, output: Output) -> None:
    """Write the two files of a template, if the robot that they describe can be used."""
    texts = dict(zip((urdf, description), TEMPLATES[name].files(urdf.name, read_lengths(name, given)), strict=True))
    try:
        _load_unwritten(parse_urdf(texts[urdf].encode(), str(urdf)), texts[description])
    except DescriptionError as error:
        message = str(error).removeprefix(f"{urdf}: ")
        raise InputError(f"template {name}: with these lengths, {message}") from None
    write_files({file: text.encode() for file, text in texts.items()}, force=output.force)

"""`calib init`: a robot description to start from."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import yaml

from calib.base.errors import DescriptionError, InputError
from calib.base.files import write_files
from calib.base.units import millimetres, quantity
from calib.base.words import counted
from calib.commands.common import Output, shared_options
from calib.data.dh_files import read_dh
from calib.data.measurement_columns import header
from calib.data.printer_files import PrinterFile, expected_geometry, printer_table, read_printer
from calib.data.tables import format_table
from calib.robots.description import schema_text
from calib.robots.linear_delta import linear_delta_description, linear_delta_plan, linear_delta_urdf
from calib.robots.loading import describe, load
from calib.robots.templates import MEASURES, TEMPLATES, Measure, description_text, loop_files, read_lengths
from calib.robots.urdf.arm_chain import arm_chain
from calib.robots.urdf.denavit_hartenberg import CONVENTIONS, LAST_LINK, urdf_text
from calib.robots.urdf.text import UrdfText, parse_urdf, read_urdf

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
@click.option("--dh", metavar="FILE", help="Denavit-Hartenberg table (CSV) in place of a URDF, which is then written.")
@click.option("--convention", type=click.Choice(CONVENTIONS), help="Of the table, if it does not say it itself.")
@click.option("--template", type=click.Choice(tuple(TEMPLATES)), help="A robot with loops in place of a URDF.")
@click.option("--klipper", metavar="FILE", help="Delta printer: its printer.cfg, with what the probe measured.")
@click.option("--marlin", metavar="FILE", help="Delta printer: a file with Marlin's M665 and M666.")
@click.option("--duet", metavar="FILE", help="Delta printer: a file with M665 and M666 of RepRapFirmware.")
@click.option(
    "--length",
    "lengths",
    multiple=True,
    metavar="NAME=VALUE",
    help=f"Of the template, such as rod=300mm; once for each. Names and defaults are: {_LENGTHS};"
    " of a printer: arm, as designed or measured.",
)
@click.option(
    "--schema", is_flag=True, help="Write the JSON schema of robot descriptions instead, with which editors check them."
)
@click.option(
    "--out",
    required=True,
    metavar="FILE",
    help="YAML file to write; the URDF of --dh, --template or a printer goes beside it, and its measurements (.csv).",
)
@shared_options()
def command(
    urdf: str | None,
    target: str | None,
    measure: str | None,
    dh: str | None,
    convention: str | None,
    template: str | None,
    klipper: str | None,
    marlin: str | None,
    duet: str | None,
    lengths: tuple[str, ...],
    schema: bool,
    out: str,
    output: Output,
) -> None:
    """Write a commented robot description for URDF to start from.

    Without --target it describes the longest chain of joints with motors, without the fingers of a gripper, and says
    what it leaves out. With --dh it starts from a Denavit-Hartenberg table: columns theta, d, a, alpha (and beta), with
    units, one row for each joint. With --template it writes the URDF, cut open, and the
    description of a robot with loops, which --length fits to yours. With --klipper it makes both, and the measurements,
    from what a delta printer has in its printer.cfg; with --marlin or --duet, both from the settings alone.
    """
    printers = {name: file for name, file in (("klipper", klipper), ("marlin", marlin), ("duet", duet)) if file}
    if schema:
        if urdf or dh or template or printers:
            raise InputError("--schema is the same for all robots; give nothing but --out")
        output.check(out)
        write_files({Path(out): schema_text().encode()}, force=output.force)
        output.say(f"{out} written; first line of a description: # yaml-language-server: $schema={Path(out).name}")
        return
    if sum(given is not None for given in (urdf, dh, template, *printers.values())) != 1:
        raise InputError(
            "give a URDF, or a Denavit-Hartenberg table with --dh, or a --template, or a printer with --klipper,"
            " --marlin or --duet; one of them"
        )
    if template and target:
        raise InputError("--target is for a URDF or a table; a template has its own targets")
    if (template or printers) and measure:
        raise InputError("--measure is for a URDF or a table; a template has its own targets, a printer its nozzle")
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
    output.check(out, *(str(file) for file in (beside, sheet) if file is not None))
    relative = os.path.relpath(Path(text.path).resolve(), Path(out).resolve().parent)
    chain = arm_chain(text, target or (LAST_LINK if dh else None))
    description = description_text(text, describe(chain, relative), chain.remark, measure).encode()
    files = {beside: text.source, Path(out): description} if beside else {Path(out): description}
    if sheet and how:
        files[sheet] = _empty_sheet(text, description.decode(), how).encode()
    write_files(files, force=output.force)
    if beside:
        output.say(f"{beside} written, from the table")
    output.say(f"{out} written; it works as it is, and its comments say what to change")
    if sheet is not None:
        output.say(f"{sheet} written, with the header for your measurements; then: calib check {out} {sheet}")
    if chain.remark:
        output.say(chain.remark)


def _empty_sheet(urdf: UrdfText, description: str, measure: Measure) -> str:
    """The header of the measurements of a robot, with what to know while they are taken above it."""
    with TemporaryDirectory() as folder:  # only a loaded robot knows its columns
        (Path(folder) / "robot.urdf").write_bytes(urdf.source)
        said = yaml.safe_load(description) | {"urdf": "robot.urdf"}
        (Path(folder) / "robot.yaml").write_text(yaml.safe_dump(said), encoding="utf-8")
        robot = load(Path(folder) / "robot.yaml")
    columns = ["pose", *(header(name, robot.mechanism.dimensions[name]) for name in robot.joint_names)]
    for one in robot.instruments:
        columns += [*(header(column.name, column.dimension) for column in one.columns()), *one.text_columns()]
    return format_table([(column, ()) for column in dict.fromkeys(columns)], measure.comments)


def _write_template(name: str, given: Sequence[str], urdf: Path, description: Path, output: Output) -> None:
    """Write the two files of a template, if the robot that they describe can be used."""
    texts = dict(zip((urdf, description), loop_files(name, read_lengths(name, given), urdf.name), strict=True))
    with TemporaryDirectory() as folder:
        for file, text in texts.items():
            (Path(folder) / file.name).write_text(text, encoding="utf-8")
        try:
            load(Path(folder) / description.name)
        except DescriptionError as error:
            what = str(error).replace(f"{Path(folder) / description.name}: ", "")
            raise InputError(f"template {name}: with these lengths, {what}") from None
    write_files({file: text.encode() for file, text in texts.items()}, force=output.force)


def _write_printer(printer: PrinterFile, target: str | None, given: Sequence[str], out: Path, output: Output) -> None:
    """Write the description, the URDF and the measurements of a printer."""
    if target:
        raise InputError("--target is for a URDF or a table; a printer has its nozzle")
    arm = None
    for text in given:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals or key != "arm" or arm is not None:
            raise InputError(f"--length {text}: of a printer give arm=VALUE once, such as arm=288mm")
        arm = quantity(value, "length", "--length arm")
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

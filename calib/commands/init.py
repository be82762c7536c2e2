"""`calib init`: a robot description to start from."""

from __future__ import annotations

import os
from pathlib import Path

import click

from calib.commands.common import Output, shared_options
from calib.data.dh_files import read_dh
from calib.errors import InputError
from calib.files import check_file, write_file
from calib.model.arm_chain import arm_chain
from calib.model.denavit_hartenberg import CONVENTIONS, LAST_LINK, urdf_text
from calib.model.templates import describe, description_text
from calib.model.urdf_text import UrdfText, parse_urdf, read_urdf


@click.command("init")
@click.argument("urdf", required=False)
@click.option("--target", metavar="NAME", help="Link that carries the measured point; the arm's end if not given.")
@click.option("--dh", metavar="FILE", help="Denavit-Hartenberg table (CSV) in place of a URDF, which is then written.")
@click.option("--convention", type=click.Choice(CONVENTIONS), help="Of the table, if it does not say it itself.")
@click.option("--out", required=True, metavar="FILE", help="YAML file to write; with --dh, the URDF goes beside it.")
@shared_options()
def command(
    urdf: str | None, target: str | None, dh: str | None, convention: str | None, out: str, output: Output
) -> None:
    """Write a commented robot description for URDF to start from.

    Without --target it describes the longest chain of joints with motors, without the fingers of a gripper, and says
    what it leaves out. With --dh it starts from a Denavit-Hartenberg table: columns theta, d, a, alpha (and beta), with
    units, one row for each joint.
    """
    if (urdf is None) == (dh is None):
        raise InputError("give a URDF, or a Denavit-Hartenberg table with --dh; one of the two")
    if convention and not dh:
        raise InputError("--convention is for a table given with --dh")
    if Path(out).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{out}: the name of a robot description ends in .yaml")
    beside = Path(out).with_suffix(".urdf") if dh else None
    for file in (Path(out), *([beside] if beside else [])):
        if file.exists():
            raise InputError(f"{file}: exists already; choose another name, so that no edited description is lost")
        check_file(file)
    text = _from_table(dh, convention, beside) if dh and beside else read_urdf(str(urdf))
    relative = os.path.relpath(Path(text.path).resolve(), Path(out).resolve().parent)
    chain = arm_chain(text, target or (LAST_LINK if dh else None))
    if beside:
        write_file(beside, text.source)
        output.say(f"{beside} written, from the table")
    write_file(out, description_text(text, describe(chain, relative), chain.remark))
    output.say(f"{out} written; it works as it is, and its comments say what to change")
    if chain.remark:
        output.say(chain.remark)


def _from_table(dh: str, convention: str | None, path: Path) -> UrdfText:
    return parse_urdf(urdf_text(read_dh(dh, convention), Path(dh).stem).encode(), str(path))

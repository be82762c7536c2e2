"""`calib init`: a robot description to start from."""

from __future__ import annotations

import os
from pathlib import Path

import click

from calib.commands.common import Output, shared_options
from calib.errors import InputError
from calib.files import check_file, write_file
from calib.model.arm_chain import arm_chain
from calib.model.templates import describe, description_text
from calib.model.urdf_text import read_urdf


@click.command("init")
@click.argument("urdf")
@click.option("--target", metavar="NAME", help="Link that carries the measured point; the arm's end if not given.")
@click.option("--out", required=True, metavar="FILE", help="YAML file to write.")
@shared_options()
def command(urdf: str, target: str | None, out: str, output: Output) -> None:
    """Write a commented robot description for URDF to start from.

    Without --target it describes the longest chain of joints with motors, without the fingers of a gripper, and says
    what it leaves out.
    """
    if Path(out).exists():
        raise InputError(f"{out}: exists already; choose another name, so that no edited description is lost")
    if Path(out).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{out}: the name of a robot description ends in .yaml")
    check_file(out)
    text = read_urdf(urdf)
    relative = os.path.relpath(Path(urdf).resolve(), Path(out).resolve().parent)
    chain = arm_chain(text, target)
    write_file(out, description_text(text, describe(chain, relative), chain.remark))
    output.say(f"{out} written; it works as it is, and its comments say what to change")
    if chain.remark:
        output.say(chain.remark)

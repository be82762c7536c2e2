"""`calib init` for delta printers: description, URDF and measurements from a firmware's settings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.files import write_files
from calib.core.base.units import quantity, quantity_text
from calib.core.base.words import count_noun
from calib.core.commands.common import Output
from calib.core.robots.urdf.writing import robot_text
from calib.printers.files import printer_table, read_printer
from calib.printers.linear_delta import NAME, linear_delta_description, linear_delta_plan
from calib.printers.rows import PrinterFile, expected_geometry, residuals
from calib.shared.first_files import FirstFiles


def _write(firmware: str, file: str, given: Sequence[str], out: Path, output: Output) -> None:
    printer, arm = read_printer(file, firmware), None
    for text in given:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals or key != "arm" or arm is not None:
            raise InputError(f"--length {text}: a printer has one length; write it once, such as arm=288mm")
        arm, stated_length = quantity(value, "length", "--length arm"), max(printer.geometry.arms)
        if not stated_length / 2 < arm < stated_length * 2:
            raise InputError(
                f"--length {text}: is {quantity_text(arm, 'mm', 'g')}, and {printer.path} has arms of"
                f" {quantity_text(stated_length, 'mm', 'g')};"
                " correct it, with its unit, such as arm=288mm"
            )
    geometry = expected_geometry(printer, arm)
    plan = linear_delta_plan(geometry, 1 if np.all(printer.rows.is_height) else 2)
    urdf, title = out.with_suffix(".urdf"), " ".join(Path(printer.path).name.replace("--", "-").split())
    files = {
        urdf: robot_text(NAME, f"linear delta, cut open: {title}", plan.links, plan.joints),
        out: linear_delta_description(plan, title, urdf.name, len(printer.rows), printer.geometry),
        **({out.with_suffix(".csv"): printer_table(printer)} if printer.rows else {}),
    }
    output.check(*map(str, files))
    write_files({file: text.encode() for file, text in files.items()}, force=output.force)
    heights = int(np.sum(printer.rows.is_height))
    rows = f", with {count_noun(heights, 'height')} and {count_noun(len(printer.rows) - heights, 'distance')}"
    output.say(f"{', '.join(map(str, files))} written{rows if printer.rows else ''}")
    if printer.rows:
        output.say(_saved_errors(printer))
        output.say(f"next: calib fit {out} {out.with_suffix('.csv')} --out out/{out.stem}")


def _saved_errors(printer: PrinterFile) -> str:
    errors, is_height = residuals(printer.geometry, printer.rows), printer.rows.is_height
    kinds = {"heights": errors[is_height], "distances": errors[~is_height]}
    parts = [f"{n} {quantity_text(np.sqrt(np.mean(e**2)), 'mm', '.4f')} RMS" for n, e in kinds.items() if e.size]
    return (
        f"errors of the settings in {Path(printer.path).name}: {', '.join(parts)}; the firmware computed these"
        " settings from the same rows, so the verdict compares a fit with the printer as designed"
    )


def _files_of_firmware(name: str, help: str) -> FirstFiles:
    lengths = "of a printer: arm, as designed or measured"
    return FirstFiles(f"Delta printer: {help}", "a printer has its nozzle", partial(_write, name), lengths)


KLIPPER = _files_of_firmware("klipper", "its printer.cfg, with what the probe measured.")
MARLIN = _files_of_firmware("marlin", "a file with Marlin's M665 and M666.")
DUET = _files_of_firmware("duet", "a file with M665 and M666 of RepRapFirmware.")

"""`calib board`, which writes a board to print, and the options by which other commands take a board."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.files import write_files, write_folder
from calib.core.commands.common import Output, shared_options
from calib.core.instruments.board import Board, read_board
from calib.photographs.printing import FORMATS, PAPERS, page
from calib.photographs.rendering import example

_PHOTOGRAPHS = 12
_HELP = (
    "The board: a YAML file (kind, columns, rows, square, marker, dictionary), or in short"
    " charuco:7x5:30mm:22mm:DICT_5X5_100"
    " (squares, side, marker), chessboard:9x6:25mm (squares, not inner corners), circles:4x11:20mm, dots:10x8:15mm,"
    " aruco:4x3:40mm:10mm:DICT_4X4_50, apriltag:4x3:40mm:10mm (markers, side, gap)."
)
board_option = click.option("--board", required=True, metavar="FILE|TEXT", help=_HELP)
"""Option for a required board."""
board_if_any = click.option("--board", metavar="FILE|TEXT", help=_HELP)
"""Option for an optional board."""


def read_board_option(text: str) -> Board:
    """Return the board of a file or of a short form; see `calib.core.instruments.board.read_board`."""
    return read_board(text, f"--board {text}")


@click.command("board")
@board_option
@click.option(
    "--paper", type=click.Choice(sorted(PAPERS)), help="Page to print on; as large as the board if not given."
)
@click.option(
    "--photographs", metavar="DIR", help="Also write 12 simulated photographs with poses, to try calib hand-eye."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the photographs.")
@click.option("-o", "--out", required=True, metavar="FILE", help="PDF or SVG file to write.")
@shared_options()
def command(board: str, paper: str | None, photographs: str | None, seed: int, out: str, output: Output) -> None:
    """Write a board to print, in true size, with a ruler to check the print.

    calib detect, calib hand-eye and robot descriptions take the same board.
    """
    form = Path(out).suffix.lower().removeprefix(".")
    if form not in FORMATS:
        raise InputError(f"{out}: the name of a page to print ends in .pdf or .svg")
    described = read_board_option(board)
    names = [*(f"shot_{k + 1:02d}.png" for k in range(_PHOTOGRAPHS)), "poses.csv", "truth.json"]
    output.check(out, folders=(photographs,), names=names)
    content = page(described, form, paper)
    write_files({Path(out): content}, comment="%" if form == "pdf" else "", force=output.force)
    output.say(f"{out} written: {described}; print it at 100 % and measure the ruler")
    if photographs:
        with output.working("rendering photographs"):
            files = example(described, _PHOTOGRAPHS, np.random.default_rng(seed))
        write_folder(photographs, files, force=output.force)
        output.say(f"{_PHOTOGRAPHS} simulated photographs and poses.csv written to {photographs}, seed {seed}")

"""The meaning of G-code words in firmwares: which words leave the machine as it was, and where firmwares differ.

A word that is on no list here may do anything. The lists follow the firmwares' manuals (Marlin's and RepRapFirmware's
dictionaries of G-code, Klipper's page of commands, LinuxCNC's lists of G and M codes). If the firmware is unknown,
a word counts as harmless only if it is harmless in all of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from calib.core.base.errors import InputError
from calib.programs.languages.tokens import word_list


def parse_words(text: str) -> frozenset[str]:
    """Return the words of a text; `M3-5` means M3, M4 and M5."""
    words: set[str] = set()
    for word in text.split():
        first, _, last = word[1:].partition("-")
        words.update([f"{word[0]}{n}" for n in range(int(first), int(last) + 1)] if last else [word])
    return frozenset(words)


def _listed(name: str) -> frozenset[str]:
    return parse_words(" ".join(word_list(name)))


@dataclass(frozen=True)
class Dialect:
    """The rules of a firmware.

    Attributes:
        name: Name for `--dialect`; empty if the firmware is unknown.
        harmless: Words that change neither position nor coordinates, modes or tool.
        moving: Words that move the machine and change nothing else.
        at_once: Whether the order of words in a line is irrelevant and T only prepares a tool, as in RS274; else
            commands run one after the other, each with the words after it.
        allows_several: Whether a line may have several commands.
        modal: Whether X, Y, Z without a G repeat the motion before.
        parentheses: Whether a text in parentheses is certainly a comment.
        fanuc: Whether the rules of FANUC and Haas may hold: a semicolon ends a block and begins no comment, and a
            number without a point counts thousandths of a millimetre.
        inches: Whether numbers can be in inches.
        spelling: Regular expression of valid commands.
        e_follows: Whether G91 makes E relative, whatever M82 says.
        exponents: Whether E after a digit may be an exponent.
        same_tool: Whether selecting the present tool again certainly does nothing.
        move_words: Letters with which G0 and G1 remain straight moves.
        retracting: Letters that G10 and G11 may have without moving a zero.
        saving, restoring: The words that save and restore modes.
        restores_once: Whether saved modes are restored once, the last first.
    """

    name: str
    harmless: frozenset[str]
    moving: frozenset[str]
    at_once: bool = False
    allows_several: bool = True
    modal: bool = True
    parentheses: bool = False
    fanuc: bool = False
    inches: bool = True
    spelling: str = ".*"
    e_follows: bool = False
    exponents: bool = False
    same_tool: bool = False
    move_words: str = "XYZEFS"
    retracting: frozenset[str] = frozenset()
    saving: str = ""
    restoring: str = ""
    restores_once: bool = False


MILLING = (".nc", ".ngc", ".tap", ".cnc")
"""Endings of the files of milling machines."""
REFUSED = {
    **dict.fromkeys(("G2", "G3"), "arcs are not read; let the program that made it write lines (arc fitting off)"),
    **dict.fromkeys(("G18", "G19"), "arcs in other planes are not read; write lines"),
    "G92": "moves the zero of an axis; write the program in one system of coordinates",
    "G93": "speeds per move do not fit moves that are cut; write speeds per minute (G94)",
    **dict.fromkeys(("G10", "G11"), "sets offsets or tools; only a retraction, without other words, is read"),
}
"""Reason why each of these G words is always refused."""
CHANGING = _listed("G-code CHANGING")
"""Words that change the meaning of X, Y and Z."""
CALLING = parse_words("M32 M47 M97-99 M808 SDCARD_PRINT_FILE SDCARD_LOOP_BEGIN SDCARD_LOOP_END")
"""Words that run lines elsewhere or again."""
CONDITIONAL = parse_words("IF ELIF ELSE WHILE BREAK CONTINUE ABORT")
"""Words that run lines under a condition."""
STOPPING = parse_words("M0-2 M30 M60")
"""Words that stop the machine, behind the motion of their line."""
TEXT = "M117"
"""The word before a text that no firmware reads as code."""

_EVERYWHERE = _listed("G-code")
_PROBING = parse_words("G29 M420")
_KLIPPER, _KLIPPER_MOVING = _listed("Klipper"), _listed("Klipper MOVING")
_SAVING, _RESTORING = "SAVE_GCODE_STATE", "RESTORE_GCODE_STATE"
_UNKNOWN = Dialect("", _EVERYWHERE | {"G61"}, _PROBING | {"G80"}, exponents=True)
DIALECTS = {
    dialect.name: dialect
    for dialect in (
        Dialect(
            "cnc",
            _EVERYWHERE | parse_words("G54 G61 G80 M19 M48-53 M60 M62-68 M70-71"),
            _PROBING | parse_words("G28.1 G30 G30.1"),
            at_once=True,
            parentheses=True,
            fanuc=True,
        ),
        Dialect(
            "klipper",
            _EVERYWHERE | _KLIPPER,
            _PROBING | _KLIPPER_MOVING,
            allows_several=False,
            modal=False,
            inches=False,
            spelling=r"[GMT](0|[1-9]\d*)(\.\d*[1-9])?",  # not G01
            e_follows=True,
            saving=_SAVING,
            restoring=_RESTORING,
        ),
        Dialect(
            "marlin",
            _EVERYWHERE | parse_words("M120-121 M226 M600-601"),
            _PROBING | parse_words("G30 G60 G61 G80"),
            allows_several=False,
            modal=False,
            same_tool=True,
        ),
        Dialect(
            "rrf",
            _EVERYWHERE | parse_words("G54 G60 M226 M600-601"),
            _PROBING,
            modal=False,
            parentheses=True,
            spelling=r"[GMT]-?\d+(\.\d)?",  # not G 1
            exponents=True,
            same_tool=True,
            move_words="XYZEF",  # S is the power of a laser, or homing, by the version
            retracting=parse_words("P R S"),  # temperatures
            saving="M120",
            restoring="M121",
            restores_once=True,
        ),
    )
}
"""Rules of each firmware by its name for `--dialect`."""
_FLAVOURS = {"klipper": "klipper", "reprapfirmware": "rrf"}  # not Marlin: Klipper prints many such files
_FLAVOUR = re.compile(r"^;\s*(?:gcode_flavor\s*=|FLAVOR:)\s*(\w+)", re.IGNORECASE | re.ASCII)
_NAME = re.compile(r"\s*([A-Z_]{2}\w*)", re.IGNORECASE | re.ASCII)


def find_dialect(path: Path | str, lines: Iterable[str], name: str | None = None) -> Dialect:
    """Return the rules for reading a program.

    Args:
        path: The file; one that ends as in `MILLING` is a program of a milling machine.
        lines: Its lines, which may name the flavour (as slicers do) or have a command that only Klipper has.
        name: The firmware, if known.

    Raises:
        InputError: The firmware has no rules here.
    """
    if name is not None:
        if name not in DIALECTS:
            raise InputError(f"--dialect {name}: must be one of {', '.join(DIALECTS)}")
        return DIALECTS[name]
    klippers = _KLIPPER | _KLIPPER_MOVING | CHANGING | {_SAVING, _RESTORING}
    has_words = False
    for line in lines:
        flavour, command = _FLAVOUR.match(line), _NAME.match(line)
        if flavour and flavour[1].lower() in _FLAVOURS:
            return DIALECTS[_FLAVOURS[flavour[1].lower()]]
        has_words |= command is not None and command[1].upper() in klippers
    if has_words:
        return DIALECTS["klipper"]
    return DIALECTS["cnc"] if Path(path).suffix.lower() in MILLING else _UNKNOWN

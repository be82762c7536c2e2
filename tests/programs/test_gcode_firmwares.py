"""Firmwares that run a compensated program go where they went before, plus the correction, and do all else alike."""

from __future__ import annotations

import random
import re

import numpy as np
import pytest

import calib
from calib.programs.languages.gcode import read_gcode
from tests.programs.gcode_firmwares import FIRMWARES

MIX = np.array([[4e-3, -3e-3, 2e-3], [5e-3, -2e-3, 1e-3], [-1e-3, 2e-3, 3e-3]])  # a correction that depends on all axes
SHIFT = np.array([0.31, -0.22, 0.13])  # [mm]
HOME = np.array([5.0, -8.0, 2.0])  # [mm]
ROUNDED = 3e-4  # decimals of the file, of a move and of what it counts from [mm]


def each(text):
    """Lines of a program that `|` stands between."""
    return [line.strip() for line in text.split(" | ")]


HARMLESS = {
    "klipper": each(
        "SET_VELOCITY_LIMIT ACCEL=900 | EXCLUDE_OBJECT_START NAME=x9 | M117 G91 now | SET_PIN PIN=x VALUE=1"
    ),
    "marlin": each('M117 G91 now | M204 P500 T900 | M203 X100 Y100 | M600 | M121 | M900 K0.05 | M862.3 P "MK3S"'),
    "rrf": each('M117 G91 now | M203 X6000 Y6000 | G60 S1 | M226 | M118 P0 S"x ; G91" | (G91) | G10 P0 S200 R150'),
    "cnc": each("(G91 here) | G17 G40 | G64 P0.01 | M3 S900 | M8 | G94 | G54 | M62 P1 | %"),
}
COMMON = each("; G91 X5 | M104 S200 | G92 E0 | G4 P10 | M82 | M83 | G90 | G91 | G21 | G1 F1200 | M106 S99 | M107")
RISKY = {
    "klipper": each(
        "G28 | G28 Z | G28 X0 Y0 | G29 | SAVE_GCODE_STATE NAME=a | SAVE_GCODE_STATE | M120 | M121 | G30 | "
        "RESTORE_GCODE_STATE NAME=a | RESTORE_GCODE_STATE NAME=a MOVE=1 | RESTORE_GCODE_STATE NAME=b | G92 X0 | "
        "SET_GCODE_OFFSET Z=0.2 | SET_GCODE_OFFSET X=3 MOVE=1 | SET_KINEMATIC_POSITION Z=4 | SKEW_PROFILE LOAD=a | "
        "BED_MESH_CLEAR | BED_MESH_CALIBRATE | PARK | CHANGE | T1 | T0 | M600 | G28 (X only) | G92 | G1 E-1 | "
        "restore_gcode_state name=a | G91 G1 X4 | X4 Y5 | G1 X4 (not Y9) | G92 E1 | QUAD_GANTRY_LEVEL | G28 Y | "
        "G01 X4 | G 1 X4 | G1.0 X4 | M104 S2 M117 G91"
    ),
    "marlin": each(
        "G28 | G28 Z | G28 X Y | G28 O | G28 W | G29 | G30 | M206 X1 | M428 | M852 I0.1 | M420 S1 | T0 | T1 | G60 S0 "
        "| G61 XYZ | G61 | M120 | M121 | M665 L9 | G92 X3 | G54 | G55 | G20 | G91 G1 X4 | X4 | G1 X4 (not Y9) | M701 "
        "| M125 | G92.1 | M92 X80 | G28 (X only) | G53 G1 X1 | G12 | M810 G91|G1 X9 | G1X3Y4E1.5 | G1 X1E1 | M83 G91 "
        "| N5 G91 | G28 R5 | T0 S1 | g28 z | G80 | N7 T1"
    ),
    "rrf": each(
        "G28 | G28 Z | G28 X0 | G29 | G30 | M120 | M121 | M120 ; push | G91 G1 X4 | G1 X4 G91 | G90 G1 Y3 | G91 X4 | "
        "M206 X1 | M290 Z0.1 | M556 S100 X1 | M579 X1.01 | T0 | T1 | T1 P0 | G10 P1 X3 | G10 L2 P1 X3 | G 1 X4 | "
        'G01 Y5 | M104 S2 M117 G91 | M117 "a" G91 | G54 | G55 | G1 H2 X5 | G1 R1 X0 | G1 S1 X3 | M98 P"a.g" | if true '
        '| G20 | G92 X3 | X4 | G1 X1E1 | G1 X1 E1 M106 S3 | M701 | M104 S200 G91 | M118 S"(" G91 ; ") | echo "G91" | '
        "M106 S9 G1 X3 | N4 M121"
    ),
    "cnc": each(
        "G28 | G28 Z0 | G91 G28 Z0 | G28 G91 Z0 | G0 G28 X0 | G28.1 | G30 | G55 | G54 | G92 X0 | M6 | T1 M6 | T2 | "
        "M70 | M72 | G53 G0 Z0 | G43 H1 | G90 X4 | X4 G91 | G1 G91 X2 | G20 | X5 G4 P1 | G80 | X4 Y5 | "
        "G0 G90 G54 X3 Y3 | M101 | G10 L2 P1 X3 | M98 P1 | G68 X0 Y0 R10 | G18 | G2 X4 I2 | M3 X4 | G52 X3"
    ),
}
MACROS = ["PARK", "CHANGE", "T1", "T0", "M600", "M701", "M125", "M6", "M101", "START_PRINT", "IF", "ECHO"]
BODIES = [[], ["G91"], ["G90"], ["G92 X7 Y3"], ["G1 X50 Y50 Z9"], ["G91", "G1 Z5", "G90"], ["M83"], ["G28"], ["G20"]]


def corrected(points, zero):
    """Places that the firmware shall be sent to, of places (..., 3) [mm] and the zero that they count from (3,)."""
    own = points - zero
    return points + own @ MIX.T + SHIFT


def motion(rng, dialect):
    """A line that moves the machine."""
    axes = sorted(rng.sample("XYZ", rng.choice([1, 1, 2, 2, 3, 3, 3])))
    letters = [*axes, *(["E"] if dialect != "cnc" and rng.random() < 0.3 else [])]
    space = rng.choice(["", " ", " ", " "])
    words = [
        rng.choice(["G0", "G1", "G1", "G1" if dialect == "klipper" else "G01", "g1"]),
        *(f"{a}{round(rng.uniform(-40, 40), 3):g}" for a in letters),
    ]
    if rng.random() < 0.2:
        words.insert(rng.choice([1, len(words)]), f"F{rng.randrange(100, 9000)}")
    if letters[-1] == "E" and space == "" and dialect == "rrf":
        space = " "
    line = space.join(words)
    line = line.lower() if rng.random() < 0.1 else line
    line = f"N{rng.randrange(99)} {line}" if rng.random() < 0.1 else line
    comments = ["", "", " ; note X5", "" if dialect == "klipper" else " (over the corner)"]  # an error of Klipper
    return line + rng.choice(comments)


def program(rng, dialect):
    """A program, and whether the machine's place after homing is known to be that of the firmware."""
    risky = rng.choice([0, 0, 0.05, 0.1, 0.3])
    named = [line for line in ("START_PRINT",) if rng.random() < 0.2] if dialect == "klipper" else []
    lines = [
        *named,
        *rng.choice([["G28"], ["G28", "G90"], ["G90", "G21"], ["G28", "G90", "M83"], ["G90", "G21", "M82"]]),
    ]
    if rng.random() < 0.8:
        lines.append(f"G1 X{rng.randrange(-9, 9)} Y{rng.randrange(-9, 9)} Z{rng.randrange(9)} F900")
    for _ in range(rng.randrange(2, 14)):
        kind = rng.random()
        if kind < risky:
            lines.append(rng.choice(RISKY[dialect]))
        elif kind < 0.45:
            lines.append(rng.choice(COMMON + HARMLESS[dialect]))
        else:
            lines.append(motion(rng, dialect))
        if rng.random() < 0.1 and dialect != "cnc":
            lines.append(f"G1 E{rng.randrange(-9, 9)} F1800")
    return lines


def judge(rng, dialect, folder):
    """Whether a random program was compensated; raises `AssertionError` where it moves the machine elsewhere."""
    lines = program(rng, dialect)
    own = [] if dialect == "klipper" else ["M600"]  # where it is no macro
    macros = {name: rng.choice(BODIES) for name in MACROS if name not in own}
    preparing = {"T0", "T1", "M6", "G54", "G55", "G20", *MACROS} & {
        word.upper() for line in lines for word in line.split()
    }
    start = tuple(HOME / 1e3) if rng.random() < 0.6 and not preparing else None
    # not every firmware runs these whole, or as they are spelled
    whole = [line for line in lines if re.match(r"X|G9[01] ?[GX]|M83 G|.*S1|.*G01|G 1|G1\.0", line)]
    follows = dialect == "klipper" and {"G91", "M82"} <= {*lines}  # where its E stays relative
    said = dialect if whole or follows or rng.random() < 0.7 else None
    text = "\n".join(lines)
    path = folder / ("part.nc" if dialect == "cnc" else "part.gcode")
    path.write_text(text)
    try:
        read = read_gcode(path, start, said)
    except calib.DataError:
        return False
    first = FIRMWARES[dialect](HOME.copy(), macros).run(text)
    if first.halted:
        return False
    moves = [step for step in first.steps if step.commanded]
    assert len(moves) == len(read.moves), text
    cuts = [1 if move.start is None else rng.choice([1, 1, 2, 3]) for move in read.moves]
    for pieces in (cuts, [1] * len(cuts)):  # where a move with an E of unknown meaning would be cut
        ways = [
            1e-3 * corrected(step.start + (step.end - step.start) * (1 + np.arange(n))[:, None] / n, step.zero)
            - 1e-3 * step.zero
            for step, n in zip(moves, pieces, strict=True)
        ]
        try:
            written = read.rewritten(ways)
            break
        except calib.DataError:
            continue
    second = FIRMWARES[dialect](HOME.copy(), macros).run(written)
    compare(moves, pieces, first, second, f"{dialect}, said {said}, start {start}\n{text}\n-> \n{written}\n{macros}")
    return True


def compare(moves, pieces, first, second, what):
    """The machine that runs the compensated program goes where the other one goes, plus the correction."""
    told = [step for step in second.steps if step.commanded]
    assert len(told) == sum(pieces), what
    assert first.others == second.others, what
    assert len(first.steps) - len(moves) == len(second.steps) - len(told), what
    for step, n in zip(moves, pieces, strict=True):
        assert step.frame == moves[0].frame, what  # what was known of the robot belongs to one zero and one tool
        own, told = told[:n], told[n:]
        share = (1 + np.arange(n))[:, None] / n
        meant = corrected(step.start + (step.end - step.start) * share, step.zero)
        assert np.abs(np.array([piece.end for piece in own]) - meant).max() < ROUNDED, what
        assert abs(sum(piece.e for piece in own) - step.e) < 1e-4, what
        assert np.ptp([piece.e for piece in own]) < 1e-3, what  # five decimals of an inch
        assert {piece.feed for piece in own} == {step.feed}, what


@pytest.mark.quick(1)
@pytest.mark.amount(150, 10_000)
@pytest.mark.parametrize("dialect", FIRMWARES)
def test_a_firmware_goes_where_it_went_plus_the_correction(dialect, tmp_path, amount):
    rng = random.Random(f"{dialect} 1")
    compensated = sum(judge(rng, dialect, tmp_path) for _ in range(amount))
    assert compensated > 0.2 * amount

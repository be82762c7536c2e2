"""A machine that runs a compensated G-code program goes straight where the program says, within the tolerance."""

import contextlib
import json
import re
import time
from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner

import calib
from calib.core.base.own_files import is_own
from calib.programs.commands.compensate import command
from calib.programs.languages.gcode import read_gcode
from calib.programs.languages.straight_moves import StraightMoves, compensate_moves
from calib.starting.command import command as init
from tests.programs.gcode_firmwares import Cnc
from tests.programs.test_correction_grid import gantry
from tests.project import EXAMPLES

SQUARE = "  - {origin: z, components: [rx, ry], sigma: 5 mrad}\n"
SCREW = "  - {joint: y, term: harmonics, period: 20 mm, orders: [1], sigma: 0.1 mm}\n"
PROGRAM = """; a printed part
G28
G90
M83 ; E counts from where it stands
G1 Z20 F9000
G1 X-90 Y-60 Z5 (over the corner)
G1 F1500
X95 Y70 E4.25
G92 E0
M117 G1 is no motion here
G91
M82
G1 Y-120 Z3 E9.5
G20
G0 X-3.5
G90
G21
G1 X-90 Y-60 Z5 ; back
M104 S0"""
ENDS = [(0, 0, 20), (-90, -60, 5), (95, 70, 5), (95, -50, 8), (6.1, -50, 8), (-90, -60, 5)]  # [mm], by hand


def told_points(text, start):
    """Ends of the motions of a written program, as a milling machine runs it, (n, 3) [mm], from `start` on."""
    steps = Cnc(np.array(start, dtype=float), {}).run(text).steps
    return np.array([start, *(step.end for step in steps if step.commanded)])


def off_the_path(points, corners):
    """Distances of points (n, 3) from the nearest of the straight lines between corners (m, 3)."""
    nearest = np.full(len(points), np.inf)
    for a, b in pairwise(corners):
        share = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return nearest


def between(points, n):
    """Points on the straight lines between points (m, 3), n on each."""
    share = np.linspace(0, 1, n)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(points)])


def delta_joints(p, base=0.15, platform=0.05, arm=0.2, rod=0.5):
    """The template's inverse kinematics in closed form: elbow and anchor of each arm are a rod apart, (n, 3) [rad]."""
    q = np.zeros((len(p), 3))
    for k, turn in enumerate((0, 2 * np.pi / 3, 4 * np.pi / 3)):
        radial = p[:, 0] * np.cos(turn) + p[:, 1] * np.sin(turn) + platform - base
        across = -p[:, 0] * np.sin(turn) + p[:, 1] * np.cos(turn)
        # radial cos q - z sin q = c, where q turns the arm down
        c = (radial**2 + across**2 + p[:, 2] ** 2 + arm**2 - rod**2) / (2 * arm)
        q[:, k] = -np.arctan2(p[:, 2], radial) - np.arccos(c / np.hypot(radial, p[:, 2]))
    return q


@pytest.fixture(scope="module")
def delta(tmp_path_factory):
    """The template's delta, its base and tool known."""
    folder = tmp_path_factory.mktemp("delta")
    assert CliRunner().invoke(init, ["--template", "delta", "--out", str(folder / "delta.yaml")]).exit_code == 0
    text = (folder / "delta.yaml").read_text()
    (folder / "known.yaml").write_text(
        text.replace("pose: unknown", "pose: known").replace("position: unknown, sigma: 2 mm", "position: known")
    )
    return calib.load(folder / "known.yaml")


@pytest.mark.quick(0)
def test_a_delta_goes_straight_within_tolerance_and_calibration(delta, tmp_path):
    robot = delta
    rng = np.random.default_rng(1)
    drawn = {p.name: p.nominal_si + 0.5 * p.sigma_si * rng.standard_normal() for p in robot.parameters}
    truth = robot.with_parameters(drawn)  # simulated
    place = np.array([0.0, 0.0, -0.45])
    q = delta_joints(place + rng.uniform(-0.1, 0.1, (60, 3)))
    assert np.abs(robot.positions(q)[:, 0] - place).max() < 0.1 + 1e-9
    fit = calib.fit(
        robot, calib.as_measurements(robot, q, truth.positions(q)[:, 0] + 1e-5 * rng.standard_normal((60, 3)))
    )
    (tmp_path / "part.gcode").write_text(PROGRAM)
    program = read_gcode(tmp_path / "part.gcode", (0.0, 0.0, 0.0))
    ends = np.array([move.end for move in program.moves]) + place
    assert np.abs(ends - place - np.array(ENDS) / 1e3).max() < 1e-12
    starts = np.array([move.start for move in program.moves]) + place
    tolerance = 2e-5
    compensated = compensate_moves(fit.robot, StraightMoves(starts, ends, tuple("abcdef")), tolerance)
    text = program.rewritten([way - place for way in compensated.waypoints])
    told = told_points(text, (0, 0, 0)) / 1e3 + place
    assert len(told) - 1 == sum(len(way) for way in compensated.waypoints) > 8
    way = between(
        told[len(compensated.waypoints[0]) :], 23
    )  # from the first end on: before it stands where it was switched on
    corners = np.array([*ends])
    real = truth.positions(delta_joints(way))[:, 0]
    held_out = delta_joints(between(corners, 40))
    calibration = np.linalg.norm(truth.positions(held_out) - fit.robot.positions(held_out), axis=2).max()
    plain = truth.positions(held_out)[:, 0]
    assert off_the_path(plain, corners).max() > 5e-4
    assert off_the_path(real, corners).max() < tolerance + calibration + 2e-7  # decimals of the file
    assert calibration < 1e-4
    assert np.nanmax(compensated.deviations) <= tolerance
    # with the calibrated robot itself the tolerance alone counts, and is used
    own = off_the_path(fit.robot.positions(delta_joints(way))[:, 0], corners).max()
    assert 0.3 * tolerance < own < tolerance + 2e-7


def test_a_gantry_with_the_error_of_a_screw_goes_straight(tmp_path):
    """In closed form: it stands at sums of skewed axes, with a gain along x and a wave of the screw along y."""
    robot = gantry(tmp_path, SQUARE + SCREW)
    names = {p.name for p in robot.parameters}
    assert {"y.rz", "z.rx", "z.ry", "x.gain"} < names
    wave = sorted(name for name in names if name.startswith("y.") and name != "y.rz")
    truth = robot.with_parameters({"y.rz": 3e-3, "z.rx": 2e-3, "x.gain": 1e-3, wave[0]: 8e-5})
    (tmp_path / "part.nc").write_text(PROGRAM)
    program = read_gcode(tmp_path / "part.nc", (0.0, 0.0, 0.0))
    starts, ends = (np.array([getattr(move, what) for move in program.moves]) for what in ("start", "end"))
    tolerance = 1e-5
    compensated = compensate_moves(truth, StraightMoves(starts, ends, tuple("abcdef")), tolerance)
    told = told_points(program.rewritten(compensated.waypoints), (0, 0, 0)) / 1e3
    way = between(told[len(compensated.waypoints[0]) :], 31)  # joints of a gantry are what its controller is told
    corners = np.array([*ends])
    assert off_the_path(truth.positions(between(corners, 31))[:, 0], corners).max() > 1e-4
    assert off_the_path(truth.positions(way)[:, 0], corners).max() < tolerance + 2e-7
    assert len(told) > 30  # a wave needs pieces; without it one for each move does
    skewed = robot.with_parameters({"y.rz": 3e-3, "z.rx": 2e-3, "x.gain": 1e-3})
    assert all(
        len(way) == 1 for way in compensate_moves(skewed, StraightMoves(starts, ends, tuple("abcdef")), 1e-5).waypoints
    )


def test_a_program_that_is_told_its_own_points_keeps_them(tmp_path):
    """Counted from where the machine stands, decimals do not add up."""
    text = "G91\n" + "G1 X0.3333333 Y0.1234567\n" * 900
    (tmp_path / "part.g").write_text(text)
    program = read_gcode(tmp_path / "part.g", (0.0, 0.0, 0.0))
    written = told_points(program.rewritten([np.array([move.end]) for move in program.moves]), (0, 0, 0))
    assert np.abs(written[-1] - [299.99997, 111.11103, 0]).max() < 1.1e-4


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gantry")
    robot = gantry(folder, SQUARE)
    truth = robot.with_parameters({"y.rz": 3e-3, "x.gain": 1e-3})
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.5, 0.5, (30, 3))
    data = calib.as_measurements(robot, q, truth.positions(q)[:, 0] + 1e-5 * rng.standard_normal((30, 3)))
    calib.fit(robot, data).save(folder / "result", pages=False)
    return folder


def run(folder, result, text, *options, name="part.gcode"):
    (folder / name).write_text(text)
    arguments = [str(result / "result"), str(folder / name), "--out", str(folder / "out.gcode"), *options]
    return CliRunner().invoke(command, arguments)


def test_the_command_writes_a_program_and_its_figures(tmp_path, calibrated):
    target = tmp_path / "figures.json"
    options = ("--start", "0,0,50", "--zero", "-100,-100,0", "--json", str(target))
    done = run(tmp_path, calibrated, "%\nG28\nG1 X100 F600\nX150 Y200\n", *options)
    assert done.exit_code == 0, done.output
    assert "2 straight moves compensated as 2 lines" in done.output
    lines = (tmp_path / "out.gcode").read_text().splitlines()
    assert lines[0] == "%"
    assert lines[1].startswith("; compensated for gantry with")
    assert lines[2] == "G28"
    words = dict(zip("XYZ", (float(word[1:]) for word in lines[4].split()), strict=True))
    # stands at 1.001 x - sin(a) y, cos(a) y with its zero at -100, -100: told ((x + tan(a) y) / 1.001, y / cos(a))
    x, y = (50 + np.tan(3e-3) * 100) / 1.001 + 100, 100 / np.cos(3e-3) + 100
    assert (words["X"], words["Y"], words["Z"]) == pytest.approx((x, y, 50), abs=0.03)
    again = run(tmp_path, calibrated, (tmp_path / "out.gcode").read_text(), *options[:4])
    assert again.exit_code == 2
    assert "part.gcode: is compensated already" in again.output
    figures = json.loads(target.read_text())
    assert (figures["n_moves"], figures["n_pieces"]) == (2, 2)
    assert figures["between_mm"]["max"] < 0.001 < figures["expected_mm"]["max"] < figures["before_mm"]["max"]


@pytest.mark.parametrize("name", ["part.nc", "part.ngc", "part.tap", "part.cnc"])
def test_comments_for_milling_machines_are_in_parentheses_behind_the_number_of_the_program(tmp_path, calibrated, name):
    """A semicolon ends a block on FANUC and Haas, which count thousandths in numbers without a point.

    Parentheses do not nest, and LinuxCNC reads 255 characters a line.
    """
    text = "%\nO1000 (PART)\nG21 G90\nG1 X100 Y100 Z50 F600\nX-100 Y-100\nM30\n%\n"
    done = run(tmp_path, calibrated, text, "--zero", "-100,-100,0", name=name)
    assert done.exit_code == 0, done.output
    written = (tmp_path / "out.gcode").read_text()
    code = [re.sub(r"\([^();%!?~]*\)", "", line).strip() for line in written.splitlines()]
    assert all(re.fullmatch(r"%|([A-Z][-\d.]+ ?)*", block) for block in code), code
    assert written.startswith("%\nO1000 (PART)\n(compensated for gantry")
    assert written.endswith(")\n%\n")  # nothing behind the end of the tape
    moves = [block for block in code if "X" in block]
    assert len(moves) >= 2
    assert all(re.search(rf"{axis}-?\d+\.\d", block) for block in moves for axis in "XYZ")  # else they are thousandths
    assert max(map(len, written.splitlines())) <= 255
    own = (tmp_path / "out.gcode").rename(tmp_path / f"again_{name}")
    again = run(tmp_path, calibrated, own.read_text() + "(joined)\n", "--zero", "-100,-100,0", name=name)
    assert "is compensated already" in again.output
    assert is_own(own)


@pytest.mark.parametrize(
    ("name", "first", "said"), [("a.nc", "G90", True), ("a.nc", "G90 G21", False), ("a.gcode", "G90", False)]
)
def test_a_milling_machine_may_begin_in_inches_which_is_said(tmp_path, calibrated, name, first, said):
    done = run(tmp_path, calibrated, f"{first}\nG1 X100 Y100 Z50\n", "--zero", "-100,-100,0", name=name)
    assert (done.exit_code, "has no G20 or G21" in done.output) == (0, said)


FIRST = "G1 X0 Y0 Z0\n"


@pytest.mark.quick(5)
@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", (), "has no straight moves"),
        ("M104 S200\nG92 E0\n", (), "has no straight moves"),
        ("G1 X10\n", (), "line 1: the machine's position along Y is not known here; give the position with --start"),
        (FIRST + "G28\nG1 Z5\n", (), "line 3: the machine's position along X"),
        ("G91\nG1 X1 Y1 Z1\n", (), "line 2: the machine's position along X"),
        (FIRST + "G2 X10 I5\n", (), "line 2: G2: arcs are not read"),
        (FIRST + "G3 X10 R5\n", (), "line 2: G3: arcs are not read"),
        (FIRST + "G81 X10 Z-5 R1\n", (), "line 2: G81: is not read"),
        (FIRST + "G55\n", (), "line 2: G55"),
        (FIRST + "G43 H1\n", (), "line 2: G43"),
        (FIRST + "G92 X0\n", (), "line 2: G92: moves the zero"),
        (FIRST + "G93\n", (), "line 2: G93: speeds per move"),
        (FIRST + "M665 L500\n", (), "line 2: M665 changes the meaning of X"),
        (FIRST + "M98 P2\n", (), "line 2: M98 calls another program"),
        (FIRST + "G1 X#5\n", (), "line 2: 'X#5' is not read"),
        (FIRST + "G1 X1..2\n", (), "line 2: '.2' is not read"),
        (FIRST + "G1 X1 X2\n", (), "line 2: has a letter twice"),
        (FIRST + "G0 G1 X1\n", (), "line 2: has two motions"),
        ("G20 G21\n" + FIRST, (), "line 1: has G20 and G21"),
        (FIRST + "G91 G90 X1\n", (), "line 2: has G90 and G91"),
        (FIRST + "G1 X1 A5\n", (), "line 2: 'A' does not belong"),
        (FIRST + "/G1 X1\n", (), "line 2: it is not known whether lines with / are run"),
        ("X1 Y1 Z1\n", (), "line 1: moves without G0 or G1"),
        (FIRST + "G1 X1" + 300 * "0" + "\n", (), "line 2: 'X10000000000000000000' is beyond what any machine reads"),
        (FIRST + "G1 X1 \x07\n", (), "line 2: is not text"),
        (FIRST + "G1 X1.\nY2 Z0\n", ("--dialect", "cnc"), "line 3: 'Y2' has no point, unlike other numbers"),
        (FIRST + "G1 X1; G1 Y2;\n", ("--dialect", "cnc"), "line 2: '; G1 Y2;' is code for some controls"),
        ("G1 X2000 Y0 Z0\n", (), "line 1 by the nominal robot misses by 1000"),
        (FIRST, ("--tolerance-mm", "0"), "--tolerance-mm 0: must lie between"),
        (FIRST, ("--tolerance-mm", "nan"), "--tolerance-mm nan: must lie between"),
        (FIRST, ("--start", "1,2"), "--start '1,2': write three numbers"),
        (FIRST, ("--zero", "1,2,x"), "--zero: '"),
        (FIRST, ("--keep", "pose"), "--keep: not for G-code"),
        (FIRST, ("--skip-unreachable",), "--skip-unreachable: not for G-code"),
    ],
)
def test_what_is_no_program_of_straight_moves_is_refused_in_one_line(tmp_path, calibrated, text, options, message):
    done = run(tmp_path, calibrated, text, *options)
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert len(done.output.strip().splitlines()) == 1
    assert not (tmp_path / "out.gcode").exists()


@pytest.mark.parametrize(
    "option",
    [
        ("--zero", "0,0,0"),
        ("--start", "0,0,0"),
        ("--tolerance-mm", "0.1"),
        ("--dialect", "rrf"),
        ("--harmless", "PARK"),
    ],
)
def test_options_of_programs_do_not_belong_to_tables(tmp_path, calibrated, option):
    done = run(tmp_path, calibrated, "x,y,z\n0,0,0\n", *option, name="part.csv")
    assert (done.exit_code, f"{option[0]}: not for tables" in done.output) == (2, True)


def test_e_that_firmwares_read_differently_is_refused_where_a_move_is_cut(tmp_path):
    (tmp_path / "a.gcode").write_text("M83\nG90\nG1 X0 Y0 Z0\nG1 X10 E1\n")
    program = read_gcode(tmp_path / "a.gcode")
    ways = [np.zeros((1, 3)), np.array([[5e-3, 0, 0], [1e-2, 0, 0]])]
    with pytest.raises(calib.DataError, match="line 4: is cut into 2 pieces, and the meaning of its E is unknown"):
        program.rewritten(ways)
    assert "G1 X10 Y0 Z0 E1" in program.rewritten([ways[0], ways[1][1:]])


@pytest.mark.parametrize(
    ("dialect", "line", "pieces"),
    [
        ("cnc", "M30 G1 X10 F500", ["G1 X5.0 Y0.0 Z0.0 F500", "G1 X10.0 Y0.0 Z0.0 M30"]),
        ("cnc", "G1 X10 M3 M0", ["G1 X5.0 Y0.0 Z0.0 M3", "G1 X10.0 Y0.0 Z0.0 M0"]),
        ("rrf", "G1 X10 F500 M5", ["G1 X5 Y0 Z0 F500", "G1 X10 Y0 Z0 M5"]),
        (None, "G1 X10 M5 M2", ["G1 X5 Y0 Z0 M5", "G1 X10 Y0 Z0 M2"]),
    ],
)
def test_a_cut_move_stops_at_its_end(tmp_path, dialect, line, pieces):
    """LinuxCNC's order of execution: spindle and coolant, motion, stop; RepRapFirmware runs commands as they stand."""
    (tmp_path / "a.gcode").write_text(f"G1 X0 Y0 Z0\n{line}\n")
    ways = [np.zeros((1, 3)), np.array([[5e-3, 0, 0], [1e-2, 0, 0]])]
    program = read_gcode(tmp_path / "a.gcode", dialect=dialect)
    assert program.rewritten(ways).splitlines()[1:] == pieces


def test_other_robots_and_too_sharp_bends_are_refused(tmp_path):
    arm = calib.load(EXAMPLES / "arm.yaml")
    moves = StraightMoves(np.full((1, 3), np.nan), np.array([[0.5, 0, 0.5]]), ("line 1",))
    with pytest.raises(calib.DataError, match="has 6 motors; a program of X, Y and Z is for a machine of three"):
        compensate_moves(arm, moves, 1e-5)
    robot = gantry(tmp_path, SCREW.replace("period: 20 mm", "period: 0.04 mm"))
    names = sorted(p.name for p in robot.parameters if p.name.startswith("y.") and p.name != "y.rz")
    rough = robot.with_parameters({names[0]: 2e-6})
    moves = StraightMoves(np.array([[0, -0.01, 0]]), np.array([[0, 0.01, 0.0]]), ("line 1",))
    with pytest.raises(
        calib.ComputationError, match=r"line 1: off by 0.0.* between points, and pieces of 0.05 mm do not"
    ):
        compensate_moves(rough, moves, 5e-7)


HERE = "G90\nG21\nG1 X100 Y100 Z10\n"
LOST = "the machine's position along"
PERHAPS = "may have moved zero or axes, or changed the tool"
CHANGED = "changes the meaning of X, Y and Z"
SEVERAL = "has words of several commands"


def written(folder, text, dialect=None, start=(0.0, 0.0, 0.0), harmless=(), name="any.gcode"):
    """The lines of a program behind three first ones, its points 10, 20 and 30 mm further; or why it is refused."""
    (folder / name).write_text(HERE + text + "\n")
    try:
        program = read_gcode(folder / name, start, dialect, harmless)
        ways = [np.array([move.end]) + np.array([0.01, 0.02, 0.03]) for move in program.moves]
        return program.rewritten(ways).splitlines()[3:]
    except calib.DataError as error:
        return str(error)


def before(move, why, *lines):
    """Cases of lines that stand before a move."""
    return [(f"{line}\n{move}", why) for line in lines]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        # homing and probing: of one axis, by all spellings, and what homes perhaps
        *before("G1 Z50", LOST, "G28 Z", "G28 X0 Y0", "G28 XY", "g28 z", "N9 G028 Z ; up", "G28 O"),
        *before("G1 X5", LOST, "G28 X", "G28 R5", "G29", "G29 P1", "M420 S1", "G91 G28 Z0\nG90"),
        *before("G1 X5 Y5 Z5", PERHAPS, "G30", "G28.1", "G28.3 X5", "G30.1"),
        ("G28 Z (and X)\nG1 Z5", "'(and X)' is code for some firmwares"),
        # modes that are restored, by whom and from where is not known
        ("G91\nRESTORE_GCODE_STATE NAME=other\nG1 Y5", PERHAPS),
        ("SAVE_GCODE_STATE NAME=a\nPARK\nRESTORE_GCODE_STATE NAME=a\nG1 Y5", PERHAPS),
        ("SAVE_GCODE_STATE NAME=a\nRESTORE_GCODE_STATE NAME=a MOVE=1\nG1 Y5", LOST),
        *before("G1 Y5", PERHAPS, "M120", "M121", "M72", "RESUME", "CANCEL_PRINT"),
        # what X, Y and Z mean
        *before("G1 Y5", CHANGED, "SET_GCODE_OFFSET Z=1", "set_gcode_offset Z_ADJUST=.1 MOVE=1"),
        *before("G1 Y5", CHANGED, "SET_KINEMATIC_POSITION Z=0", "SKEW_PROFILE LOAD=a", "SET_SKEW XY=1"),
        *before("G1 Y5", CHANGED, "M852 I.1", "M556 S100 X1", "M579 X1.01", "M428", "M666 X1", "M92 X8"),
        *before("G1 Y5", PERHAPS, "M851 Z1", "M501", "M425 F1", "M605 S1", "FORCE_MOVE STEPPER=x"),
        *before("G1 Y5", "is not read", "G53", "G59.1", "G68 R9", "G51 X2", "G52 X3", "G90.1", "G92.1"),
        # macros, tools, lines run elsewhere, again or perhaps
        *before("G1 Y5", PERHAPS, "PARK", "_clean A=1", "T1", "T0", "M6", "M600", "M701", "M1234", "XY5"),
        *before("G1 Y5", "or lines again", 'M98 P"a.g"', "M99", "M808 L5", "M32 !a#", "SDCARD_LOOP_BEGIN"),
        *before("G1 Y5", "not known here; write", "if x = 1", "while true", "  else"),
        *before("G1 Y5", "is not read", "O100 CALL", "#1=5", "FOO=1", "@pause", "$H", "%G1 X5", "G12"),
        # lines that firmwares read differently
        *before("G1 Y5", SEVERAL, "G1 X5 G91", "G91 X5", "X5 M104 S1", "G1 X5 G4 P1", "M104 S1 G1 X5"),
        *((line, "take for an exponent") for line in ("G1 X1E1", "G1X10Y5E3", "G1 X1.e-1")),
        *((line, "is code for some firmwares") for line in ("G1 X5 (to Y7)", "G1 X5 (a ; b) Y7", "(box z) G28")),
        *((line, "does not belong") for line in ("G1 H2 X5", "G1 R1 X5", "G1 X5 P1", "G1 X5 T1")),
        *((line, "is not read") for line in ("G1 X[5]", "G1 X{var.a}", "N10 G1 X5*71", 'M118 S"a" G91', "G1 X5\u017f")),
    ],
)
def test_what_a_move_depends_on_is_known_or_the_move_is_refused(tmp_path, text, why):
    assert why in written(tmp_path, text)


@pytest.mark.parametrize(
    ("dialect", "text", "last"),
    [
        ("klipper", "SAVE_GCODE_STATE NAME=a\nG91\nG1 X5\nRESTORE_GCODE_STATE NAME=a\nG1 Y5", "G1 X115 Y25 Z40"),
        (None, "SAVE_GCODE_STATE\nG91\nRESTORE_GCODE_STATE MOVE=0\nG1 Y5", "G1 X110 Y25 Z40"),
        ("rrf", "M120\nG91\nG20\nM121\nG1 Y5", "G1 X110 Y25 Z40"),
        ("rrf", "G91 G1 X5 F900 M8", "G91 G1 X5 Y0 Z0 F900 M8"),  # run in this order
        ("rrf", "G1 X5 (not Y7)", "G1 X15 Y120 Z40 (not Y7)"),
        ("cnc", "G0 X5 G91", "G0 X5.0 Y0.0 Z0.0 G91"),  # run at once
        ("cnc", "T1\nG30\nG0 X1 Y2 Z3", "G0 X11.0 Y22.0 Z33.0"),
        ("marlin", "M600\nM121\nG1 Y5", "G1 X110 Y25 Z40"),
        (None, "G28 W\nG1 Z5", "G1 X10 Y20 Z35"),
        (None, "G28\nG1 Z5", "G1 X10 Y20 Z35"),
        (None, "PARK", "PARK"),  # no move depends on it
        (None, "G1 X5 ; (a\nG1 Y5", "G1 X15 Y25 Z40"),
    ],
)
def test_what_firmwares_restore_and_run_is_read_by_their_rules(tmp_path, dialect, text, last):
    lines = written(tmp_path, text, dialect)
    assert isinstance(lines, list), lines
    assert lines[-1] == last


@pytest.mark.parametrize(
    ("dialect", "text", "why"),
    [
        ("klipper", "G91 G1 X5", "klipper runs only the first command of a line"),
        ("marlin", "X5", "marlin may not run lines without a command"),
        ("klipper", "G01 X5", "'G01 ' is no command of klipper"),
        ("klipper", "G1.0 X5", "is no command of klipper"),
        ("rrf", "G 1 X5", "'G 1 ' is no command of rrf"),
        ("rrf", "M104 S2 M117 G91", SEVERAL),
        ("klipper", "G20", "klipper does not know inches"),
        ("rrf", "G1 X5 S1", "'S' does not belong"),
        ("rrf", "M121\nG1 X5", PERHAPS),
        ("klipper", "M600\nG1 X5", PERHAPS),
        ("marlin", "G61\nG1 X5", LOST),
        ("cnc", "M6\nG0 X5", PERHAPS),
        ("cnc", "X5 G4 P1", SEVERAL),
    ],
)
def test_a_dialect_refuses_what_its_firmware_would_not_do(tmp_path, dialect, text, why):
    assert why in written(tmp_path, text, dialect)


def test_the_dialect_is_found_in_the_file(tmp_path):
    restored = "SAVE_GCODE_STATE\nG91\nRESTORE_GCODE_STATE\nG1 Y5"
    pushed = "M120\nG91\nM121\nG1 Y5"
    assert written(tmp_path, restored)[-1] == "G1 X110 Y25 Z40"
    assert PERHAPS in written(tmp_path, restored, "rrf")
    assert written(tmp_path, pushed + "\n; gcode_flavor = reprapfirmware")[-2] == "G1 X110 Y25 Z40"
    assert PERHAPS in written(tmp_path, pushed + "\n; gcode_flavor = klipper")
    assert PERHAPS in written(tmp_path, "M600\nG1 Y5\n; gcode_flavor = marlin")  # many run it with Klipper
    assert written(tmp_path, "G80\nG0 X5", name="any.nc")[-1] == "G0 X15.0 Y120.0 Z40.0"
    assert LOST in written(tmp_path, "G80\nG1 X5")  # levels the bed of some printers
    with pytest.raises(calib.InputError, match="--dialect grbl: must be one of cnc, klipper, marlin, rrf"):
        written(tmp_path, "", "grbl")


def test_a_word_that_the_user_calls_harmless_is(tmp_path, calibrated):
    assert written(tmp_path, "photo\nG1 Y5", harmless=["Photo"])[-1] == "G1 X110 Y25 Z40"
    assert CHANGED in written(tmp_path, "M206 X1\nG1 Y5", harmless=["M206"])
    text = "PHOTO\nG90\nG21\nG1 X1 Y2 Z3\nPHOTO\nG1 X2\n"
    done = run(tmp_path, calibrated, text)
    assert (done.exit_code, "PHOTO (line 5) may have moved" in done.output) == (2, True)
    done = run(tmp_path, calibrated, text, "--harmless", "PHOTO", "--dialect", "klipper")
    assert done.exit_code == 0, done.output


def test_a_macro_before_the_first_move_leaves_modes_to_be_set(tmp_path):
    for text, why in (
        ("START\nG1 X1 Y2 Z3\n", "START (line 1) may have changed modes; write G90 or G91, and G20 or G21, after it"),
        ("START\nG90\nG1 X1 Y2 Z3\n", "may have changed modes"),
        ("START\nG90\nG21\nG1 X1\n", "along Y is not known here after START (line 1)"),
        ("START\nG90\nG21\nG1 X1 Y2 Z3\nG28\nG1 X1 Y2 Z3\n", PERHAPS),  # homing may take back its zero
    ):
        (tmp_path / "a.gcode").write_text(text)
        with pytest.raises(calib.DataError, match=re.escape(why)):
            read_gcode(tmp_path / "a.gcode", (0.0, 0.0, 0.0))
    (tmp_path / "a.gcode").write_text("START\nG90\nG21\nG1 X1 Y2 Z3\nG1 X5\n")
    assert read_gcode(tmp_path / "a.gcode").moves[1].end == (0.005, 0.002, 0.003)


@pytest.mark.parametrize(
    ("between", "dialect"),
    [("M83\nG1 E-20\nM82", None), ("M82\nG92 E0\nG20", None), ("G92 E0\nG91\nM82\nG90", "klipper")],
)
def test_e_that_counts_from_what_is_not_known_is_not_shared(tmp_path, between, dialect):
    (tmp_path / "a.gcode").write_text(f"G1 X0 Y0 Z0\n{between}\nG1 X1 E17\n")
    program = read_gcode(tmp_path / "a.gcode", dialect=dialect)
    ways = [np.zeros((1, 3)), np.array([[5e-3, 0, 0], [1e-2, 0, 0]])]
    with pytest.raises(calib.DataError, match="the meaning of its E is unknown"):
        program.rewritten(ways)


PIECES = ("(", "(a", '"a', ".1", " ", "X ", "A_", "a=b ", "N1", "G1", "M3 ", "1E1", "T1\n", ";", "*")


@pytest.mark.parametrize("piece", PIECES)
def test_reading_takes_a_time_in_proportion_to_the_length(tmp_path, piece):
    """No piece is gone back over: what takes the square of the length takes minutes here."""
    (tmp_path / "a.gcode").write_text("G1 X0 Y0 Z0\nG1 X" + 200_000 // len(piece) * piece + "\n")
    began = time.process_time()
    with contextlib.suppress(calib.DataError):
        read_gcode(tmp_path / "a.gcode")
    assert time.process_time() - began < 20


def test_ends_of_lines_stay(tmp_path):
    path = tmp_path / "part.nc"
    path.write_bytes(b"%\r\nG21 G90\r\nG1 X1 Y2 Z3\r\n%\r\n")
    assert read_gcode(path).rewritten(None) == path.read_bytes().decode()

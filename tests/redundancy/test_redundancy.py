"""Machines that calibrate themselves by what they feel twice: kinds, terms and origins of `calib.redundancy`.

What is read is made by other code: the six-axis arm written out, formulas of pointing, a play operator of its own.
"""

import ast
import importlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import binom

import calib
from calib import extend, redundancy
from calib.core.instruments.kind import Readings, View
from calib.core.instruments.kinds import KINDS
from calib.core.judging.verdict import judge
from calib.core.results.sections.determination import position_uncertainty_table
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import formats_that_hold
from calib.core.robots.jacobian import linearise
from calib.core.robots.terms.term import Context, Joint
from calib.core.robots.terms.terms import TERMS
from calib.exporting.joint_tables import joint_tables, lost_by_tables
from calib.extend import check_kind, check_term
from calib.planning.assessment_text import text_report, to_dict
from calib.redundancy import named_origins
from calib.redundancy.rotary_axes import FORMATS
from tests.core.instruments.test_kind_coverage import BALL, Chain, six_axis_chain
from tests.kind_checks import brought, kind_error
from tests.project import SHARED
from tests.six_axis_arm import joints, write_six_axis
from tests.urdf_trees import urdf_of
from viz.error_charts import error_charts
from viz.joint_charts import dials
from viz.result_charts import joint_shares
from viz.scene import scene_of_fit

ARM = "urdf: arm.urdf\nname_mot: [j1, j2, j3, j4, j5, j6]\npriors: false\nbase: {frame: l0}\n"
TRUE = {"j3.ry": -0.02, "j4.rx": 0.01, "j5.ry": 0.015, "j3.z": 0.602}
NEAR = {"j3.ry": -0.006, "j4.rx": 0.004, "j5.ry": 0.005, "j3.z": 0.601}
FREE = "  - {origin: j3, components: [ry], sigma: 20 mrad}\n  - {origin: j4, components: [rx], sigma: 20 mrad}\n"
FREE += "  - {origin: j5, components: [ry], sigma: 20 mrad}\n  - {origin: j3, components: [z], sigma: 5 mm}\n"
BALLS = {"near": [0.5, 0.1, 0.3], "far": [0.2, -0.6, 0.5]}
OFF = 0.02 * np.array([[1, -1, 0.5], [-1, 1, 1], [0.5, 1, -1]])  # of the taxels' described places [m]
TAXELS = {"palm": [0.5, 0.0, 0.3], "wrist": [0.6, 0.08, 0.5], "elbow": [0.45, -0.08, 0.6]}
SENSOR = np.array([0.03, -0.02, 0.08, 0.1, 2.0, -0.5])
SIGMA, ARCSEC = 2e-5, np.radians(1 / 3600)
MOUNT = urdf_of(
    ("azimuth", "continuous", "ground", "fork", '<axis xyz="0 0 -1"/>'),
    ("altitude", "continuous", "fork", "cradle", '<axis xyz="0 -1 0"/>'),
    ("collimation", "fixed", "cradle", "tube"),
)
MOUNT_YAML = """\
urdf: mount.urdf
name_mot: [azimuth, altitude]
base: {frame: ground}
targets: {tube: {frame: tube}}
instruments: {star: {kind: pointing, target: tube, sigma: 5 arcsec}}
parametrisation: altaz
joint_terms: [{joint: altitude, term: tube_flexure, sigma: 10 deg}]
"""
STARS = dict(
    zip(("IA", "IE", "CA", "NPAE", "AN", "AW", "TF"), (90.0, -40.0, 35.0, -50.0, 25.0, -15.0, 60.0), strict=True)
)
PEGS = np.array([0.45, -0.3, 0.35]), Rotation.from_rotvec([0.02, -0.03, 0.1]), 0.025


def load(folder, name, text, urdf=None):
    if urdf is not None:
        (folder / name.replace(".yaml", ".urdf")).write_text(urdf)
        (folder / name).write_text(text)
        return calib.load(folder / name)
    return calib.load(write_six_axis(folder, text))


def sighting(folder):
    """The arm with a sensor on its hand, and what it sees of two balls, one of them on its own second link."""
    words = f"near: {{frame: l0, xyz: {BALLS['near']}, position: unknown}}"
    words += f", far: {{frame: l1, xyz: {BALLS['far']}, position: unknown}}"
    yaml = f"{ARM}targets: {{eye: {{frame: l6, position: unknown, orientation: unknown}}}}\ninstruments:\n"
    yaml += f"  eye: {{kind: sighting, sigma: 0.02 mm, points: {{{words}}}}}\nparametrisation:\n{FREE}"
    robot = load(folder, "arm.yaml", yaml)
    places = {f"eye.{part}": value for part, value in zip(("x", "y", "z", "rx", "ry", "rz"), SENSOR, strict=True)}
    for name, at in BALLS.items():
        places |= {f"{name}.{axis}": value + 0.004 for axis, value in zip("xyz", at, strict=True)}
    return robot, TRUE | places


def seen(true, q, number):
    """Where the ball of each reading is in the sensor's axes: 4 x 4 matrices."""
    hand = six_axis_chain(q, true)
    eye = np.block([[Rotation.from_rotvec(SENSOR[3:]).as_matrix(), SENSOR[:3, None]], [np.zeros(3), 1.0]])
    first = np.tile(np.eye(4), (len(q), 1, 1))  # pose of l1
    first[:, :3, :3], first[:, 2, 3] = Rotation.from_rotvec(q[:, [0]] * [0, 0, 1.0]).as_matrix(), 0.4
    balls = np.array([[true[f"{name}.{axis}"] for axis in "xyz"] + [1.0] for name in BALLS])[number]
    world = np.where((number == 1)[:, None], np.einsum("nij,nj->ni", first, balls), balls)
    return np.einsum("nij,nj->ni", np.linalg.inv(hand @ eye), world)[:, :3]


def sighted(folder):
    robot, true = sighting(folder)
    q, number = joints(60, 5), np.arange(60) % 2
    values = seen(true, q, number)

    def drawn(rng):
        noisy = values + SIGMA * rng.standard_normal(values.shape)
        readings = Readings(np.arange(60), number, noisy, None, number[:, None].astype(float))
        return calib.as_measurements(robot, q, {"eye": readings})

    return robot, true, drawn


class OwnLink:
    """The arm as its own link l1 sees it, as `kind_checks.brought` wants it."""

    def positions(self, q):
        onto, back = six_axis_chain(np.asarray(q), NEAR), Rotation.from_rotvec(-q[:, [0]] * [0, 0, 1.0])
        return back.apply(onto[:, :3, :3] @ BALL + onto[:, :3, 3] - [0, 0, 0.4])[:, None]


def self_touched(folder):
    """A finger on the hand that touches taxels of its own first link, whose places are off by centimetres."""

    def described(off):
        yaml = f"{ARM}targets: {{finger: {{frame: l6, xyz: {BALL.tolist()}}}}}\ninstruments:\n"
        yaml += "  skin: {kind: touch, target: finger, sigma: 0.02 mm, places: {"
        yaml += ", ".join(
            f"{name}: {{frame: l1, xyz: {(np.array(at) + error).tolist()}, position: unknown, sigma: 20 mm}}"
            for (name, at), error in zip(TAXELS.items(), off, strict=True)
        )
        return load(folder, "arm.yaml", f"{yaml}}}}}\nparametrisation:\n{FREE}")

    places = {name: dict(zip("xyz", at, strict=True)) for name, at in TAXELS.items()}
    true = NEAR | {f"{name}.{axis}": value for name, at in places.items() for axis, value in at.items()}

    def drawn(rng):
        robot = described(0.02 * rng.standard_normal((3, 3)))  # each time other places, as their sigma says
        words = np.array(list(TAXELS))[rng.integers(0, 3, 90)]
        points = np.array([TAXELS[word] for word in words]) + SIGMA * rng.standard_normal((90, 3))
        q, ok = brought(OwnLink(), rng.uniform(-1.5, 1.5, (90, 6)), points)
        kept = np.flatnonzero(ok)[:50]
        assert set(words[kept]) == set(TAXELS)  # all are in reach
        return calib.as_measurements(robot, q[kept], {"skin": [str(word) for word in words[kept]]})

    return described(OFF), true, drawn


def true_direction(true, azimuth, altitude):
    """The formula of pointing: encoders minus truth, solved for the truth; all in radians."""
    A, E = azimuth.copy(), altitude.copy()
    for _ in range(30):
        dA = -true["IA"] - true["CA"] / np.cos(E) - (true["NPAE"] + true["AN"] * np.sin(A)) * np.tan(E)
        dA -= true["AW"] * np.cos(A) * np.tan(E)
        dE = true["IE"] - true["AN"] * np.cos(A) + true["AW"] * np.sin(A) - true["TF"] * np.cos(E)
        A, E = azimuth - dA, altitude - dE
    return np.column_stack([A, E])


def pointed(folder):
    robot, true = load(folder, "mount.yaml", MOUNT_YAML, MOUNT), {k: ARCSEC * v for k, v in STARS.items()}
    place = np.random.default_rng(3)
    q = np.column_stack([place.uniform(0, 2 * np.pi, 80), place.uniform(0.35, 1.2, 80)])
    values = true_direction(true, *q.T)

    def drawn(rng):
        off = 5 * ARCSEC * rng.standard_normal(values.shape) / np.column_stack([np.cos(values[:, 1]), np.ones(80)])
        return calib.as_measurements(robot, q, {"star": values + off})

    return robot, true, drawn


def pegged(folder, true=NEAR, stated=4):
    """The arm with a pin in holes of a board, of which a few are named; brought there by Newton's method."""
    place, turn, pitch = PEGS
    yaml = f"{ARM}targets: {{pin: {{frame: l6, xyz: {BALL.tolist()}, position: unknown}}}}\ninstruments:\n"
    yaml += "  board: {kind: hole_pattern, target: pin, pitch: 25 mm, holes: [12, 24], sigma: 0.02 mm"
    yaml += ", pattern: {frame: l0, xyz: [440 mm, -310 mm, 340 mm], position: unknown, orientation: unknown"
    yaml += ", sigma_angle: 0.1}}\n"
    robot = load(folder, "arm.yaml", f"{yaml}parametrisation:\n{FREE}")
    pin = dict(zip(("pin.x", "pin.y", "pin.z"), BALL, strict=True))
    at = {f"board_pattern.{part}": value for part, value in zip("xyz", place, strict=True)}
    at |= {f"board_pattern.r{part}": value for part, value in zip("xyz", turn.as_rotvec(), strict=True)}

    def drawn(rng):
        holes = np.column_stack([rng.integers(0, 12, 90), rng.integers(0, 24, 90), np.zeros(90, dtype=int)])
        points = place + turn.apply(pitch * holes) + SIGMA * rng.standard_normal((90, 3))
        q, ok = brought(Chain(true), rng.uniform(-1.5, 1.5, (90, 6)), points)
        kept = np.flatnonzero(ok)[:50]
        words = [f"{i}/{j}" if k < stated else "?" for k, (i, j, _) in enumerate(holes[kept])]
        return calib.as_measurements(robot, q[kept], {"board": words})

    return robot, true | pin | at, drawn


DRIVE = urdf_of(("elbow", "continuous", "ground", "arm", '<axis xyz="0 0 1"/>'))
DRIVE_YAML = """\
urdf: drive.urdf
name_mot: [elbow]
base: {frame: ground}
targets: {tip: {frame: arm, xyz: [0.2, 0, 0]}}
instruments: {encoder: {kind: joint_reading, joint: elbow, zero: unknown, sigma: 0.2 mrad}}
parametrisation:
  - {joint: elbow, term: gain, sigma: 20 mrad}
  - {joint: elbow, term: harmonics, orders: [2], sigma: 20 mrad}
  - {joint: elbow, term: play, travel: 1 deg, sigma: 1}
  - {joint: elbow, term: in_proportion, column: current, sigma: 0.1}
"""
TURNS = {"encoder.zero": 0.6, "elbow.gain": 0.006, "elbow.sin2": 1e-3, "elbow.cos2": -2e-3}
TURNS |= {"elbow.play": -np.radians(1.0), "elbow.per_current": 8e-4}


def driven(folder, n=300):
    """A motor, and a second encoder behind a play of 2 degrees, a ratio, a curve and a shaft that winds up."""
    robot, t = load(folder, "drive.yaml", DRIVE_YAML, DRIVE), 0.05 * np.arange(n)
    q, r = np.sin(0.7 * t) + 0.25 * np.sin(3.1 * t) + 0.05 * np.sin(9 * t), np.radians(1.0)
    current, link = 2 * np.cos(0.3 * t) + np.sin(5 * t), [q[0]]
    for command in q[1:]:
        link.append(min(max(link[-1], command - r), command + r))
    exact = np.array(link) + 0.006 * q + 1e-3 * np.sin(2 * q) - 2e-3 * np.cos(2 * q) + 8e-4 * current + 0.6

    def drawn(rng):
        read = exact + 2e-4 * rng.standard_normal(n)
        return calib.as_measurements(robot, {"elbow [rad]": q, "encoder [rad]": read, "current": current})

    return robot, TURNS, drawn


MACHINE = urdf_of(
    ("x", "prismatic", "bed", "saddle", '<axis xyz="1 0 0"/>'),
    ("y", "prismatic", "saddle", "ram", '<axis xyz="0 1 0"/>'),
    ("z", "prismatic", "ram", "spindle", '<axis xyz="0 0 1"/>'),
    ("a", "revolute", "bed", "cradle", '<origin xyz="0.2 0.3 -0.2"/><axis xyz="1 0 0"/>'),
    ("c", "revolute", "cradle", "table", '<origin xyz="0 0 0.05"/><axis xyz="0 0 1"/>'),
)
MACHINE_YAML = """\
urdf: machine.urdf
name_mot: [x, y, z, a, c]
base: {frame: bed}
targets: {probe: {frame: spindle}}
instruments:
  probe:
    kind: touch
    sigma: 2 um
    places: {ball: {frame: table, xyz: [60 mm, 0, 20 mm], position: unknown}}
parametrisation: rotary_axes
"""
AXES = {"EY0A": 1e-4, "EZ0A": -8e-5, "EB0A": 4e-4, "EC0A": -3e-4, "EX0C": 6e-5, "EY0C": -5e-5, "EA0C": 2e-4}
AXES |= {"EB0C": -4e-4, "ball.x": 0.0604, "ball.y": 0.0011, "ball.z": 0.0197}


def turned(vector):
    return Rotation.from_rotvec(vector)


def machined(folder):
    """A trunnion that turns a ball about a and c; the probe is at its centre, off by the noise."""
    robot, e = load(folder, "machine.yaml", MACHINE_YAML, MACHINE), AXES
    grid = np.radians([(a, c) for a in (-90, -60, -30, 0, 30) for c in range(0, 360, 45)])
    ball = turned(np.outer(grid[:, 1], [0, 0, 1])).apply([e["ball.x"], e["ball.y"], e["ball.z"]])
    ball = turned([e["EA0C"], e["EB0C"], 0]).apply(ball) + np.array([e["EX0C"], e["EY0C"], 0.05])
    ball = turned([0, e["EB0A"], e["EC0A"]]).apply(turned(np.outer(grid[:, 0], [1, 0, 0])).apply(ball))
    ball += [0.2, 0.3 + e["EY0A"], -0.2 + e["EZ0A"]]

    def drawn(rng):
        q = np.hstack([ball + 2e-6 * rng.standard_normal(ball.shape), grid])
        return calib.as_measurements(robot, q, {"probe": ["ball"] * len(q)})

    return robot, AXES, drawn


MOVER = urdf_of(
    ("x", "prismatic", "room", "at_x", '<axis xyz="1 0 0"/>'),
    ("y", "prismatic", "at_x", "at_y", '<axis xyz="0 1 0"/>'),
    ("z", "prismatic", "at_y", "at_z", '<axis xyz="0 0 1"/>'),
).replace('9"', '2"')  # limits of 2 m
ANCHORS = {"a": [0.0, -1.6, -0.12], "b": [1.3, 1.2, -0.15], "c": [-1.4, 0.75, -0.15], "d": [0.02, 0.0, 2.3]}
SPOOL, GROWTH, GEAR = 0.0757, 4e-4, 20 / 255


def spooled(folder):
    """A mover on four cables, two lines each, on spools that grow with every turn: lengths by adding up turns."""
    words = "".join(
        f"  {name}: {{kind: cable, target: mover, gear: {GEAR}, lines: 2, sigma: 0.2 mm, length: unknown,"
        " spool: {value: 75 mm, sigma: 100 mm}, growth: {value: 0.4 mm, sigma: 10 mm},"
        f" anchor: {{frame: room, xyz: {np.round(at, 1).tolist()}, position: unknown}}}}\n"
        for name, at in ANCHORS.items()
    )
    yaml = "urdf: mover.urdf\nname_mot: [x, y, z]\nbase: {frame: room}\ntargets: {mover: {frame: at_z}}\n"
    robot = load(folder, "mover.yaml", f"{yaml}parametrisation: []\ninstruments:\n{words}", MOVER)
    q = np.random.default_rng(4).uniform([-0.6, -0.6, 0.0], [0.6, 0.6, 0.6], (60, 3))
    turns = np.linspace(-6.0, 6.0, 24001)
    radii = SPOOL + GROWTH * (turns[1:] + turns[:-1]) / 2
    lengths = np.concatenate([[0.0], np.cumsum(np.diff(turns) * 2 * np.pi * radii)])
    lengths -= np.interp(0.0, turns, lengths)
    true, exact = {}, {}
    for name, at in ANCHORS.items():
        true |= {f"{name}_anchor.{axis}": value for axis, value in zip("xyz", at, strict=True)}
        true |= {f"{name}.length": float(np.linalg.norm(at)), f"{name}.spool": SPOOL, f"{name}.growth": GROWTH}
        exact[name] = np.linalg.norm(q - at, axis=1) - true[f"{name}.length"]

    def drawn(rng):
        out = {name: 2 * (length + 2e-4 * rng.standard_normal(60)) for name, length in exact.items()}
        read = {name: 2 * np.pi * np.interp(each, lengths, turns)[:, None] / GEAR for name, each in out.items()}
        return calib.as_measurements(robot, q, read)

    return robot, true, drawn


def fit_of(case, folder, seed=1):
    """A calibration of a case."""
    data = case(folder)[2](np.random.default_rng(seed))
    return calib.fit(data.robot, data)


@pytest.mark.quick(0)
@pytest.mark.amount(3, 40)
@pytest.mark.parametrize("case", [sighted, self_touched, pointed, pegged, driven, machined, spooled])
def test_intervals_hold_the_truth(tmp_path, case, amount):
    _, true, drawn = case(tmp_path)
    hits, squares = [], []
    for seed in range(amount):
        data = drawn(np.random.default_rng([9, seed]))
        fit = calib.fit(data.robot, data)
        chosen = [fit.free_names.index(name) for name in true]
        missed = fit.robot.values[fit.unknowns.index][chosen] - list(true.values())
        hits.append(np.abs(missed) <= fit.statistics.half_width[chosen])
        squares.append(fit.chi_square.value / fit.chi_square.freedom)
    parts = np.mean(hits, axis=0)
    assert np.all(parts >= binom.ppf(1e-4 / len(parts), amount, 0.95) / amount)
    assert np.mean(parts) >= 0.95 - 0.4 / np.sqrt(amount)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.5 / np.sqrt(amount))  # 4 standard deviations of 70 freedoms


VIEWS = View(
    Rotation.random(6, random_state=np.random.default_rng(1)).as_matrix(),
    np.random.default_rng(2).uniform(0.1, 0.6, (6, 3)),
)
PAIRS = np.zeros(200, dtype=np.intp)
ENTRIES = {
    "sighting": {"points": {"a": {"frame": "l0"}, "b": {"frame": "l1", "position": "unknown"}}},
    "pointing": {},
    "height": {"plane": {"frame": "l1", "orientation": "unknown", "position": "unknown"}},
    "cable": {"anchor": {"frame": "l0"}, "length": "unknown", "spool": {"value": 0.075, "sigma": 0.001}, "gear": 0.1},
    "hole_pattern": {"pattern": {"frame": "l0"}, "pitch": {"value": "25 mm", "sigma": "1 mm"}, "holes": [30, 30]},
}


def kind(name):
    return KINDS[name].from_section("it", KINDS[name].section.model_validate({"kind": name} | ENTRIES[name]))


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", ENTRIES)
def test_kinds_keep_what_they_promise(name):
    own = kind(name)
    details = np.tile(own.looks()[1][:1], (6, 1))
    turns = Rotation.from_euler("ZY", [[0.3 * k, -0.1 * k] for k in range(6)]).as_matrix()
    level = View(turns.transpose(0, 2, 1), VIEWS.translation)
    view = level if name == "pointing" else VIEWS  # noise across and up is told apart where the mount is level
    check_kind(own, view, details=details)
    unknowns = np.array([p.nominal_si for p in own.unknowns])
    readings = Readings(np.arange(6), PAIRS[:6], own.predict(view, unknowns, details), None, details)
    assert kind_error(own, view, unknowns, readings) < 1e-8


def test_the_nearest_hole_is_taken_where_none_is_stated_and_never_one_beyond_the_pattern():
    board, unknowns = kind("hole_pattern"), np.array([0.025])
    view = View(np.tile(np.eye(3), (3, 1, 1)), np.array([[0.049, 0.076, 0.001], [-0.02, 0.012, 0.0], [0.9, 0.0, 0.0]]))
    _, _, details = board.parse_texts({"it": ["?", "1/2", "?"]}, ["1", "2", "3"])
    off = board.predict(view, unknowns, details)
    assert off == pytest.approx(np.array([[-0.001, 0.001, 0.001], [-0.045, -0.038, 0.0], [0.175, 0.0, 0.0]]))
    with pytest.raises(calib.DataError, match="line 7, column 'it': '30/0' is none of the 30 x 30 holes"):
        board.parse_texts({"it": ["30/0"]}, ["line 7"])


def test_a_reading_that_names_no_place_is_not_lost(tmp_path):
    eye = sighting(tmp_path)[0].instrument("eye")
    assert list(eye.parse_texts({"eye": ["near", "far"]}, ["line 1", "line 2"])[1]) == [0, 1]
    with pytest.raises(calib.DataError, match="line 2, column 'eye': 'eye' has no place ''; valid: far, near"):
        eye.parse_texts({"eye": ["near", ""]}, ["line 1", "line 2"])


@pytest.mark.quick(0)
def test_a_wrong_nearest_hole_does_not_pass(tmp_path):
    verdict = judge(fit_of(partial(pegged, true=TRUE), tmp_path, 0))  # the nominal arm is off by half a pitch
    assert verdict.grade == "FAIL"
    assert any("from the nearest hole of board: state more" in reason.text for reason in verdict.reasons)


def test_a_pitch_that_is_no_length_is_refused():
    entries = {"kind": "hole_pattern"} | ENTRIES["hole_pattern"] | {"pitch": "0 mm"}
    with pytest.raises(ValueError, match="must be positive: a length"):
        KINDS["hole_pattern"].section.model_validate(entries)


def test_play_has_a_memory():
    q = np.radians([0, 5, 4.5, 5, 0, 0.5, 1.0, 6.0])
    joint = Joint("elbow", "angle", ("elbow",))
    section = TERMS["play"].section.model_validate({"joint": "elbow", "term": "play", "travel": ["1 deg", "4 deg"]})
    term = TERMS["play"].from_section(joint, section, None)
    states = term.states_by_order(q)
    assert states["play_elbow_1"] == pytest.approx([0, 1, 0.5, 1, -1, -0.5, 0, 1])
    context = replace(Context.neutral(8, 1), others=dict(states))
    check_term(term, q[:, None], 0, context)
    assert [p.name for p in term.parameters] == ["elbow.play_1", "elbow.play_2"]


def test_a_stated_side_of_the_play_is_taken_and_a_missing_column_is_named(tmp_path):
    robot, _, drawn = driven(tmp_path, 30)
    data = drawn(np.random.default_rng(0))
    columns = {key: np.array(cells) for key, cells in data.to_dict(robot).items() if key != "pose"}
    assert {"play_elbow", "current"} <= columns.keys()  # a table that is written says it
    again = calib.as_measurements(robot, columns | {"play_elbow": np.full(30, 0.25)})
    assert np.all(again.conditions.column("play_elbow") == 0.25)
    del columns["current"]
    with pytest.raises(calib.DataError, match="no column 'current', on which a joint term of 'elbow' depends"):
        calib.as_measurements(robot, columns)


def test_no_table_of_a_joint_holds_its_play_or_what_a_column_winds_up(tmp_path):
    robot, true, _ = driven(tmp_path)
    robot = robot.with_parameters(true)
    (table,) = joint_tables(robot)
    q = table.commands
    own = 0.006 * q + 1e-3 * np.sin(2 * q) - 2e-3 * np.cos(2 * q)
    assert table.actual - q == pytest.approx(own, abs=1e-9)
    assert [Holds.TABLES.keeps(term) for term in robot.terms] == [True, True, False, False]
    play, wound_up = lost_by_tables(robot)
    assert "it depends on the column 'play_elbow': 17.5 mrad to either side remains" in play
    assert "it depends on the column 'current': 0.8 mrad remains" in wound_up


@pytest.mark.quick(0)
def test_what_a_hand_that_turns_about_the_vertical_alone_cannot_tell_is_named(tmp_path):
    urdf = urdf_of(
        ("x", "prismatic", "l0", "l1", '<axis xyz="1 0 0"/>'),
        ("y", "prismatic", "l1", "l2", '<axis xyz="0 1 0"/>'),
        ("z", "prismatic", "l2", "l3", '<axis xyz="0 0 1"/>'),
        ("yaw", "revolute", "l3", "l4", '<axis xyz="0 0 1"/>'),
        ("end", "fixed", "l4", "hand"),
    )
    yaml = "urdf: scara.urdf\nname_mot: [x, y, z, yaw]\nbase: {frame: l0}\npriors: false\n"
    yaml += "targets: {camera: {frame: hand, position: unknown, orientation: unknown}}\ninstruments:\n"
    yaml += "  camera: {kind: sighting, points: {marker: {frame: l0, position: unknown}}}\nparametrisation: []\n"
    robot = load(tmp_path, "scara.yaml", yaml, urdf)
    rng = np.random.default_rng(0)
    q = np.column_stack([rng.uniform(-0.3, 0.3, (40, 3)), rng.uniform(-1, 1, 40)])
    turned = Rotation.from_rotvec(q[:, 3:] * [0, 0, 1.0]).inv().apply(np.array([0.5, 0.1, -0.4]) - q[:, :3])
    true = Rotation.from_euler("x", 180, degrees=True).inv().apply(turned - [-0.456, -0.037, -0.112])
    data = calib.as_measurements(robot, q, {"camera": true + 1e-4 * rng.standard_normal((40, 3))})
    with pytest.raises(calib.NotIdentifiableError, match=r"not separable: camera\.z, marker\.z; hold 1 of them"):
        calib.fit(robot, data)
    held = robot.fix("marker.z")
    fit = calib.fit(held, calib.as_measurements(held, q, {"camera": data.readings["camera"]}))
    found = fit.robot.values_by_name
    assert [found["camera.x"], found["camera.y"]] == pytest.approx([-0.456, -0.037], abs=2e-4)


def test_a_check_of_parameters_that_move_no_position_predicts_no_position_error(tmp_path):
    robot, _, drawn = pointed(tmp_path)
    assessment = calib.check(robot, drawn(np.random.default_rng(0)))
    text, content = text_report(assessment, "stars"), to_dict(assessment)
    assert "No free parameter moves a position" in text
    assert "mm" not in text
    assert (content["accuracy_mm"]["rms"], content["accuracy_mm"]["max"]) == (None, None)
    assert "none of which moves a position" in repr(assessment)


@pytest.mark.skipif(not (SHARED / "telescope_altaz").is_dir(), reason="the stars are not here")
def test_stars_on_both_sides_of_an_equatorial_mount_give_the_published_terms(tmp_path):
    """Hour angle and declination stand for azimuth and altitude; RTS2's check_python_gpoint_gem has the terms.

    Its FO, declinations that change with the cosine of the hour angle, is -AN at the few hour angles of these stars;
    its CH and NP have the other sign than CA and NPAE.
    """
    rows = np.genfromtxt(SHARED / "telescope_altaz" / "gpoint_in_gem.txt")
    lst, read, true = rows[:, 2], rows[:, 3:5], rows[:, 7:9]
    q, stars = (np.radians(np.column_stack([lst - at[:, 0], at[:, 1]])) for at in (read, true))
    yaml = MOUNT_YAML.replace(", sigma: 5 arcsec", "").partition("joint_terms")[0] + "held: [IA, AW]\n"
    robot = load(tmp_path, "mount.yaml", yaml, MOUNT)
    found = calib.fit(robot, calib.as_measurements(robot, q, {"star": stars})).robot.values_by_name
    published = {"IE": -1613.58, "CA": 216.39, "NPAE": -444.38, "AN": -143.16}
    # a standard deviation is 7 to 21 arc seconds
    assert {name: found[name] / ARCSEC for name in published} == pytest.approx(published, abs=5.0)


@pytest.mark.skipif(not (SHARED / "telescope_altaz").is_dir(), reason="the stars are not here")
def test_every_second_star_of_a_real_telescope_tells_of_the_others(tmp_path):
    rows = np.genfromtxt(SHARED / "telescope_altaz" / "altaz.csv", delimiter=",", skip_header=1)
    off, q = rows[:, [5, 4]], rows[:, [7, 6]]
    yaml = MOUNT_YAML.replace(", sigma: 5 arcsec", "").replace("10 deg", "60 arcsec")
    robot = load(tmp_path, "mount.yaml", yaml, MOUNT)
    for used, others in ((slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))):
        read = np.radians(q + off)
        fit = calib.fit(robot, calib.as_measurements(robot, np.radians(q[used]), {"star": read[used]}))
        kind, at = fit.robot.instrument("star"), fit.robot.forward(np.radians(q[others]), "tube")
        view = View(at[:, :3, :3].transpose(0, 2, 1), np.zeros((len(at), 3)))
        readings = Readings(np.arange(len(at)), PAIRS[: len(at)], read[others], None, np.zeros((len(at), 0)))
        missed = np.sqrt(np.mean(np.sum(kind.misses(view, np.zeros(0), readings) ** 2, axis=1))) / ARCSEC
        assert missed <= 13.1


def position(anchors, lengths, noise):
    """Where cables of these lengths (n,) meet, (3,)."""
    return least_squares(lambda p: (np.linalg.norm(p - anchors, axis=1) - lengths) / noise, [0, 0, 0.1]).x


def test_a_machine_whose_joints_have_no_parameters_passes_and_has_no_chart_of_joints(tmp_path):
    fit = fit_of(spooled, tmp_path)
    assert fit.verdict.grade == "PASS"  # a scale of all lengths shows in none of them, spools included
    assert joint_shares(fit) is None


def test_offsets_of_a_mount_are_shown_in_arc_seconds_and_no_positions(tmp_path):
    fit = fit_of(pointed, tmp_path)
    chart = dials(fit)
    words = {str(each["title"]).split()[0]: str(each["title"]).split()[1:] for each in chart.panels}
    assert words.keys() == {"IA", "IE"}
    assert {unit for _, unit in words.values()} == {"arcsec"}
    assert float(words["IE"][0]) == pytest.approx(STARS["IE"], abs=30.0)
    assert position_uncertainty_table(fit) == {}
    for other, over_places in ((fit, False), (fit_of(sighted, tmp_path), True)):  # a mount turns about one place
        charts = [chart.name for chart in error_charts(other, scene_of_fit(other))]
        assert any("planes" in name for name in charts) == over_places


def test_a_gain_of_the_size_that_the_description_expects_is_no_scaled_joint(tmp_path):
    _, _, drawn = driven(tmp_path)
    data = drawn(np.random.default_rng(1))
    read = data.readings["encoder"]
    more = replace(read, values=read.values + 0.015 * data.joints)
    fit = calib.fit(data.robot, replace(data, readings={"encoder": more}))
    assert "joint_scaled" not in fit.verdict.to_dict()["codes"]


@pytest.mark.quick(0)
@pytest.mark.skipif(not (SHARED / "hangprinter_cable").is_dir(), reason="the cables are not here")
def test_every_second_position_of_a_real_cable_robot_tells_of_the_others(tmp_path):
    rows = np.genfromtxt(SHARED / "hangprinter_cable" / "samples.csv", delimiter=",", skip_header=1)
    q, turned, missed = rows[:, :3] / 1e3, np.radians(rows[:, 4:8]), []
    xml, yaml = (Path("docs/howto/cables.md").read_text().split(f'"mover.{name}"\n')[1] for name in ("urdf", "yaml"))
    robot = load(tmp_path, "mover.yaml", yaml.split("```")[0], xml.split("```")[0])
    for used, others in ((slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))):
        names = [instrument.name for instrument in robot.instruments]
        read = {name: turned[used][:, [k]] for k, name in enumerate(names)}
        fit = calib.fit(robot, calib.as_measurements(robot, q[used], read), loss="huber")
        value = fit.robot.values_by_name
        anchors = np.array([[value[f"{name}_anchor.{axis}"] for axis in "xyz"] for name in names])
        noise = np.array([np.sqrt(np.mean(fit.identification.after[name] ** 2)) for name in names])
        phi = turned[others] * 20 / 255
        length, spool, growth = np.array(
            [[value[f"{name}.{key}"] for name in names] for key in ("length", "spool", "growth")]
        )
        lengths = length + (spool + growth * phi / (4 * np.pi)) * phi / [2, 2, 2, 4]
        at = np.array([position(anchors, each, noise) for each in lengths])
        missed += list(np.linalg.norm(at - q[others], axis=1))
    assert np.sqrt(np.mean(np.square(missed))) <= 4.3e-3


@pytest.mark.parametrize("case", [machined, spooled])
def test_a_target_that_no_origin_moves_has_derivatives_of_zero(tmp_path, case):
    robot, _, _ = case(tmp_path)
    linear = linearise(robot, robot.assemble(np.zeros((2, len(robot.joint_names)))))
    assert not linear.jacobian.any()


def test_a_controller_gets_where_each_axis_of_rotation_is(tmp_path):
    robot, true, _ = machined(tmp_path)
    text = FORMATS[0].write(robot.with_parameters(true), ["made"]).content.decode()
    comment, header, a, c = text.splitlines()
    assert (comment, header) == ("# made", "axis,x [mm],y [mm],z [mm],i,j,k")
    assert a == "A,200.00000,300.10000,-200.08000,0.99999988,-0.00030000,-0.00040000"
    first = turned([0, AXES["EB0A"], AXES["EC0A"]])
    point = first.apply([AXES["EX0C"], AXES["EY0C"], 0.05]) + np.array([0.2, 0.3001, -0.20008])
    along = (first * turned([AXES["EA0C"], AXES["EB0C"], 0])).apply([0, 0, 1])
    assert np.array(c.split(",")[1:], dtype=float) == pytest.approx([*(1e3 * point), *along], abs=1e-5)
    arm = calib.load(write_six_axis(tmp_path))
    assert "rotary-axes" not in formats_that_hold(Holds.ORIGINS, arm)
    with pytest.raises(calib.InputError, match="is for a robot with 'parametrisation: rotary_axes'"):
        FORMATS[0].write(arm, [])
    with pytest.raises(calib.DescriptionError, match="the URDF has no joint 'a', 'b' or 'c'"):
        load(tmp_path, "arm.yaml", ARM + "targets: {pin: {frame: l6}}\nparametrisation: rotary_axes\n")


MACHINES = sorted({*Path(redundancy.__file__).parent.glob("*.py")} - {Path(named_origins.__file__)})
"""Files of machines; the names of trades are a part of the public door."""


@pytest.mark.parametrize("path", MACHINES, ids=lambda path: path.stem)
def test_a_machine_needs_no_more_than_the_public_door(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    for node in (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)):
        if node.module.startswith("calib"):
            own = importlib.import_module(node.module)
            for alias in node.names:
                assert getattr(extend, alias.name) is getattr(own, alias.name)

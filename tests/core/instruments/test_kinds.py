"""What every kind of measurement keeps: exact derivatives, alone and through a chain, and what cannot be said of it."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.instruments.kind import Readings, View
from calib.core.rows.observed import predict_readings
from medrue import robot_file
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.core.instruments.test_kind_distance import YAML as WIRES
from tests.core.instruments.test_kind_joint_reading import five_bar as encoder
from tests.core.instruments.test_kind_orientation import TILTED
from tests.core.instruments.test_kind_pixel import INTRINSICS, POINTS
from tests.core.instruments.test_kind_pixel import YAML as CAMERA
from tests.core.instruments.test_kind_pose import YAML as TRACKER
from tests.core.instruments.test_kind_touch import EVERY as TOUCHED
from tests.core.instruments.test_kind_touch import YAML as TOUCHES
from tests.kind_checks import chain_error, kind_error
from tests.project import EXAMPLES, copied
from tests.six_axis_arm import HEAD, free, joints, write_six_axis

LENS = "{fx: 20, fy: 20, cx: 20, cy: 20, k1: 0.1, k2: 0.1, p1: 0.01, p2: 0.01, k3: 0.1}"
EYE = f"kind: pixel, intrinsics: {INTRINSICS}, unknown_intrinsics: {LENS}"
INSTRUMENTS = {
    "tracker": "{kind: pose, target: cell}",
    "turned": "{kind: orientation, target: cell}",
    "level": "{kind: orientation, target: cell, axes: gravity}",
    "gauge": "{kind: distance, target: ball, end: {frame: ROOT, xyz: [0.3, -0.9, 0.1]}, offset: 12 mm}",
    "beam": "{kind: distance, target: ball, end: {frame: ROOT, xyz: [0.9, 1, -0.4], position: unknown},"
    " offset: {value: 12 mm, sigma: 1 mm}}",
    "wire": "{kind: distance, target: ball, end: {frame: ROOT, position: unknown}, offset: unknown}",
    "eye": f"{{{EYE}, target: body, camera: {{frame: ROOT, xyz: [0, 0, 4], rpy: [180 deg, 0, 0]}}, points: {POINTS}}}",
    "own_eye": f"{{{EYE}, target: board, camera: {{frame: TIP, rpy: [0, 0.3, 0]}}, points: {POINTS}}}",
    "encoder": "{kind: joint_reading, joint: JOINT, zero: unknown}",
}
for form, words in TOUCHED.items():
    there = words.replace("l0", "ROOT").replace("left:", f"{form}_left:").replace("right:", f"{form}_right:")
    INSTRUMENTS[f"probe_{form.replace(' ', '_')}"] = f"{{kind: touch, target: ball, {there}}}"
TARGETS = """\
  ball: {frame: TIP, xyz: [50 mm, 20 mm, 100 mm], position: unknown}
  cell: {frame: TIP, orientation: unknown, position: unknown}
  body: {frame: TIP, position: unknown, orientation: unknown}
  board: {frame: ROOT, xyz: [0.3, 0.2, 2.5], position: unknown, orientation: unknown}
"""
WITH_LOOPS = ("tracker", "level", "wire", "eye", "encoder", "probe_planes")
"""Kinds of every sort: what moves a reading goes through the loops in the same way for all."""


def texts(names, root, tip, joint):
    """Targets and instruments of a description, on these links and this joint."""
    instruments = "".join(f"  {name}: {INSTRUMENTS[name]}\n" for name in names)
    result = (TARGETS, f"instruments:\n{instruments}")
    return [text.replace("ROOT", root).replace("TIP", tip).replace("JOINT", joint) for text in result]


def arm(folder):
    targets, instruments = texts(INSTRUMENTS, "l0", "l6", "j3")
    yaml = f"{HEAD}base: {{frame: l0}}\npriors: false\ntargets:\n{targets}{instruments}parametrisation:\n"
    return calib.load(write_six_axis(folder, yaml + free("j2.x", "j2.z", "j5.rx", "j5.ry"))), 0.4 * joints(4)


def five_bar(folder):
    targets, instruments = texts(WITH_LOOPS, "table", "left_tip", "left_elbow")
    edits = ("sigma: 0.02 mm", instruments), ("targets:\n", f"targets:\n{targets}")
    robot = calib.load(copied(folder, EXAMPLES / "five_bar.yaml", *edits))
    return robot, robot.home + np.random.default_rng(5).uniform(-0.3, 0.3, (4, 2))


def medrue(folder):
    frame = calib.load(robot_file()).description.targets["tool"].frame
    targets, instruments = texts(("tracker", "wire", "encoder"), "world", frame, "B1")
    targets = re.sub(r", (position|orientation): unknown", "", targets)  # its parameters have the tool's place
    edits = ("sigma: 0.04 mm", instruments), ("targets:\n", f"targets:\n{targets}")
    robot = calib.load(copied(folder, robot_file(), *edits))
    actual = dict(zip(table1().names, table1().actual, strict=True))
    return robot.with_parameters(actual), np.array(target_workspace().q)[::210]


@pytest.mark.quick(0)
@pytest.mark.parametrize("made", [arm, five_bar, medrue], ids=lambda made: made.__name__)
def test_all_parameters_move_readings_of_every_kind_as_differences_say(tmp_path, made):
    """Beside the readings, not at them: readings are those of a robot that is a little off."""
    robot, q = made(tmp_path)
    other = robot.with_parameters(robot.values + np.random.default_rng(2).normal(0, 1e-4, len(robot.values)))
    readings = {}
    for name, read in predict_readings(other, other.assemble(q)).items():
        seen = np.flatnonzero(np.isfinite(read.values).all(axis=1))[:12]
        assert len(seen) > 1, name
        parts = (read.visits, read.pairs, read.values)
        readings[name] = Readings(*(part[seen] for part in parts), None, read.details[seen])
    assert len(readings) == len(robot.instruments)
    assert chain_error(robot, q, readings) <= 1e-6


@pytest.fixture(scope="module")
def instruments(tmp_path_factory):
    return arm(tmp_path_factory.mktemp("arm"))[0]


@pytest.mark.parametrize("name", [name for name in INSTRUMENTS if name != "encoder"])
def test_a_kind_by_itself_has_exact_derivatives(instruments, name):
    """At readings that are far from what is predicted."""
    instrument, rng = instruments.instrument(name), np.random.default_rng(3)
    pairs, details = (np.tile(part, (10, 1) if part.ndim > 1 else 10)[:30] for part in instrument.looks())
    n = len(pairs)
    places = np.column_stack([rng.uniform(-0.4, 0.4, (n, 2)), rng.uniform(1, 2, n)])  # before a camera
    view = View(Rotation.random(n, rng).as_matrix(), places)
    unknowns = np.array([unknown.nominal_si + 0.1 * unknown.sigma_si for unknown in instrument.unknowns])
    unknowns[~np.isfinite(unknowns)] = 0.02
    values = instrument.with_errors(
        instrument.predict(view, unknowns, details), rng.normal(0, 0.1, (n, instrument.n_rows))
    )
    readings = Readings(np.arange(n), pairs, values, None, details)
    assert kind_error(instrument, view, unknowns, readings) <= 1e-6


DESCRIBED = {
    "distance": WIRES,
    "tilts": TILTED,
    "pixel": CAMERA,
    "pose": TRACKER,
    "touch": TOUCHES + free("j2.x"),
}
SOCKETS, PLATE, SPHERES = (TOUCHED[form] for form in ("sockets", "plate", "spheres"))
MISTAKES = [
    ("encoder", "joint: left_elbow", "joint: left_elbo", "elbow.joint: no moving joint 'left_elbo'; did you mean"),
    ("encoder", "joint: left_elbow", "joint: left_end", "instruments.elbow.joint: no moving joint 'left_end'"),
    ("encoder", ", joint: left_elbow", "", "key 'instruments.elbow.joint' is missing"),
    ("encoder", "zero: unknown", "dimension: length", "joint 'left_elbow' turns; set dimension: angle"),
    ("encoder", "zero: unknown", "sigma_zero: 1 deg", "sigma_zero is for an encoder whose zero is unknown"),
    ("encoder", "zero: unknown", "zero: unkown", "unknown value 'unkown'; did you mean 'unknown'"),
    ("encoder", "zero: unknown", "offset: about 3", "offset: 'about 3' is not a finite number"),
    ("encoder", "elbow: {k", "left_motor: {k", "its column 'left_motor' is that of a joint; rename the instrument"),
    ("distance", "end: {frame: l0, position", "end: {position", "key 'instruments.wire.end.frame' is missing"),
    ("distance", "offset: unknown", "offset: {value: 3 mm}", "wire.offset: give {value: ..., sigma: ...}"),
    ("distance", "offset: unknown", "offset: {value: 3 mm, sgma: 1}", "unknown key 'sgma'; did you mean 'sigma'"),
    ("distance", "offset: unknown", "offset: 3 deg", "unit 'deg' is for an angle"),
    ("distance", "-0.9, 0.1]}", "-0.9, 0.1], sigma: 1 mm}", "sigma is for a place whose position is unknown"),
    ("tilts", "axes: gravity", "axes: gravty", "sensor.axes: unknown value 'gravty'; did you mean 'gravity'"),
    ("tilts", "axes: gravity", "axes: gravity, rotation: rpy", "writes two tilts and no rotations; leave it out"),
    ("tilts", "axes: gravity", "axes: gravity, sigma: [1, 1, 1]", "an inclinometer has two tilts; give one number"),
    ("tilts", "target: cell", "target: cel", "instruments.sensor: no target 'cel'; did you mean 'cell'"),
    ("pixel", "camera: {frame: l0}", "camera: {fram: l0}", "unknown key 'instruments.eye.camera.fram'; did you mean"),
    ("pixel", "camera: {frame: l0}", "camera: {frame: l9}", "no link or joint 'l9'"),
    ("pixel", "{frame: l0}, in", "{frame: l0, pose: known, sigma: 1 mm}, in", "for a camera whose pose is unknown"),
    ("pixel", "fx: 2400, ", "", "key 'instruments.eye.intrinsics.fx' is missing"),
    ("pixel", "fx: 2400", "fx: -2400", "instruments.eye.intrinsics.fx: "),
    ("pixel", "cx: 1000", "cx: .inf", "instruments.eye.intrinsics.cx: "),
    ("pixel", "k1: -0.1", "k1: .nan", "instruments.eye.intrinsics.k1: "),
    ("pixel", "k1: -0.1", "k4: -0.1", "unknown key 'instruments.eye.intrinsics.k4'"),
    ("pixel", f"points: {POINTS}", "points: {}", "eye: needs points (name: [x, y, z]), points_file or board"),
    ("pixel", f"points: {POINTS}", "points_file: no.csv", "no.csv: no such file"),
    ("pixel", f"points: {POINTS}", "points_file: arm.urdf", "no column 'point'; expected point, x, y, z"),
    ("pixel", "eye: {kind", "body: {kind", "two places are called 'body'; rename one"),
    ("pose", "target: cell", "target: cell, rotation: euler", "unknown value 'euler'"),
    ("pose", "target: cell", "target: cell, sigma: [1 mm, 1 mm]", "entr"),
    ("pose", "target: cell", "target: cell, sigma: {range: 1 um}", "'instruments.tracker.sigma.angle' is missing"),
    ("pose", "target: cell", "target: cell, sigma: {range: 1 um, angle: 1 mm}", "unit 'mm' is for a length"),
    ("pose", "target: cell", "target: cell, sigma_angle: none", "is not a finite number"),
    ("touch", "INSTRUMENT", "surface: socket", "probe: give what is touched: either `places` or an `artefact`"),
    ("touch", "INSTRUMENT", f"surface: hole, {SOCKETS}", "probe.surface: unknown value 'hole'"),
    ("touch", "INSTRUMENT", f"{SOCKETS}, {PLATE}", "either `places` or an `artefact`"),
    ("touch", "INSTRUMENT", SOCKETS.replace("left: {", "left: {radius: 3 mm, "), "places.left: radius is for spheres"),
    ("touch", "INSTRUMENT", SOCKETS.replace("left: {", "left: {rpy: [0, 0, 1], "), "left: rpy and orientation are for"),
    ("touch", "INSTRUMENT", SPHERES.replace(", radius: 40 mm", ""), "left: a sphere needs its radius, or 'radius: un"),
    ("touch", "INSTRUMENT", SPHERES.replace("radius: 40", "radius: -40"), "places.left: radius must be positive"),
    ("touch", "INSTRUMENT", f"radius: 3 mm, {SOCKETS}", "radius is for planes and spheres; a socket holds the centre"),
    ("touch", "INSTRUMENT", f"surface: plane, {PLATE}", "an artefact has sockets or spheres; give planes as `places`"),
    ("touch", "INSTRUMENT", PLATE.replace("q: [90 mm", "q: [0 mm"), "the points 'p' and 'q' are at the same place"),
    ("touch", "INSTRUMENT", PLATE.replace("pose: unknown", "sigma: 1 mm"), "for an artefact whose pose is unknown"),
    ("touch", "INSTRUMENT", SOCKETS.replace("l0, position: unknown", "l0, sigma: 1 mm", 1), "sigma is for a"),
]


@pytest.mark.parametrize(("kind", "old", "new", "said"), MISTAKES)
def test_descriptions_that_cannot_be(tmp_path, run_calib, kind, old, new, said):
    robot = encoder(tmp_path).path if kind == "encoder" else write_six_axis(tmp_path, DESCRIBED[kind])
    text = Path(robot).read_text()
    assert old in text
    Path(robot).write_text(text.replace(old, new))
    assert said in run_calib("check", robot).refusal()


QUATERNION = "tracker_qx,tracker_qy,tracker_qz,tracker_qw"
MATRIX = ",".join(f"tracker_r{i}{j}" for i in "123" for j in "123")


@pytest.mark.parametrize(
    ("form", "header", "row", "said"),
    [
        (
            "quaternion",
            QUATERNION,
            "0,0,0,2",
            "reading 1: is not a quaternion of length 1; check the columns tracker_qx",
        ),
        ("quaternion", QUATERNION.removesuffix(",tracker_qw"), "0,0,0", "no column 'tracker_qw'"),
        ("quaternion", f"{QUATERNION} [deg]", "0,0,0,1", "is a pure number"),
        ("rpy", "tracker_roll [mm],tracker_pitch [mm],tracker_yaw [mm]", "1,2,3", "unit 'mm' is for a length"),
        ("rpy", "tracker_roll,tracker_pitch,tracker_yaw", "90,2,3", "not plausible; write the unit"),
        ("rpy", "tracker_rol,tracker_pitch,tracker_yaw", "1,2,3", "'tracker_roll'; did you mean 'tracker_rol'"),
        ("matrix", MATRIX, "1,0,0,0,1,0,0,0,-1", "rotation matrix"),
        ("rpy", "tracker_roll,tracker_pitch,tracker_yaw,tracker_std_x [mm]", "1,2,3,1", "no column 'tracker_std_y'"),
        ("tilts", "sensor_tilt_x [deg],sensor_tilt_y [mm]", "1,2", "column 'sensor_tilt_y': unit 'mm' is for a length"),
    ],
)
def test_files_that_cannot_be(tmp_path, form, header, row, said):
    tracker = TRACKER.replace("target: cell}", f"target: cell, rotation: {form}}}")
    robot = calib.load(write_six_axis(tmp_path, TILTED if form == "tilts" else tracker))
    lengths = "tracker_x [mm],tracker_y [mm],tracker_z [mm]"
    (tmp_path / "data.csv").write_text(f"j1,j2,j3,j4,j5,j6,{lengths},{header}\n1,2,3,1,2,3,100,200,300,{row}\n")
    with pytest.raises(calib.DataError) as caught:
        calib.read_measurements(tmp_path / "data.csv", robot)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)

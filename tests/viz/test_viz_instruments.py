"""What the pages show of instruments that are no point trackers: gaps, poses, several setups, and no points at all."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.data.in_memory import as_poses, measurements
from calib.core.instruments.kind import InstrumentSection, Part, Place, Readings
from calib.core.instruments.kinds import KINDS
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import Relation
from calib.core.rows.observed import predict_readings
from tests.six_axis_arm import FREE, joints, write_six_axis
from tests.viz.viz_examples import assert_saved_alike, undrawn, words_of
from viz.error_charts import error_charts
from viz.inputs import gather
from viz.instrument_shapes import instrument_shapes
from viz.pose_sources import from_fit, measured_set
from viz.poses import PredictingRobot, average_poses
from viz.reading_errors import reading_errors_of_set, smallest_motion
from viz.scene import build_scene, scene_of_fit
from viz.scene_data import scene_data

ARM = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0}
targets: {ball: {frame: l6, xyz: [50 mm, 20 mm, 100 mm]}, second: {frame: l6, xyz: [-60 mm, 0 mm, 80 mm]}}
parametrisation:
"""
POSES = "instruments: {ball: {kind: pose, sigma: 0.05 mm, sigma_angle: 0.2 mrad}}\n"


def arm(folder, more="", text=ARM):
    return calib.load(write_six_axis(folder, text + FREE + more))


def bent(robot, seed=1):
    """The robot as it really is: a tenth of what the description expects off."""
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    return robot.with_parameters(robot.values + 0.1 * sigma * np.random.default_rng(seed).standard_normal(len(sigma)))


def test_a_target_that_was_not_seen_has_no_row(tmp_path):
    robot = arm(tmp_path)
    q = joints(40)
    positions = bent(robot).positions(q) + np.random.default_rng(2).normal(0, 5e-5, (40, 2, 3))
    positions[::4, 1] = np.nan
    fit = calib.fit(robot, calib.as_measurements(robot, q, positions))
    table = from_fit(fit)
    assert (table.labels[:4], table.targets[:4]) == (("0", "1", "1", "2"), ("ball", "ball", "second", "ball"))
    assert len(table) == 70
    np.testing.assert_allclose(table.measured[2], positions[1, 1])
    np.testing.assert_allclose(table.after[2], fit.robot.positions(q[:2])[1, 1], atol=1e-10)
    assert_saved_alike(fit, tmp_path)
    assert undrawn(fit).count("<figure") == 10


def test_repeats_of_a_pose_are_one_row_with_the_mean_of_their_readings(tmp_path):
    robot = arm(tmp_path)
    q = np.repeat(joints(30), 3, axis=0)
    names = [f"P{k // 3}" for k in range(90)]
    positions = bent(robot).positions(q) + np.random.default_rng(2).normal(0, 5e-5, (90, 2, 3))
    positions[4, 0] = np.nan
    fit = calib.fit(robot, calib.as_measurements(robot, q, positions, names))
    table = from_fit(fit)
    assert len(table) == 60
    assert table.readings.tolist() == [3, 3, 2, 3] + 56 * [3]
    assert table.place.tolist() == np.repeat(np.arange(30), 2).tolist()
    np.testing.assert_allclose(table.measured[2], positions[[3, 5], 0].mean(axis=0))
    np.testing.assert_allclose(table.measured[3], positions[3:6, 1].mean(axis=0))
    np.testing.assert_allclose(table.sigma, fit.sigma / np.sqrt(table.readings))
    assert_saved_alike(fit, tmp_path)


@pytest.fixture(scope="module")
def pose_fit(tmp_path_factory):
    robot = arm(tmp_path_factory.mktemp("poses"), POSES)
    data = calib.simulate(bent(robot), joints(60), None, np.random.default_rng(3))
    return calib.fit(robot, data.subset(np.arange(40)), validation=data.subset(np.arange(40, 60)))


def test_poses_are_shown_by_their_positions(pose_fit, tmp_path):
    table = from_fit(pose_fit)
    values = pose_fit.identification.data.readings["ball"].values
    np.testing.assert_allclose(table.measured[:40], values[:, :3])
    np.testing.assert_allclose(table.error("after")[:40], pose_fit.identification.after["ball"][:, :3], atol=1e-15)
    np.testing.assert_allclose(table.sigma, pose_fit.sigma)
    assert_saved_alike(pose_fit, tmp_path)


def test_the_report_has_a_table_figures_and_a_noise_for_each_part(pose_fit):
    html = undrawn(pose_fit)
    shown = words_of(html)
    assert "Position error [mm]; for each axis" in shown
    assert "Orientation error [mrad]; for each axis" in shown
    assert all(f">{axis} mean</th>" in html for axis in ("x", "y", "z", "rx", "ry", "rz"))
    turned = 1e3 * np.linalg.norm(pose_fit.validation.after["ball"][:, 3:], axis=1)
    row = re.findall(r"validation, after 20 ([\d.]+) ([\d.]+)", shown)[1]
    assert [float(number) for number in row] == pytest.approx([turned.mean(), turned.max()], rel=5e-3)  # as printed
    assert re.search(r"noise of one reading of ball, position 0\.0\d+ mm per axis \(stated: 0\.0500 mm", shown)
    assert re.search(r"noise of one reading of ball, orientation 0\.\d+ mrad .*\(stated: 0\.200 mrad", shown)
    assert "Instruments ball (position, orientation of ball)" in shown
    assert html.count("<figure") == 14  # picture, four plots of each part, coverage, causes, joints, dials, parameters
    names = re.findall(r'\bid="([^"]+)"', html)
    assert len(names) == len(set(names))


def test_plots_of_a_part_have_its_unit_and_axes(pose_fit):
    charts = {chart.name: chart for chart in error_charts(pose_fit, scene_of_fit(pose_fit))}
    assert charts["orientation-errors"].title == "Orientation: error before and after"
    assert charts["orientation-errors"].panels[0]["x"]["label"] == "error [mrad]"
    by_joint = charts["orientation-by-joint"].panels
    assert len(by_joint) == 6
    assert by_joint[0]["y"]["label"] == "residual [mrad]"
    assert [layer["label"] for layer in by_joint[0]["layers"] if layer["label"]] == ["rx", "ry", "rz"]


@pytest.mark.quick(0)
def test_without_points_the_predicted_targets_are_shown_and_nothing_as_measured(tmp_path):
    robot = arm(tmp_path, "instruments: {ball: {kind: distance, sigma: 0.05 mm}}\n")
    data = calib.simulate(bent(robot), joints(120), None, np.random.default_rng(4))
    fit = calib.fit(robot, data)
    table = from_fit(fit)
    assert table.targets == ("ball", "second") * 120
    assert np.isnan(table.measured).all()
    assert np.isnan(table.sigma).all()
    np.testing.assert_allclose(table.before, robot.positions(data.joints).reshape(-1, 3))
    np.testing.assert_allclose(table.after, fit.robot.positions(data.joints).reshape(-1, 3))
    scene = scene_of_fit(fit)
    (shown_errors,) = scene.readings
    assert (scene.states, scene.shows_poses, scene.n_rows) == (("before", "after"), False, 120)
    np.testing.assert_array_equal(shown_errors.residuals_after, fit.identification.after["ball"])
    content = scene_data(scene)
    assert (content["summary"], content["certainty"]["noise"]) == ([], None)
    (part,) = content["parts"]
    assert (part["name"], part["unit"], part["position"]) == ("distance", "mm", False)
    assert part["range"]["after"][1] == pytest.approx(1e3 * np.quantile(np.abs(fit.identification.after["ball"]), 0.95))
    html = undrawn(fit)
    shown = words_of(html)
    assert "Distance error (RMS) before and after calibration, 120 poses (identification)" in shown
    assert "Where it was measured" not in shown
    assert [chart.name for chart in error_charts(fit, scene)] == [
        f"distance-{name}" for name in ("errors", "order", "planes", "by-joint")
    ]
    assert_saved_alike(fit, tmp_path)
    off = fit.identification.tables()["ball"]["distance"]
    (other,) = scene.others
    assert (other["of"], other["part"], other["unit"]) == ("ball", "distance", "mm")
    (errors,) = other["sets"]
    assert errors["group"] == "identification"
    for state in ("before", "after"):
        np.testing.assert_allclose(errors[state], [off[state]["rms"], off[state]["max"]], rtol=1e-9)
    assert content["others"][0]["sets"] == scene.others[0]["sets"]
    alone = gather(robot, None, data).scene
    assert alone.states == ("before",)
    assert (len(alone.poses), alone.n_rows) == (240, 120)


def test_readings_of_several_instruments_have_one_headline_and_the_report_draws_wires_and_points(tmp_path):
    ends = {"wire": [2, 1, 0], "other": [2, -1, 0], "third": [1.5, 0, 1.5]}
    rope = "{}: {{kind: distance, target: ball, sigma: 0.05 mm, end: {{frame: l0, xyz: {}}}}}"
    wires = [rope.format(name, xyz) for name, xyz in ends.items()]
    robot = arm(tmp_path, f"instruments: {{{', '.join(wires)}}}\n")
    fit = calib.fit(robot, calib.simulate(bent(robot), joints(60), None, np.random.default_rng(4)))
    after = 1e3 * np.abs(np.concatenate([fit.identification.after[name] for name in ends]))
    headline, *each = scene_data(assert_saved_alike(fit, tmp_path))["others"]
    assert (headline["of"], headline["part"], headline["several"]) == ("3 instruments", "distance", True)
    assert headline["sets"][0]["after"] == pytest.approx([np.sqrt(np.mean(after**2)), after.max()], rel=1e-9)
    assert [item["of"] for item in each] == list(ends)


def test_poses_at_which_nothing_was_read_are_not_counted_and_have_no_error(tmp_path):
    robot = arm(tmp_path)
    q = joints(80)
    positions = bent(robot).positions(q) + np.random.default_rng(2).normal(0, 5e-5, (80, 2, 3))
    positions[::2] = np.nan
    fit = calib.fit(robot, calib.as_measurements(robot, q, positions), validation=0.25)
    assert (fit.identification.data.n_poses, fit.validation.data.n_poses) == (30, 10)
    assert {int(name) % 2 for name in fit.identification.data.names} == {1}
    assert "at poses like the 30 measured" in fit.verdict.claim.region


@pytest.mark.quick(0)
def test_a_tracker_can_validate_what_distances_identified(tmp_path):
    wire, ball = "wire: {kind: distance, target: ball, sigma: 0.05 mm}", "ball: {kind: position, sigma: 0.05 mm}"
    robot = arm(tmp_path, f"instruments: {{{wire}, {ball}}}\n")
    data = calib.simulate(bent(robot), joints(140), None, np.random.default_rng(4))
    parts = ((data[:120], "wire"), (data[120:], "ball"))
    used, other = (dataclasses.replace(part, readings={name: part.readings[name]}) for part, name in parts)
    fit = calib.fit(robot, used, validation=other)
    table = from_fit(fit)
    assert (len(table), int(np.isfinite(table.error("after")).all(axis=1).sum())) == (240 + 20, 20)
    np.testing.assert_allclose(table.error("after")[240:], fit.validation.after["ball"], atol=1e-12)
    scene = scene_of_fit(fit)
    assert scene.states == ("before", "after")
    rows = {row["group"]: row["after"] for row in scene_data(scene)["summary"]}
    assert rows["identification"] is None
    squares = np.sum(fit.validation.after["ball"] ** 2, axis=1)
    assert rows["validation"]["rms"] == pytest.approx(1e3 * np.sqrt(np.mean(squares)), rel=1e-9)
    shown = words_of(undrawn(fit))
    assert "Position error (RMS) before and after calibration, 20 poses (validation)" in shown
    assert "Distance error [mm] poses" in shown
    assert "noise of one reading 0.0" in shown
    assert_saved_alike(fit, tmp_path)


def test_points_of_a_later_setup_are_shown_in_the_frame_of_the_first(tmp_path):
    text = ARM.replace("base: {frame: l0}", "base: {frame: l0, pose: unknown}")
    robot = arm(tmp_path, "setups: {first: [], second: [base]}\n", text)
    moved = bent(robot).with_parameters({"base@second.x": 0.4, "base@second.rz": 0.5})
    q = np.vstack([joints(60), joints(60)])
    looks = Readings(np.arange(120), np.repeat([0, 1], 60), np.zeros((120, 0)), None, np.zeros((120, 0)))
    read = predict_readings(moved, moved.assemble(q), {"ball": looks, "second": looks})
    fit = calib.fit(robot, measurements(as_poses(robot, q), read))
    table = from_fit(fit)
    assert set(table.targets) == {"ball", "second", "ball@second", "second@second"}
    first, later = (np.array([target == name for target in table.targets]) for name in ("ball", "ball@second"))
    np.testing.assert_allclose(table.measured[later], table.measured[first], atol=1e-6)
    np.testing.assert_allclose(table.after[later], table.after[first], atol=1e-6)
    assert_saved_alike(fit, tmp_path)
    shown = gather(robot, tmp_path / "out")
    np.testing.assert_allclose(shown.ghost.values, fit.placed.values, atol=1e-6)


MEASURED_WITH = """\
instruments:
  probe: {kind: touch, target: ball, artefact: {frame: l0, xyz: [0.5, 0.2, 0.1], rpy: [0, 0, 90 deg], pose: unknown,
          points: {a: [0, 0, 0], b: [200 mm, 0, 0]}}}
  table: {kind: touch, target: ball, surface: plane, radius: 3 mm, places: {top: {frame: l0, xyz: [0, 0, 40 mm]}}}
  wire: {kind: distance, target: second, end: {frame: l0, xyz: [1, 0, 0]}}
  eye: {kind: pixel, target: second, camera: {frame: l6, xyz: [0, 0, 0.1]}, image: [1000, 800],
        intrinsics: {fx: 800, fy: 800, cx: 500, cy: 400}, points: {p: [0, 0, 0], q: [10 mm, 0, 0]}}
"""


def test_what_measures_and_what_it_looks_at_is_drawn_where_the_robot_has_it(tmp_path):
    robot = arm(tmp_path, MEASURED_WITH)
    scene = build_scene(robot, None, from_poses(robot, joints(3)))
    q = scene.poses.joints[scene.shown]
    number = {name: body for body, name in enumerate(scene.bodies.names)}
    drawn = {shape.name: shape for shape in scene.shapes if shape.body is not None}

    def place(name, pose):
        shape = drawn[name]
        return (scene.bodies.poses(scene.solid, pose)[number[shape.body]] @ shape.T_body_shape)[:3, 3]

    for pose in range(len(q)):
        np.testing.assert_allclose(place("probe/a", pose), [0.5, 0.2, 0.1], atol=1e-12)
        np.testing.assert_allclose(place("probe/b", pose), [0.5, 0.4, 0.1], atol=1e-12)
        np.testing.assert_allclose(place("table/top", pose), [0, 0, 0.04], atol=1e-12)
        np.testing.assert_allclose(place("wire/wire_end", pose), [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(place("ball/ball", pose), robot.positions(q)[pose, 0], atol=1e-9)
        np.testing.assert_allclose(place("second/p", pose), robot.positions(q)[pose, 1], atol=1e-9)
    assert_wires_lead_from(scene, robot, [1, 0, 0])
    edge = drawn["eye/edge0"].T_body_shape
    along = edge[:3, 2] / edge[2, 2]  # in the camera's frame, to the first corner of the image
    np.testing.assert_allclose(800 * along[:2] + [500, 400], [0, 0], atol=1e-9)


def assert_wires_lead_from(scene, robot, start):
    """A wire leads from there to the second target at every pose."""
    ropes = [shape for shape in scene.decorations if shape.name.startswith("wire/")]
    for rope, end in zip(ropes, robot.positions(scene.poses.joints[scene.shown])[:, 1], strict=True):
        np.testing.assert_allclose(rope.T_body_shape[:3, 3], np.mean([end, start], axis=0), atol=1e-9)
        assert rope.size[1] == pytest.approx(np.linalg.norm(end - start))


class RopeSection(InstrumentSection):
    target: str


@dataclasses.dataclass(frozen=True)
class Rope(Relation):
    """A distance of another package: the square of how far the target is from a hub."""

    section = RopeSection
    parts = (Part("square", ("square",), "length", is_distance=True),)

    @classmethod
    def from_section(cls, name, section):
        hub = Place(f"{name}_hub", "l0", (1.0, 0.5, 0.0))
        return cls(name, section.target, (hub,), noise=Noise((PartNoise(1e-4),)))

    def predict(self, view, unknowns, details):
        return np.sum(view.translation**2, axis=1, keepdims=True)


def test_a_distance_of_another_package_has_a_wire_too(tmp_path, monkeypatch):
    monkeypatch.setattr(KINDS, "_given", {"rope": Rope})
    robot = arm(tmp_path, "instruments: {wire: {kind: rope, target: second}}\n")
    scene = build_scene(robot, None, from_poses(robot, joints(3)))
    assert {"wire/wire_hub", "second/ball"} <= {shape.name for shape in scene.shapes}
    assert_wires_lead_from(scene, robot, [1, 0.5, 0])


def test_an_error_is_drawn_as_the_smallest_motion_that_explains_the_reading(tmp_path):
    more = "  turned: {kind: pose, target: ball, sigma: 0.05 mm, sigma_angle: 0.2 mrad}\n"
    words = MEASURED_WITH.replace("pose: unknown", "pose: known").replace("image: [1000, 800],", "")
    nominal = arm(tmp_path, words.replace("{frame: l6, xyz: [0, 0, 0.1]}", "{frame: l0, xyz: [0, 0, -3]}") + more)
    actual, q = bent(nominal), joints(3)
    made = actual.assemble(q)
    touches = {"probe": np.array([1.0, 0.0, 1.0])[:, None], "table": np.zeros((3, 1))}
    details = touches | {"wire": np.zeros((3, 0)), "turned": np.zeros((3, 0)), "eye": np.ones((3, 1))}
    none = np.zeros(3, dtype=np.intp)
    looks = {name: Readings(np.arange(3), none, np.zeros((3, 0)), None, which) for name, which in details.items()}
    read = predict_readings(actual, made, looks)
    for name, k in (("probe", 3), ("table", 1)):
        read[name] = dataclasses.replace(looks[name], values=np.zeros((3, k)))
    data, known = measurements(as_poses(nominal, q), read), PredictingRobot(actual, lambda *_: None)
    layers = reading_errors_of_set(measured_set(data, nominal, known, {}), actual)
    by_name = {layer.part.name: layer for layer in layers}
    ball, second = nominal.positions(q).transpose(1, 0, 2)
    sockets = np.array([[0.5, 0.4, 0.1], [0.5, 0.2, 0.1], [0.5, 0.4, 0.1]])
    np.testing.assert_allclose(by_name["contact"].anchors, sockets, atol=1e-12)
    np.testing.assert_allclose(by_name["contact"].before, ball - sockets, atol=1e-9)
    assert by_name["contact"].targets == ("probe b", "probe a", "probe b")
    above = np.zeros((3, 3))
    above[:, 2] = ball[:, 2] - 0.04 - 0.003
    np.testing.assert_allclose(by_name["gap"].before, above, atol=1e-9)
    along = second - [1, 0, 0]
    longer = np.linalg.norm(along, axis=1, keepdims=True)
    off = longer - np.linalg.norm(actual.positions(q)[:, 1] - [1, 0, 0], axis=1, keepdims=True)
    np.testing.assert_allclose(by_name["distance"].before, off * along / longer, atol=1e-9)
    np.testing.assert_allclose(by_name["distance"].after, 0, atol=1e-12)
    body, moved = nominal.forward(q, "l6"), by_name["pixel"].before
    ray = body[:, :3] @ [-0.05, 0, 0.08, 1] + [0, 0, 3]  # to q, 10 mm along x of the target
    np.testing.assert_allclose(np.sum(moved * ray, axis=1), 0, atol=1e-9)  # square to the line of sight
    back = ray - moved
    missed = 800 * back[:, :2] / back[:, 2:] + [500, 400] - read["eye"].values  # by the pinhole
    assert np.abs(missed).max() < 0.01 * np.abs(by_name["pixel"].residuals_before).max()
    turned, measured = by_name["orientation"].before, Rotation.from_rotvec(read["turned"].values[:, 3:].copy())
    predicted = Rotation.from_matrix(body[:, :3, :3])
    np.testing.assert_allclose((predicted * measured.inv()).as_rotvec(), turned, atol=1e-4)
    assert [item.turns for item in by_name.values()] == [False] * 4 + [True]


def test_what_has_no_derivative_has_no_arrow():
    by = np.zeros((2, 1, 6))
    by[:, 0, 0] = 2.0
    by[1, 0, 1] = np.nan
    motion, turns = smallest_motion(by, np.array([[4.0], [4.0]]))
    assert not turns
    np.testing.assert_array_equal(motion, [[2, 0, 0], [np.nan] * 3])


def from_poses(robot, q):
    data = calib.as_measurements(robot, q, {"wire": np.ones((len(q), 1))})
    return average_poses(measured_set(data, robot, None, {}).table())


def test_a_board_is_drawn_with_a_patch_around_each_of_its_points(tmp_path):
    board = "{kind: chessboard, columns: 4, rows: 3, square: 20 mm}"
    camera = "camera: {frame: l0}, intrinsics: {fx: 800, fy: 800, cx: 500, cy: 400}"
    robot = arm(tmp_path, f"instruments: {{eye: {{kind: pixel, target: ball, {camera}, board: {board}}}}}\n")
    drawn = {shape.name: shape for shape in instrument_shapes(robot)}
    corners = drawn["ball/points"].vertices.reshape(-1, 4, 3)
    points = np.array([(0.02 * i, 0.02 * j) for j in (1, 2) for i in (1, 2, 3)])
    np.testing.assert_allclose(corners.mean(axis=1)[:, :2], points, atol=1e-12)
    np.testing.assert_allclose(drawn["ball/board"].size[:2], [0.08, 0.06])
    np.testing.assert_allclose(drawn["ball/board"].T_body_shape[:2, 3], [0.04, 0.03])

"""Parameters: what a value does to an origin, its derivative against differences, and the protocol of plugins."""

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import calib
import calib.core.robots.parametrisation
from calib.core.base.errors import DescriptionError, ParameterError
from calib.core.base.parameter import Parameter, index_of
from calib.core.robots.jacobian import linearise
from calib.core.robots.parameters import Origin, twist_of_edit
from tests.small_robots import ARM_YAML, write_arm, write_parallelogram

EVERYTHING = ARM_YAML.replace(
    "{frame: ground}", "{frame: ground, xyz: [1, -2, 0.5], rpy: [0.3, -0.7, 2], pose: unknown}"
)
EVERYTHING = EVERYTHING.replace("30 mm]}", "30 mm], position: unknown}")
STEP = 1e-5
DIFFERENCE_ERROR = 1e-9
"""Central differences with step 1e-5: truncation of order 1e-10, rounding of order 1e-16 / 1e-5."""


def differences(parametrisation, values):
    """Twists by central differences of the placements."""
    here = parametrisation.placements(values)
    by_name = {name: np.zeros((6, len(values))) for name in here}
    for k, step in enumerate(STEP * np.eye(len(values))):
        ahead, behind = parametrisation.placements(values + step), parametrisation.placements(values - step)
        for name, placement in here.items():
            forward, backward = (pin.log6(placement.actInv(moved[name])).vector for moved in (ahead, behind))
            by_name[name][:, k] = (forward - backward) / (2 * STEP)
    return by_name


def test_twists_of_origin_components_are_the_derivative_of_the_placements(tmp_path):
    robot = calib.load(write_arm(tmp_path, EVERYTHING))
    assert len(robot.parameters) == 4 * 6 + 6 + 3
    generator = np.random.default_rng(1)
    size = [0.1 if p.dimension == "length" else 1.0 for p in robot.parameters]
    for _ in range(3):
        values = robot.values + generator.normal(0, 1, len(robot.values)) * size
        twists, expected = robot.parametrisation.twists(values), differences(robot.parametrisation, values)
        assert set(twists) == set(expected)
        for name, twist in expected.items():
            assert np.abs(twists[name] - twist).max() < DIFFERENCE_ERROR * (1 + np.abs(twist).max()), name


def test_a_translation_moves_the_origin_in_the_parent_and_a_rotation_turns_it_in_its_own_frame(tmp_path):
    robot = calib.load(write_arm(tmp_path, EVERYTHING))
    nominal = Rotation.from_euler("xyz", [0, np.pi / 2, 0]).as_matrix()  # rpy of the wrist; fixed axes
    moved = robot.with_parameters({"wrist.x": 0.5, "wrist.z": -0.25, "wrist.rx": 0.2, "wrist.rz": 0.1})
    placement = moved.mechanism.placement("wrist")
    assert placement.translation.tolist() == [0.5, 0.0, -0.25]  # the coordinate itself, not its change
    expected = nominal @ Rotation.from_rotvec([0.2, 0, 0.1]).as_matrix()
    assert np.abs(placement.rotation - expected).max() < 1e-15


def test_the_parameters_of_the_base_are_the_robot_seen_in_the_measurement_frame(tmp_path):
    robot = calib.load(write_arm(tmp_path, EVERYTHING))
    nominal = Rotation.from_euler("xyz", [0.3, -0.7, 2])
    values = {p.name: p.nominal_si for p in robot.parameters if p.name.startswith("base.")}
    assert list(values.values()) == [1, -2, 0.5, 0, 0, 0]
    moved = robot.with_parameters({"base.y": 5.0, "base.rx": 0.3, "base.rz": -0.4})
    rotation = (nominal * Rotation.from_rotvec([0.3, 0, -0.4])).as_matrix()
    q = np.array([0.4, 0.1, -0.9])
    # the link itself is seen from the base as without any base pose
    link = calib.load(write_arm(tmp_path)).forward(q, "hand")
    assert np.abs(moved.forward(q, "hand")[:3, 3] - (rotation @ link[:3, 3] + [1, 5, 0.5])).max() < 1e-14
    assert np.abs(moved.forward(q, "ground")[:3, :3] - rotation).max() < 1e-15


def test_a_target_moves_in_its_link(tmp_path):
    robot = calib.load(write_arm(tmp_path, EVERYTHING))
    q = np.array([0.4, 0.1, -0.9])
    tool = robot.forward(q, "tool")
    moved = robot.with_parameters({"tip.x": 0.1, "tip.y": 0.2, "tip.z": 0.3})
    assert np.abs(moved.positions(q)[0, 0] - (tool[:3, :3] @ [0.1, 0.2, 0.3] + tool[:3, 3])).max() < 1e-14


def test_units_sigmas_and_priors_are_as_described(tmp_path):
    yaml = EVERYTHING.replace("position: unknown}", "position: unknown, sigma: 3 mm}")
    yaml += "  - {origin: wrist, components: [rx], sigma: 1 deg, unit: mrad}\n"
    by_name = {p.name: p for p in calib.load(write_arm(tmp_path, yaml)).parameters}
    assert by_name["turn.z"] == Parameter("turn.z", "length", 0.5, 0.002, "mm")
    assert by_name["turn.rz"] == Parameter("turn.rz", "angle", 0.0, 0.005, "deg")
    assert by_name["wrist.rx"] == Parameter("wrist.rx", "angle", 0.0, np.pi / 180, "mrad")  # over `all`
    assert by_name["base.x"] == Parameter("base.x", "length", 1.0, 0.01, "mm", prior=False, placement=True)
    assert by_name["base.rx"] == Parameter("base.rx", "angle", 0.0, 0.01, "deg", prior=False, placement=True)
    assert by_name["tip.z"] == Parameter("tip.z", "length", 0.03, 0.003, "mm", prior=True, placement=True)
    assert len(by_name) == 33
    yaml = ARM_YAML + "priors: false\n"
    assert not any(p.prior for p in calib.load(write_arm(tmp_path, yaml)).parameters)


def test_all_means_the_origins_that_move_a_target_or_a_loop(tmp_path):
    yaml = ARM_YAML.replace("{frame: tool, xyz: [10 mm, 20 mm, 30 mm]}", "{frame: slider}")
    names = {p.name.split(".")[0] for p in calib.load(write_arm(tmp_path, yaml)).parameters}
    assert names == {"turn", "slide"}
    path = write_parallelogram(tmp_path)
    path.write_text(path.read_text().replace("x, y], sigma: 1 mm", "z], sigma: 1 mm"))
    assert [p.name for p in calib.load(path).parameters] == ["a.z", "c.z", "b.z", "d.z", "e.z"]


def test_held_parameters_are_not_free(tmp_path):
    robot = calib.load(write_arm(tmp_path, ARM_YAML + "held: [turn.x, wrist.rz]\n"))
    held = [p.name for p, free in zip(robot.parameters, robot.is_free, strict=True) if not free]
    assert held == ["turn.x", "wrist.rz"]


def test_nominal_values_give_back_the_nominal_urdf_byte_for_byte(tmp_path, medrue):
    arm = calib.load(write_arm(tmp_path, EVERYTHING))
    generator = np.random.default_rng(4)
    for robot in (arm, medrue):
        assert robot.calibrated_urdf() == robot.urdf.source
        assert robot.with_parameters(robot.values).calibrated_urdf() == robot.urdf.source
        there = robot.with_parameters(robot.values + generator.uniform(-1e-3, 1e-3, len(robot.values)))
        assert there.calibrated_urdf() != robot.urdf.source
        back = there.with_parameters([p.nominal_si for p in robot.parameters])
        assert back.calibrated_urdf() == robot.urdf.source


def test_an_edited_component_changes_its_number_and_no_other_byte(tmp_path):
    robot = calib.load(write_arm(tmp_path, EVERYTHING))
    source = robot.urdf.source
    moved = robot.with_parameters({"slide.x": 0.2512}).calibrated_urdf()
    assert moved == source.replace(b'"0.25 0 0"', b'"0.2512 0 0"')
    moved = robot.with_parameters({"wrist.y": -1e-3}).calibrated_urdf()
    assert moved == source.replace(b'"0.125 0 0.0"', b'"0.125 -0.001 0.0"')
    assert robot.with_parameters({"base.x": 3.0, "tip.x": 0.5}).calibrated_urdf() == source  # not in the URDF


def test_an_unknown_parameter_names_the_nearest(medrue):
    with pytest.raises(ParameterError, match=r"^parameters: no parameter 'L1l'; did you mean 'L\d1'\?$"):
        index_of(medrue.parameters, "L1l")
    with pytest.raises(ParameterError, match="no parameter 'zz'"):
        medrue.with_parameters({"zz": 1.0})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0.0, 1.0], r"2 values given for 24 parameters"),
        (np.full(24, np.nan), r"parameter 'turn\.x': value is not finite"),
        ({"slide.y": np.inf}, r"parameter 'slide\.y': value is not finite"),
    ],
)
def test_values_that_cannot_be_are_errors(tmp_path, values, message):
    with pytest.raises(ParameterError, match=message):
        calib.load(write_arm(tmp_path)).with_parameters(values)


class SharedLength:
    """A plugin: one length that two origins share, and that turns a third one."""

    def __init__(self, origins: Mapping[str, Origin]) -> None:
        self.origins = origins
        self.parameters = (Parameter("shared", "length", 0.0, 1e-3, "mm"),)

    def placements(self, values):
        x = np.array([values[0], 0, 0])
        turned = Origin(self.origins["flange"].xyz, self.origins["flange"].rpy + 2 * x)
        moved = {name: Origin(self.origins[name].xyz + x, self.origins[name].rpy) for name in ("slide", "wrist")}
        return {name: origin.placement for name, origin in (moved | {"flange": turned}).items()}

    def twists(self, values):
        x, none = np.array([[1.0], [0], [0]]), np.zeros((3, 1))
        result = {name: twist_of_edit(self.origins[name].rpy, x, none) for name in ("slide", "wrist")}
        rpy = self.origins["flange"].rpy + 2 * np.array([values[0], 0, 0])
        return result | {"flange": twist_of_edit(rpy, none, 2 * x)}


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Install a parametrisation named `mine`, and return a function that loads the arm with it."""

    def load(factory):
        def loaded():
            if isinstance(factory, Exception):
                raise factory
            return factory

        entry = SimpleNamespace(name="mine", value="somewhere:Mine", load=loaded)
        monkeypatch.setattr(calib.core.robots.parametrisation, "list_entry_points", lambda group: [entry])
        yaml = ARM_YAML[: ARM_YAML.index("parametrisation:")] + "parametrisation: mine\n"
        return calib.load(write_arm(tmp_path, yaml))

    return load


def test_a_plugin_gives_the_parameters_and_their_derivative(install):
    robot = install(SharedLength)
    q = np.array([[0.3, 0.2, -0.5], [1.0, 0.4, 0.7]])
    assert [p.name for p in robot.parameters] == ["shared"]
    at = robot.with_parameters([0.01])
    column = linearise(at, at.assemble(q)).jacobian[:, 0, :, 0]
    ahead, behind = (robot.with_parameters([0.01 + s]).positions(q)[:, 0] for s in (STEP, -STEP))
    assert np.abs(column - (ahead - behind) / (2 * STEP)).max() < DIFFERENCE_ERROR


class Elsewhere(SharedLength):
    def placements(self, values):
        return {"slid": pin.SE3.Identity()}


class WrongShape(SharedLength):
    def twists(self, values):
        return {name: twist[:, 0] for name, twist in super().twists(values).items()}


class MissingTwist(SharedLength):
    def twists(self, values):
        return {"slide": np.zeros((6, 1))}


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        (Elsewhere, ": the robot has no origin 'slid'; did you mean 'slide'?"),
        (WrongShape, ": twists must give a (6, 1) array for each of the origins that"),
        (MissingTwist, ": twists must give a (6, 1) array for each of the origins that"),
        (ImportError("none"), " (somewhere:Mine) cannot be loaded: ImportError: none; install its package"),
    ],
)
def test_a_plugin_that_breaks_the_protocol_is_an_error(install, factory, message):
    with pytest.raises(DescriptionError) as caught:
        install(factory)
    assert f"parametrisation 'mine'{message}" in str(caught.value)


def test_a_plugin_for_another_robot_says_what_it_misses(tmp_path):
    yaml = ARM_YAML[: ARM_YAML.index("parametrisation:")] + "parametrisation: medrue\n"
    with pytest.raises(DescriptionError, match="parametrisation 'medrue': the URDF has no joint"):
        calib.load(write_arm(tmp_path, yaml))

"""Drake: the exported URDF, the one with ball constraints, and the MJCF; still and servoed under gravity."""

import logging
from functools import partial

import numpy as np
import pytest

import calib
from calib.exporting.formats import export

pytest.importorskip("pydrake", reason="Drake is not installed (in a checkout: pip install -e '.[interop]')")
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.analysis import Simulator

SOFTNESS, SAG = 1e-5, 5e-5
"""As stated in docs/other_tools.md [m]; see test_mujoco.py."""


@pytest.fixture(autouse=True)
def _quiet() -> None:
    logging.getLogger("drake").setLevel(logging.ERROR)  # it remarks on every MJCF tag that it passes over


def load(file, weld: str | None = None):
    plant = MultibodyPlant(time_step=1e-3)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    (instance,) = Parser(plant).AddModels(str(file))
    if weld is not None:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(weld, instance))
    plant.Finalize()
    return plant, instance


def put(plant, instance, context, values: dict[str, float]) -> None:
    for name, value in values.items():
        joint = plant.GetJointByName(name, instance)
        if hasattr(joint, "set_translation"):
            joint.set_translation(context, value)
        else:
            joint.set_angle(context, value)


def read(plant, instance, context, names) -> np.ndarray:
    joints = [plant.GetJointByName(name, instance) for name in names]
    return np.array(
        [j.get_translation(context) if hasattr(j, "get_translation") else j.get_angle(context) for j in joints]
    )


@pytest.mark.parametrize("file", ["robot.urdf", "drake.urdf", "free_drake.urdf", "robot.xml", "free.xml"])
def test_every_link_is_where_pinocchio_says(case, file: str) -> None:
    plant, instance = load(case.folder / file)
    context = plant.CreateDefaultContext()

    def pose(link: str):
        body = plant.world_body() if link == "world" else plant.GetBodyByName(link, instance)
        return plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4()

    assert case.largest_difference(f"Drake, {file}", partial(put, plant, instance, context), pose) < 1e-9


@pytest.mark.parametrize("file", ["drake.urdf", "robot.xml"])
def test_the_loops_and_the_motors_are_read(case, file: str) -> None:
    plant, _ = load(case.folder / file)
    assert (plant.num_constraints(), plant.num_actuators()) == (3, 6)


def hold(file, robot: calib.Robot, q, values: dict[str, float], weld: str | None = None, seconds: float = 1.0):
    """Simulate with servos at q until the robot rests; returns plant, instance, context, and the joints there."""
    plant, instance = load(file, weld)
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()
    put(plant, instance, context, values)
    motors = [plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(instance)]
    command = dict(zip(robot.joint_names, q, strict=True))
    state = [command[name] for name in motors] + [0.0] * len(motors)
    plant.get_desired_state_input_port(instance).FixValue(context, state)
    plant.get_actuation_input_port().FixValue(context, np.zeros(len(motors)))
    simulator.AdvanceTo(seconds)
    assert np.abs(plant.GetVelocities(context)).max() < 1e-5
    return plant, instance, context, read(plant, instance, context, robot.joint_names)


def place(plant, instance, context, frame: str) -> np.ndarray:
    return plant.GetFrameByName(frame, instance).CalcPoseInWorld(context).translation()


@pytest.mark.quick(0)
@pytest.mark.parametrize("file", ["drake.urdf", "free_drake.urdf"])
def test_under_gravity_the_loops_stay_closed_and_the_tool_is_where_calib_predicts(case, file: str) -> None:
    opening = there = from_commanded = 0.0
    for k in range(0, 50, 12):
        *where, actual = hold(case.folder / file, case.robot, case.q[k], case.joints[k])
        tool = place(*where, "target_tool")
        for a, b in case.robot.description.closed_loop:
            opening = max(opening, float(np.abs(place(*where, a) - place(*where, b)).max()))
        there = max(there, float(np.linalg.norm(tool - case.robot.forward(actual)[:3, 3])))
        from_commanded = max(from_commanded, float(np.linalg.norm(tool - case.robot.forward(case.q[k])[:3, 3])))
    print(f"Drake, {file}: loops open by {opening:.1e} m; tool against predict at the joints where the servos stand"
          f" {there:.1e} m, at the commanded ones {from_commanded:.1e} m")  # fmt: skip
    assert opening < SOFTNESS
    assert there < SOFTNESS
    assert from_commanded < SAG


def test_a_tilted_five_bar_stands_right_with_a_free_slide(tilted, tmp_path) -> None:
    q = tilted.home + np.array([0.0, 0.25, 0.2, 0.1, -0.2, 0.3])
    passive = tilted.assemble(q).passive[0]
    joints = dict(zip((*tilted.joint_names, *tilted.passive_names), (*q, *passive), strict=True))
    export(tilted, tmp_path / "out.urdf", "drake", free_slide=True)
    *where, actual = hold(tmp_path / "out.urdf", tilted, q, joints)
    assert np.linalg.norm(place(*where, "target_tool") - tilted.forward(actual)[:3, 3]) < SOFTNESS
    assert np.linalg.norm(place(*where, "target_tool") - tilted.forward(q)[:3, 3]) < SAG


def test_whole_frames_that_meet_are_tied_at_three_points(four_bar, tmp_path) -> None:
    export(four_bar, tmp_path / "out.urdf", "drake")
    start = {"motor": 0.9, "a": -0.9, "foot": 0.9, "b": -0.9}
    *where, actual = hold(tmp_path / "out.urdf", four_bar, [0.9], start, weld="ground")
    point = np.array([0.2 * np.cos(actual[0]) + 0.1, 0.2 * np.sin(actual[0]) + 0.05, 0.0])  # a parallelogram
    assert np.abs(place(*where, "target_coupler") - point).max() < SOFTNESS

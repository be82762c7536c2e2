"""MuJoCo and Drake with an exported file: where its links are, and where they come to rest under gravity."""

import logging

import numpy as np
import pytest

MISSING = "{} is not installed (in a checkout: pip install -e '.[interop]')"


class MuJoCo:
    """A file in MuJoCo."""

    def __init__(self, file, root="world"):
        self.mujoco = pytest.importorskip("mujoco", reason=MISSING.format("MuJoCo"))
        self.model = self.mujoco.MjModel.from_xml_path(str(file))
        self.data = self.mujoco.MjData(self.model)

    def put(self, values):
        """Bring joints to values by name."""
        for name, value in values.items():
            self.data.joint(name).qpos[0] = value
        self.mujoco.mj_kinematics(self.model, self.data)

    def pose(self, link):
        """Where a link is, (4, 4)."""
        body, result = self.data.body(link), np.eye(4)
        result[:3, :3], result[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return result

    def at(self, values, link):
        """Where a link is at values of joints by name, (4, 4)."""
        self.put(values)
        return self.pose(link)

    def open_ties(self):
        """How far each row of an equality is from holding [m or rad]."""
        self.mujoco.mj_forward(self.model, self.data)
        return self.data.efc_pos[self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY]

    def hold(self, commands, values):
        """Start at values, simulate for 1 s with servos at commands by name; return where their joints rest."""
        self.put(values)
        for name, value in commands.items():
            self.data.actuator(name).ctrl[0] = value
        self.mujoco.mj_step(self.model, self.data, nstep=int(1.0 / self.model.opt.timestep))
        self.mujoco.mj_forward(self.model, self.data)
        assert np.abs(self.data.qvel).max() < 1e-5
        return np.array([self.data.joint(name).qpos[0] for name in commands])


class Drake:
    """A file in Drake, which wants to know the root link."""

    def __init__(self, file, root="world"):
        pytest.importorskip("pydrake", reason=MISSING.format("Drake"))
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
        from pydrake.systems.analysis import Simulator

        logging.getLogger("drake").setLevel(logging.ERROR)  # it remarks on every tag that it passes over
        self.plant = MultibodyPlant(time_step=1e-3)
        self.plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        (self.instance,) = Parser(self.plant).AddModels(str(file))
        if root != "world":
            self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(root, self.instance))
        self.plant.Finalize()
        self.simulator = Simulator(self.plant)
        self.context = self.simulator.get_mutable_context()

    def put(self, values):
        """Bring joints to values by name."""
        for name, value in values.items():
            joint = self.plant.GetJointByName(name, self.instance)
            (joint.set_translation if hasattr(joint, "set_translation") else joint.set_angle)(self.context, value)

    def pose(self, link):
        """Where a link or frame is, (4, 4)."""
        frame = self.plant.world_frame() if link == "world" else self.plant.GetFrameByName(link, self.instance)
        return frame.CalcPoseInWorld(self.context).GetAsMatrix4()

    def at(self, values, link):
        """Where a link is at values of joints by name, (4, 4)."""
        self.put(values)
        return self.pose(link)

    def hold(self, commands, values):
        """Start at values, simulate for 1 s with servos at commands by name; return where their joints rest."""
        self.put(values)
        indices = self.plant.GetJointActuatorIndices(self.instance)
        motors = [self.plant.get_joint_actuator(index).joint().name() for index in indices]
        state = [commands[name] for name in motors] + [0.0] * len(motors)
        self.plant.get_desired_state_input_port(self.instance).FixValue(self.context, state)
        self.plant.get_actuation_input_port().FixValue(self.context, np.zeros(len(motors)))
        self.simulator.AdvanceTo(1.0)
        assert np.abs(self.plant.GetVelocities(self.context)).max() < 1e-5
        joints = [self.plant.GetJointByName(name, self.instance) for name in commands]
        return np.array([joint.GetOnePosition(self.context) for joint in joints])

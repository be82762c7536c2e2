"""Tools with an exported file: where its links are; in MuJoCo and Drake, where they come to rest under gravity."""

import logging

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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


class PyBullet:
    """A file in PyBullet, which computes in single precision."""

    def __init__(self, file):
        self.pybullet = pytest.importorskip("pybullet", reason=MISSING.format("PyBullet"))
        self.client = self.pybullet.connect(self.pybullet.DIRECT)
        self.robot = self.pybullet.loadURDF(str(file), useFixedBase=True, physicsClientId=self.client)
        count = self.pybullet.getNumJoints(self.robot, physicsClientId=self.client)
        infos = [self.pybullet.getJointInfo(self.robot, i, physicsClientId=self.client) for i in range(count)]
        self.joints = {info[1].decode(): info[0] for info in infos}
        self.links = {info[12].decode(): info[0] for info in infos}

    def __del__(self):
        self.pybullet.disconnect(self.client)

    def at(self, values, link):
        """Where a link is at values of joints by name, (4, 4)."""
        own = {"physicsClientId": self.client}
        for name, value in values.items():
            self.pybullet.resetJointState(self.robot, self.joints[name], value, **own)
        result = np.eye(4)
        if link != "world":
            state = self.pybullet.getLinkState(self.robot, self.links[link], computeForwardKinematics=True, **own)
            result[:3, 3] = state[4]
            result[:3, :3] = np.reshape(self.pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        return result


class Yourdfpy:
    """A URDF in yourdfpy."""

    def __init__(self, file):
        self.robot = pytest.importorskip("yourdfpy").URDF.load(str(file), load_meshes=False)

    def at(self, values, link):
        """Where a link is at values of joints by name, (4, 4)."""
        self.robot.update_cfg(values)
        return self.robot.get_transform(link, frame_from="world")


class UrdfParser:
    """A URDF in urdf_parser_py, which reads numbers alone: origins and motions are put together here."""

    def __init__(self, file):
        urdf = pytest.importorskip("urdf_parser_py.urdf", reason=MISSING.format("urdf_parser_py"))
        self.robot = urdf.URDF.from_xml_string(file.read_bytes())

    def at(self, values, link):
        """Where a link is at values of joints by name, (4, 4)."""
        result = np.eye(4)
        while link in self.robot.parent_map:
            name, link = self.robot.parent_map[link]
            joint, value, origin, motion = self.robot.joint_map[name], values.get(name, 0.0), np.eye(4), np.eye(4)
            origin[:3, :3] = Rotation.from_euler("xyz", joint.origin.rpy).as_matrix()
            origin[:3, 3] = joint.origin.xyz
            if joint.type == "prismatic":
                motion[:3, 3] = value * np.array(joint.axis)
            elif joint.type != "fixed":
                motion[:3, :3] = Rotation.from_rotvec(value * np.array(joint.axis)).as_matrix()
            result = origin @ motion @ result
        return result

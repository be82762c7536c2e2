"""PyBullet: every link of the exported URDF (single precision inside), and its loops closed by constraints."""

import numpy as np
import pytest

pybullet = pytest.importorskip(
    "pybullet", reason="PyBullet is not installed (in a checkout: pip install -e '.[interop]')"
)

SINGLE_PRECISION = 1e-6


@pytest.fixture
def client():
    number = pybullet.connect(pybullet.DIRECT)
    yield number
    pybullet.disconnect(number)


def test_every_link_is_where_pinocchio_says(case, client: int) -> None:
    robot = pybullet.loadURDF(str(case.folder / "robot.urdf"), useFixedBase=True, physicsClientId=client)
    infos = [pybullet.getJointInfo(robot, i, physicsClientId=client) for i in range(pybullet.getNumJoints(robot))]
    joints = {info[1].decode(): info[0] for info in infos}
    links = {info[12].decode(): info[0] for info in infos}

    def pose(values: dict[str, float], link: str) -> np.ndarray:
        for name, value in values.items():
            pybullet.resetJointState(robot, joints[name], value, physicsClientId=client)
        result = np.eye(4)
        if link != "world":
            state = pybullet.getLinkState(robot, links[link], computeForwardKinematics=True, physicsClientId=client)
            result[:3, 3] = state[4]
            result[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        return result

    assert case.largest_difference("PyBullet, URDF", pose) < SINGLE_PRECISION

"""Robots in the lab's own files: a line for each joint with its name, the place of its origin and its axis."""

from collections.abc import Mapping

from calib.extend import ForeignRobot, UrdfError, joint_text, robot_text


def read_chain(path: str, content: bytes, _arguments: Mapping[str, str]) -> tuple[bytes, ForeignRobot]:
    """Return the chain of a file as a URDF; each line is `NAME x y z [mm] ax ay az`, from the base on."""
    joints = []
    for number, line in enumerate(content.decode(errors="replace").splitlines(), start=1):
        try:
            name, x, y, z, *axis = line.split()
            place = [1e-3 * float(cell) for cell in (x, y, z)]
        except ValueError:
            raise UrdfError(f"{path}, line {number}: expected NAME x y z ax ay az") from None
        links = f"link_{number - 1}", f"link_{number}"
        joints.append(joint_text(name, "revolute", links, place, (0, 0, 0), " ".join(axis), (-3.1, 3.1)))
    if not joints:
        raise UrdfError(f"{path}: is empty; expected lines of NAME x y z ax ay az")
    links_of_all = [f"link_{k}" for k in range(len(joints) + 1)]
    remark = f"{path} states no limits of joints: +-3.1 rad are taken"
    return robot_text("chain", f"from {path}", links_of_all, joints).encode(), ForeignRobot(remarks=(remark,))

"""yourdfpy: every link of the exported URDF, 50 configurations."""

import yourdfpy


def test_every_link_is_where_pinocchio_says(case) -> None:
    robot = yourdfpy.URDF.load(str(case.folder / "robot.urdf"), load_meshes=False)
    at = -1

    def pose(k: int, link: str):
        nonlocal at
        if k != at:
            robot.update_cfg(case.joints[k])
            at = k
        return robot.get_transform(link, "world")

    assert case.largest_difference("yourdfpy, URDF", pose) < 1e-9

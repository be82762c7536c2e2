"""SDF given in place of a URDF: frames, axes, loops; expected poses are products written out here."""

import numpy as np
import pytest

import calib
from calib.core.robots.urdf.text import read_urdf
from calib.shared.links import read_links
from tests.core.robots.test_loops import by_hand, elbows

ARM = """<?xml version="1.0"?>
<sdf version="{version}"><world name="w"><model name="arm"><pose>5 5 5 0 0 1</pose>
<link name="base"/>
<link name="upper"><pose>0.1 0 0.4 0 0 0.5</pose></link>
<link name="fore"><pose relative_to="upper">0.3 0 0.05 0.2 0 0</pose>
 <inertial><mass>2</mass><pose>0.1 0 0 0 0 0</pose><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>
 <visual name="v"><geometry><box><size>0.1 0.2 0.3</size></box></geometry></visual></link>
<link name="tip"><pose relative_to="tip_at">0 0 0 0 0 0</pose></link>
<frame name="tip_at" attached_to="fore"><pose degrees="true">0.25 0 0 0 90 0</pose></frame>
<joint name="fix" type="fixed"><parent>world</parent><child>base</child></joint>
<joint name="swing" type="revolute"><parent>base</parent><child>upper</child><pose>0 0 -0.1 0 0 0</pose>
 <axis><xyz{axis}>0 1 0</xyz>{old}<limit><lower>-1</lower><upper>2</upper></limit></axis></joint>
<joint name="push" type="prismatic"><parent>upper</parent><child>fore</child>
 <axis><xyz>1 0 0</xyz><limit><lower>0</lower><upper>0.3</upper></limit></axis></joint>
<joint name="roll" type="revolute"><parent>fore</parent><child>tip</child>
 <axis><xyz>0 0 1</xyz><limit><lower>-1e16</lower><upper>1e16</upper></limit></axis></joint>
</model></world></sdf>"""


def moved(x=0.0, y=0.0, z=0.0, axis="x", angle=0.0):
    k = "xyz".index(axis)
    c, s = np.cos(angle), np.sin(angle)
    result, (i, j) = np.eye(4), [n for n in range(3) if n != k] if k != 1 else (2, 0)
    result[i, i], result[i, j], result[j, i], result[j, j], result[:3, 3] = c, -s, s, c, (x, y, z)
    return result


def load(tmp_path, text, **keys):
    (tmp_path / "robot.sdf").write_text(text)
    return calib.robot(tmp_path / "robot.sdf", **keys)


@pytest.mark.parametrize("version", ["1.6", "1.9"])
def test_frames_axes_and_limits_mean_what_sdf_says(tmp_path, version):
    text = ARM.format(version=version, axis="", old="")
    robot = load(tmp_path, text, target="tip")
    assert robot.joint_names == ("swing", "push", "roll")
    assert np.transpose(robot.joint_limits).tolist() == [[-1, 0, -np.inf], [2, 0.3, np.inf]]
    q = np.array([0.4, 0.1, -0.7])
    upper = moved(0.1, 0, 0.4, "z", 0.5) @ moved(0, 0, -0.1) @ moved(axis="y", angle=q[0]) @ moved(0, 0, 0.1)
    fore = upper @ moved(0.3, 0, 0.05) @ moved(axis="x", angle=0.2) @ moved(q[1])
    tip = fore @ moved(0.25, 0, 0) @ moved(axis="y", angle=np.pi / 2) @ moved(axis="z", angle=q[2])
    assert np.allclose(robot.forward(q[None], frame="tip")[0], tip, atol=1e-12)


def test_axes_may_be_of_the_model(tmp_path):
    expected = None
    for version, axis, old in (
        ("1.4", "", ""),
        ("1.6", "", "<use_parent_model_frame>true</use_parent_model_frame>"),
        ("1.8", ' expressed_in="__model__"', ""),
    ):
        robot = load(tmp_path, ARM.format(version=version, axis=axis, old=old), target="fore")
        place = robot.forward(np.array([[0.4, 0.0]]), frame="fore")[0]
        about = np.array([0.1, 0, 0.3])  # where the joint is; its axis is y of the model
        expected = moved(*about) @ moved(axis="y", angle=0.4) @ moved(*-about) @ moved(0.1, 0, 0.4, "z", 0.5)
        expected = expected @ moved(0.3, 0, 0.05) @ moved(axis="x", angle=0.2)
        assert np.allclose(place, expected, atol=1e-12)


FIVE_BAR = """<sdf version="1.7"><model name="five_bar"><link name="base"/>
<link name="a1"><pose>-0.1 0 0 0 0 1.2</pose></link><link name="b1"><pose>0.1 0 0 0 0 1.9</pose></link>
<link name="a2"><pose relative_to="a1">0.2 0 0 0 0 {a}</pose></link>
<link name="b2"><pose relative_to="b1">0.2 0 0 0 0 {b}</pose></link>
<joint name="left" type="revolute"><parent>base</parent><child>a1</child>{axis}</joint>
<joint name="right" type="revolute"><parent>base</parent><child>b1</child>{axis}</joint>
<joint name="left_end" type="revolute"><parent>a1</parent><child>a2</child>{axis}</joint>
<joint name="right_end" type="revolute"><parent>b1</parent><child>b2</child>{axis}</joint>
<joint name="tip" type="revolute"><parent>a2</parent><child>b2</child><pose relative_to="a2">0.3 0 0 0 0 0</pose>
{axis}</joint>
<plugin name="p" filename="x"><joint_name>left</joint_name></plugin>
<plugin name="p" filename="x"><joint_name>right</joint_name></plugin>
</model></sdf>"""


def test_a_link_that_is_the_child_of_two_joints_closes_a_loop(tmp_path):
    tip = by_hand(1.2, 1.9, 1)
    a, b = (np.arctan2(*(tip - elbow)[::-1]) for elbow in elbows(1.2, 1.9))
    text = FIVE_BAR.format(a=a - 1.2, b=b - 1.9, axis="<axis><xyz>0 0 1</xyz></axis>")
    (tmp_path / "five_bar.sdf").write_text(text)
    robot = calib.load(tmp_path / "five_bar.sdf")
    assert robot.description.closed_loop == (("tip_a", "tip_b"),)
    assert robot.description.closed_loop_axes == (("x", "y"),)
    assert robot.joint_names == ("left", "right")
    places = robot.forward([[0.0, 0.0], [0.3, 0.3]], frame="tip_a")[:, :2, 3]
    assert np.allclose(places, [tip, by_hand(1.5, 2.2, 1)], atol=1e-9)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('type="prismatic"', 'type="screw"', "joint 'push': is screw, which no URDF has"),
        ("<lower>0</lower>", "", "joint 'push': slides without limits"),
        ("<parent>upper</parent>", "<parent>uper</parent>", "its parent 'uper' is no link; did you mean 'upper'"),
        ('relative_to="upper"', 'relative_to="fore"', "'fore' is placed relative to itself"),
        ("0.3 0 0.05 0.2 0 0", "0.3 0 0.05", "are not 6 numbers"),
        ("<link name=\"base\"/>", '<link name="base"/><include><uri>model://x</uri></include>', "holds other models"),
    ],
)  # fmt: skip
def test_what_a_urdf_cannot_hold_is_one_line(tmp_path, before, after, said):
    text = ARM.format(version="1.9", axis="", old="")
    assert before in text
    (tmp_path / "robot.sdf").write_text(text.replace(before, after, 1))
    with pytest.raises(calib.UrdfError, match=said):
        read_urdf(tmp_path / "robot.sdf")


def test_collision_shapes_are_kept_and_those_that_a_urdf_cannot_hold_are_said(tmp_path, run_calib):
    box = "<geometry><box><size>0.1 0.2 0.3</size></box></geometry>"
    ball = "<geometry><ellipsoid><radii>1 2 3</radii></ellipsoid></geometry>"
    shapes = f'<collision name="c"><pose>0 0 0.1 0 0 0</pose>{box}</collision><collision name="d">{ball}</collision>'
    text = ARM.format(version="1.9", axis="", old="").replace("</visual>", f"</visual>{shapes}")
    link = read_links(load(tmp_path, text).urdf)["fore"]
    assert [(shape.kind, shape.size) for shape in link.collisions] == [("box", (0.1, 0.2, 0.3))]
    assert link.collisions[0].placement.translation.tolist() == [0.0, 0.0, 0.1]
    run = run_calib("init", "robot.sdf", "--out", "robot.yaml", cwd=tmp_path)
    assert "ollision shapes left out, which a URDF cannot hold (write 'obstacles' for them): of fore" in run.out

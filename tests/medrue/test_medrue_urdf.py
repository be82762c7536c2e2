"""The URDF of MedRUE: readable by several programs, the tree of the paper, and equal to the closed form."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin

from medrue.closed_form import ACTUATED_JOINTS, PASSIVE_JOINTS, forward
from medrue.paper_tables import PARAMETERS, table1
from medrue.workspace import HOME, target_workspace
from tests.project import ROOT

URDF = ROOT / "urdf" / "medrue.urdf"
JOINTS = ACTUATED_JOINTS + PASSIVE_JOINTS
CLOSURES = (("E1_B", "E1_D", (1, 2)), ("E2_B", "E2_D", (1, 2)), ("G2_E", "G2_slide", (0, 1, 2)))
ONE_PICOMETRE = 1e-12
"""Rounding over about 20 transforms of lengths up to 1 m stays below 1e-14 m; this leaves room."""

Origin = tuple[tuple[float, float, float], tuple[float, float, float]]


def expected_tree(values):
    """Joint name to (type, parent, child, axis, origin) for given parameters, as the paper's equations ask."""
    p = dict(zip(PARAMETERS, values.tolist(), strict=True))
    x, y, z = "1 0 0", "0 1 0", "0 0 1"
    none = (0.0, 0.0, 0.0)
    tree = {
        "base_origin": ("fixed", "world", "base", None,
                        ((p["xb"], p["yb"], p["zb"]), (p["phi_bx"], p["phi_by"], p["phi_bz"]))),
        "q1": ("prismatic", "base", "carriage", x, ((p["dq1"], 0.0, 0.0), none)),
        "G2_E_origin": ("fixed", "E2_D", "G2_E", None, ((p["d42"] - p["d32"], 0.0, 0.0), none)),
        "q6": ("revolute", "E1_D", "probe_turn", x, (none, (p["dq6"], 0.0, 0.0))),
        "beta": ("revolute", "probe_turn", "universal_cross", y, ((p["d31"] - p["d41"], 0.0, 0.0), none)),
        "alpha": ("revolute", "universal_cross", "probe_support", z, (none, none)),
        "slide": ("prismatic", "probe_support", "G2_slide", x, ((p["d41"] + p["d42"], 0.0, 0.0), none)),
        "F6_origin": ("fixed", "probe_support", "F6", None, ((p["d41"] + p["d5"], 0.0, 0.0), none)),
        "tool_origin": ("fixed", "F6", "tool", None, ((p["xt"], p["yt"], p["zt"]), none)),
    }  # fmt: skip
    for i, anchor, proximal, elbow, distal in ((1, "A", 1, "B", 2), (1, "C", 3, "D", 4),
                                               (2, "A", 1, "B", 2), (2, "C", 3, "D", 4)):  # fmt: skip
        motor = f"q{2 * i + (anchor == 'C')}"
        psi = float(np.arctan2(p[f"A{i}z"] - p[f"C{i}z"], p[f"A{i}y"] - p[f"C{i}y"]))
        side = -p["d31"] if i == 1 else p["d32"]
        place = (side, p[f"{anchor}{i}y"], p[f"{anchor}{i}z"])
        upper, lower, end = f"proximal_{anchor}{i}", f"distal_{elbow}{i}", f"E{i}_{elbow}"
        tree[motor] = ("revolute", "carriage", upper, x, (place, (psi + p["d" + motor], 0.0, 0.0)))
        tree[f"{elbow}{i}"] = ("revolute", upper, lower, x, ((0.0, p[f"L{i}{proximal}"], 0.0), none))
        tree[f"{end}_origin"] = ("fixed", lower, end, None, ((0.0, p[f"L{i}{distal}"], 0.0), none))
    return tree


def model_with(values):
    """Pinocchio model of the URDF with its origins placed for other parameters."""
    document = ElementTree.parse(URDF)
    tree = expected_tree(values)
    for joint in document.getroot().iterfind("joint"):
        xyz, rpy = tree[joint.attrib["name"]][4]
        origin = joint.find("origin")
        assert origin is not None
        origin.attrib.update(xyz=" ".join(map(repr, xyz)), rpy=" ".join(map(repr, rpy)))
    return pin.buildModelFromXML(ElementTree.tostring(document.getroot(), encoding="unicode"))


def place_frames(model, joints):
    """Forward kinematics of the tree, joint values by name."""
    assert {name for name in model.names if name != "universe"} == set(joints)
    data = model.createData()
    q = np.zeros(model.nq)
    for name, value in joints.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    return data


def pose(model, data, frame):
    """Pose of a frame in the world; the frame must exist."""
    assert model.existFrame(frame)
    return data.oMf[model.getFrameId(frame)].copy()


def largest_gap(model, data):
    """Largest distance along a closed axis between the frames of a closure [m]."""
    gaps = []
    for first, second, axes in CLOSURES:
        difference = pose(model, data, first).actInv(pose(model, data, second).translation)
        # In the first frame's axes: the five-bars' links only turn about x, so x stays out of rows y and z.
        gaps.append(np.abs(difference[list(axes)]).max())
    return float(max(gaps))


def assert_closed_form_agrees(values, q):
    model = model_with(values)
    closed = forward(q, values)
    assert closed.closes.all()
    for row in range(len(q)):
        joints = dict(zip(JOINTS, [*q[row], *closed.passive[row]], strict=True))
        data = place_frames(model, joints)
        tool = pose(model, data, "tool")
        assert np.abs(tool.translation - closed.p_world_tool[row]).max() < ONE_PICOMETRE
        assert np.abs(tool.rotation - closed.R_world_tool[row]).max() < ONE_PICOMETRE
        assert largest_gap(model, data) < ONE_PICOMETRE


def test_tree_matches_the_paper_with_nominal_values():
    by_name = {}
    for joint in ElementTree.parse(URDF).getroot().iterfind("joint"):
        parent, child, origin, axis = (joint.find(tag) for tag in ("parent", "child", "origin", "axis"))
        assert parent is not None
        assert child is not None
        assert origin is not None
        xyz, rpy = (tuple(map(float, origin.attrib[key].split())) for key in ("xyz", "rpy"))
        by_name[joint.attrib["name"]] = (joint.attrib["type"], parent.attrib["link"], child.attrib["link"],
                                       None if axis is None else axis.attrib["xyz"], (xyz, rpy))  # fmt: skip
    assert by_name == expected_tree(table1().nominal)  # exactly: the file holds 17 digits where they are needed


def test_closed_form_equals_the_urdf_at_nominal_actual_and_perturbed_parameters():
    generator, table = np.random.default_rng(20150107), table1()
    for values in (table.nominal, table.actual):
        assert_closed_form_agrees(values, target_workspace().q[::7])
    for _ in range(25):
        rows = generator.integers(len(target_workspace().q), size=8)
        values = table.nominal + generator.uniform(-1.0, 1.0, len(PARAMETERS)) * table.reach
        assert_closed_form_agrees(values, target_workspace().q[rows])


def test_home_closes_the_loops_to_rounding():
    model = pin.buildModelFromUrdf(str(URDF))
    assert largest_gap(model, place_frames(model, dict(HOME))) < 1e-15  # a few units in the last place of 1 m


def test_workspace_and_home_stay_inside_the_joint_limits():
    limits = joint_limits()
    closed = forward(target_workspace().q, table1().nominal)
    values = np.hstack([target_workspace().q, closed.passive])
    for name, column in zip(JOINTS, values.T, strict=True):
        lower, upper = limits[name]
        assert lower < column.min(), name
        assert column.max() < upper, name
        assert lower < HOME[name] < upper, name


def test_limits_exclude_the_other_assembly_mode():
    """The mirror image of E1 and E2 in the line B D needs an elbow beyond its limit, in all 420 poses."""
    limits = joint_limits()
    closed = forward(target_workspace().q, table1().nominal)
    p = dict(zip(PARAMETERS, table1().nominal, strict=True))
    for i in (1, 2):
        q = target_workspace().q
        A, C = p[f"A{i}y"] + 1j * p[f"A{i}z"], p[f"C{i}y"] + 1j * p[f"C{i}z"]
        to_B = np.exp(1j * (np.angle(A - C) + q[:, 2 * i - 1]))
        to_D = np.exp(1j * (np.angle(A - C) + q[:, 2 * i]))
        B, D = A + p[f"L{i}1"] * to_B, C + p[f"L{i}3"] * to_D
        E = B + p[f"L{i}2"] * to_B * np.exp(1j * closed.joint(f"B{i}"))
        mirrored = D + (B - D) * np.conj((E - D) / (B - D))
        turn_B, turn_D = np.angle((mirrored - B) / to_B), np.angle((mirrored - D) / to_D)
        inside_B = (limits[f"B{i}"][0] <= turn_B) & (turn_B <= limits[f"B{i}"][1])
        inside_D = (limits[f"D{i}"][0] <= turn_D) & (turn_D <= limits[f"D{i}"][1])
        assert not (inside_B & inside_D).any()
    assert limits["slide"][0] > -2.0 * (p["d41"] + p["d42"])  # the support pointing the other way


def joint_limits():
    by_name = {}
    for joint in ElementTree.parse(URDF).getroot().iterfind("joint"):
        limit = joint.find("limit")
        if joint.attrib["type"] != "fixed":
            assert limit is not None
            by_name[joint.attrib["name"]] = (float(limit.attrib["lower"]), float(limit.attrib["upper"]))
    return by_name


def test_every_moving_link_has_a_possible_inertia():
    model = pin.buildModelFromUrdf(str(URDF))
    for name, inertia in zip(model.names[1:], list(model.inertias)[1:], strict=True):
        moments = np.sort(np.linalg.eigvalsh(inertia.inertia))
        assert inertia.mass > 0.0, name
        assert moments[0] > 0.0, name
        assert moments[0] + moments[1] >= moments[2] * (1.0 - 1e-9), name


def test_shapes_are_primitives_that_every_program_reads():
    shapes = {shape.tag for geometry in ElementTree.parse(URDF).iter("geometry") for shape in geometry}
    assert shapes <= {"box", "cylinder", "sphere"}

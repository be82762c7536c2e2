"""The calibrated URDF with Drake's extensions: ball constraints that close the loops, servo gains, frames.

The URDF itself keeps its bytes; one block is added before `</robot>` and the namespace is declared on the top element.
A tie of a point is one `drake:ball_constraint`. A tie of whole frames is three, at three points that are not in line.
Drake simulates ball constraints in discrete time (the plant's time step above zero).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.results.urdf import comment, provenance_lines, with_inserted
from calib.core.robots.urdf.text import parse_urdf
from calib.core.robots.urdf.writing import number_attribute, quote_attribute
from calib.exporting.closed_model import ClosedModel, Marker, Tie, servo_gains, tie_lines
from calib.shared.links import element_tree

NAMESPACE = "http://drake.mit.edu"

_ARMS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
"""Points of link a that are fixed in link b, (3, 3) [m]; the first alone for a tie of a point."""


def drake_bytes(model: ClosedModel, provenance: Sequence[str] = ()) -> bytes:
    """Return the URDF for Drake; `provenance` are lines of its comment."""
    origin = [*provenance, *provenance_lines(model.robot)]
    lines = [comment(["calib: a closed robot for Drake", *origin, *tie_lines(model)])]
    lines += [_ball(tie, point) for tie in model.ties for point in _ARMS[: 3 if tie.full_pose else 1]]
    lines += [_frame(marker) for marker in model.markers]
    urdf = model.urdf
    entries = element_tree(urdf.source).iterfind("transmission")
    moved = {joint.get("name") for entry in entries for joint in entry.iterfind("joint")}
    motors = zip(model.robot.joint_names, model.inertia, strict=True)
    lines += [_transmission(name, inertia) for name, inertia in motors if name not in moved]
    text = "\n" + "\n".join(lines) + "\n"
    closed = parse_urdf(with_inserted(urdf, text, at=urdf.end), urdf.path)
    tag = closed.source[slice(*closed.root_span)]
    if b"xmlns:drake" in tag:
        return closed.source
    return with_inserted(closed, f' xmlns:drake="{NAMESPACE}"', at=closed.root_span[0] + len("<robot"))


def _ball(tie: Tie, point: FloatArray) -> str:
    on_b = tie.placement.act(point)
    return (
        f"  <drake:ball_constraint>\n    <drake:ball_constraint_body_A name={quote_attribute(tie.a)}/>\n"
        f"    <drake:ball_constraint_body_B name={quote_attribute(tie.b)}/>\n"
        f'    <drake:ball_constraint_p_AP value="{number_attribute(point)}"/>\n'
        f'    <drake:ball_constraint_p_BQ value="{number_attribute(on_b)}"/>\n  </drake:ball_constraint>'
    )


def _frame(marker: Marker) -> str:
    rpy = pin.rpy.matrixToRpy(marker.placement.rotation)
    return (
        f"  <frame name={quote_attribute(marker.name)} link={quote_attribute(marker.link)}"
        f' xyz="{number_attribute(marker.placement.translation)}" rpy="{number_attribute(rpy)}"/>'
    )


def _transmission(name: str, inertia: float) -> str:
    """An actuator with servo gains."""
    stiffness, damping = servo_gains(inertia)
    return (
        f"  <transmission name={quote_attribute(name + '_transmission')}>\n"
        "    <type>transmission_interface/SimpleTransmission</type>\n"
        f"    <joint name={quote_attribute(name)}/>\n"
        f"    <actuator name={quote_attribute(name)}>"
        f'<drake:controller_gains p="{stiffness!r}" d="{damping!r}"/></actuator>\n'
        "  </transmission>"
    )

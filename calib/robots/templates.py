"""Robot descriptions to start from: the commented text of one of a plain URDF, and robots with loops.

A robot with loops is a URDF cut open, and the description that closes it, from a few lengths.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import yaml

from calib.base.errors import InputError, nearest
from calib.base.units import millimetres, quantity
from calib.robots.description import Description
from calib.robots.parametrisation import default_sections
from calib.robots.urdf.loop_mechanisms import BASE, Lengths, Plan, delta, five_bar, four_bar, stewart, three_rrr
from calib.robots.urdf.text import HELD_TYPES, UrdfText, robot_text

_TEXT = """\
# Robot description of {robot}. Lengths and angles are m and rad, or carry a unit: 0.04 mm, 1.5 deg.
urdf: {urdf}

# Joints with a motor, in the order of every joint vector. Measurement files have one column for each.
{remark}name_mot: {actuated}

# Closed loops: cut them open in the URDF, name the two frames that coincide, and constrain only the directions that
# the mechanism constrains (a planar five-bar about x: y and z). Passive joints are those of the loops without a motor.
# closed_loop: [[frame_a, frame_b]]
# type: [3d]                      # 3d: the points coincide; 6d: the whole frames
# closed_loop_axes: [[y, z]]
# home: {{{home}}}                # an assembled configuration, needed with loops: every joint of them

{measured}
# What may be wrong, and by how much (sigma, one standard deviation). `all` means every joint origin that moves a
# target; an entry with a joint's name overrides it. x, y, z: translation; rx, ry, rz: small rotations about the
# joint frame's axes.
# Joints on the way: {joints}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: {length}}}
  - {{origin: all, components: [rx, ry, rz], sigma: {angle}}}
# held: [{example}.x]             # keep some at nominal
# priors: false                   # let the measurements alone decide

{sigma}# Columns of foreign files, and what they stand for.
# columns: {{x1: "{column}_x [m]", j1: "{example} [deg]"}}
"""
_SIGMA = """\
# Standard deviation of one measured coordinate; left out, it is found from the residuals.
# sigma: 0.04 mm

"""
_BASE_ANYWHERE = """\
# The frame of the measurements: fixed to this link. 'unknown': found from the measurements (a tracker anywhere);
# 'known': measurements are in this link's frame, or in one that sees it at `xyz: [..]`, `rpy: [..]`.
base: {{frame: {base}, pose: unknown}}
"""
_BASE_KNOWN = """\
# Positions are told in the frame of this link. Nothing here sees where it stands in the room.
base: {{frame: {base}}}
"""
_POINT = """\
  # `xyz` is about where the point is on the link; `sigma`: how far off that may be.
  {point}: {{frame: {target}, xyz: [0 mm, 0 mm, 0 mm], position: unknown, sigma: 20 mm}}
"""
_PLAIN = f"""{_BASE_ANYWHERE}
# What is measured: columns <name>_x, <name>_y, <name>_z. `xyz` is about where the point is on the link; add
# `sigma: 10 mm` if you know how far off that may be, which helps where the last joints hardly turned.
targets:
  {{target}}: {{{{frame: {{target}}, xyz: [0 mm, 0 mm, 0 mm], position: unknown}}}}
"""


@dataclass(frozen=True)
class Measure:
    """A way to measure: what a description says of it, and the file that it fills.

    Attributes:
        text: Base, targets and instruments, as the description has them.
        point: Name of the measured point.
        comments: What to know while the file is filled, line by line; none of what writes a file of its own.
    """

    text: str
    point: str
    comments: tuple[str, ...]


MEASURES = {
    "tracker": Measure(
        f"""{_BASE_ANYWHERE}
targets:
{_POINT}
# A laser tracker: columns <name>_x, _y, _z. Noise: along its beam, and the angle across it; or one number: 0.04 mm.
instruments:
  reflector: {{{{kind: position, target: reflector, sigma: {{{{range: 0.02 mm, angle: 0.01 mrad}}}}}}}}
""",
        "reflector",
        (
            "one row for each pose: joint values as the controller shows them, and what the tracker reads",
            "write the units of your numbers in place of [mm] and [deg]; 60 poses or more, spread over all joints",
        ),
    ),
    "touch": Measure(
        f"""{_BASE_KNOWN}
targets:
  # The centre of the ball that sits in the sockets.
{_POINT}
# Sockets that stand somewhere on one plate: say where they are on it. Several, as far apart as you have them: their
# known distances give the robot its scale.
instruments:
  probe:
    kind: touch
    target: ball
    artefact:
      frame: {{base}}
      pose: unknown
      points: {{{{a: [0 mm, 0 mm, 0 mm], b: [200 mm, 0 mm, 0 mm], c: [0 mm, 150 mm, 0 mm]}}}}
      tolerance: 0.02 mm           # how well these distances are known
""",
        "ball",
        (
            "one row for each touch: joint values while the ball sits in a socket, and the name of the socket",
            "20 or more in each socket, with the tool turned as differently as the robot can",
        ),
    ),
    "ballbar": Measure(
        f"""{_BASE_KNOWN}
targets:
  # The centre of the ball that moves with the robot.
{_POINT}
# A ballbar or a draw wire: column <name>_distance. `xyz` is about where its fixed end stands.
instruments:
  ballbar:
    kind: distance
    target: ball
    end: {{{{frame: {{base}}, xyz: [500 mm, 0 mm, 0 mm], position: unknown, sigma: 500 mm}}}}
    sigma: 0.005 mm
""",
        "ball",
        (
            "one row for each pose: joint values, and the distance of the ball from the fixed end",
            "50 poses or more around the end; with other ends, add an instrument and its column for each",
        ),
    ),
    "rosbag": Measure(
        f"""{_BASE_ANYWHERE}
targets:
{_POINT}
# Read from a ROS 2 bag: joints from sensor_msgs/JointState by their names, and the topic /reflector
# (geometry_msgs/PointStamped, PoseStamped or TransformStamped) [m]. Of another topic, say under `columns` what its
# columns are, such as vicon/tool_x: reflector_x. The robot must stand still at each reading; needs rosbags.
instruments:
  reflector: {{{{kind: position, target: reflector}}}}
""",
        "reflector",
        (),
    ),
}
"""What `calib init --measure` knows, by name."""


def description_text(urdf: UrdfText, description: Description, remark: str = "", measure: str | None = None) -> str:
    """Return the YAML text of a plain URDF's description, with comments.

    Args:
        urdf: The URDF.
        description: What it stands for.
        remark: What to say about the joints that it leaves out.
        measure: How is measured, of `MEASURES`; positions of the target if not given.
    """
    target = next(iter(description.targets))
    lengths, angles = default_sections()
    parent = {joint.child: joint for joint in urdf.joints}
    link = target
    joints: list[str] = []
    while link != description.base.frame:
        joints.insert(0, parent[link].name)
        link = parent[link].parent
    moving = [joint.name for joint in urdf.joints if joint.type not in HELD_TYPES]

    def quoted(value: object) -> str:  # as an entry of a list, so that commas and brackets are quoted too
        text = str(yaml.safe_dump([value], default_flow_style=True, allow_unicode=True, width=10**6))
        return text.strip()[1:-1]

    how = None if measure is None else MEASURES[measure]
    point = target if how is None else how.point
    measured = (_PLAIN if how is None else how.text).format(
        base=quoted(description.base.frame), target=quoted(target), point=point
    )
    remark = " ".join(remark.split())
    lines = textwrap.wrap(remark[:1].upper() + remark[1:], 116, break_long_words=False, break_on_hyphens=False)
    return _TEXT.format(
        remark="".join(f"# {line}\n" for line in lines),
        robot=" ".join(urdf.name.split()) or "a robot",
        urdf=quoted(description.urdf),
        actuated=quoted(list(description.name_mot)),
        home=", ".join(f"{quoted(name)}: 0" for name in moving[:2]),
        measured=measured,
        sigma=_SIGMA if how is None else "",
        column=quoted(target) if how is None else point,
        joints=" ".join(", ".join(joints).split()),
        length=lengths.sigma,
        angle=angles.sigma,
        example=quoted(description.name_mot[0]),
    )


@dataclass(frozen=True)
class LoopTemplate:
    """A kind of mechanism.

    Attributes:
        what: In a few words.
        lengths: Every length with its default [m].
        build: Its function.
    """

    what: str
    lengths: Lengths
    build: Callable[[Lengths], Plan]


TEMPLATES = {
    "four_bar": LoopTemplate(
        "planar four-bar", {"ground": 0.4, "crank": 0.1, "coupler": 0.35, "rocker": 0.25}, four_bar
    ),
    "five_bar": LoopTemplate("planar five-bar", {"motor_distance": 0.2, "proximal": 0.2, "distal": 0.3}, five_bar),
    "3rrr": LoopTemplate(
        "planar 3-RRR", {"base_radius": 0.4, "platform_radius": 0.1, "proximal": 0.2, "distal": 0.25}, three_rrr
    ),
    "delta": LoopTemplate(
        "delta with a pair of rods on each arm",
        {"base_radius": 0.15, "platform_radius": 0.05, "upper_arm": 0.2, "rod": 0.5, "rod_distance": 0.1},
        delta,
    ),
    "stewart": LoopTemplate(
        "Stewart platform, 6-UPS",
        {"base_radius": 0.3, "platform_radius": 0.2, "base_pair": 0.1, "platform_pair": 0.08, "height": 0.4},
        stewart,
    ),
}
"""By the name that the command line gives them."""


def read_lengths(name: str, given: Iterable[str]) -> dict[str, float]:
    """Return a template's lengths [m], those of `given` (NAME=VALUE, with a unit) in place of the defaults.

    Raises:
        InputError: No such length, one given twice, or one that is not a positive length.
    """
    lengths, seen = dict(TEMPLATES[name].lengths), set()
    for text in given:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise InputError(f"--length {text}: is not NAME=VALUE, such as {next(iter(lengths))}=200mm")
        if key not in lengths:
            raise InputError(f"--length {text}: template {name} has no length '{key}'{nearest(key, lengths)}")
        if key in seen:
            raise InputError(f"--length {text}: '{key}' is given twice")
        seen.add(key)
        lengths[key] = quantity(value, "length", f"--length {key}")
        if lengths[key] <= 0:
            raise InputError(f"--length {text}: must be greater than 0")
    return lengths


def loop_files(name: str, lengths: Lengths, urdf: str) -> tuple[str, str]:
    """Return the text of a template's URDF and of its description.

    Args:
        name: Of the template.
        lengths: Every length of it [m].
        urdf: How the description names the URDF.

    Raises:
        InputError: Nothing can be assembled from these lengths.
    """
    template = TEMPLATES[name]
    said = ", ".join(f"{key} {_mm(value)}" for key, value in lengths.items())
    try:
        plan = template.build(lengths)
    except InputError as error:
        raise InputError(f"template {name} with {said}: {error}") from None
    return robot_text(name, f"{template.what}, cut open: {said}", plan.links, plan.joints), _description(
        plan, f"{template.what}: {said}", urdf
    )


def _description(plan: Plan, title: str, urdf: str) -> str:
    pairs = ", ".join(f"[{one}, {other}]" for one, other in plan.loops)
    targets = "".join(
        f"  {name}: {{frame: {frame}, xyz: [{', '.join(map(_mm, xyz))}], position: unknown, sigma: 2 mm}}\n"
        for name, (frame, xyz) in plan.targets.items()
    )
    free = "".join(
        f"  - {{origin: {origin}, components: [{part}], sigma: {'5 mrad' if part.startswith('r') else '1 mm'}}}\n"
        for origin, components in plan.free
        for part in _of_one_unit(components)
    )
    return f"""\
# Robot description of a {title}.
urdf: {json.dumps(urdf, ensure_ascii=False)}

# Joints with a motor, in the order of every joint vector. Measurement files have one column for each.
name_mot: [{", ".join(plan.motors)}]

# The loops, cut open in the URDF: these frames coincide, in the directions that the mechanism holds.
closed_loop: [{pairs}]
type: [{", ".join(["3d"] * len(plan.loops))}]
closed_loop_axes: [{", ".join([f"[{plan.axes}]"] * len(plan.loops))}]

# An assembled configuration [m, rad]: it decides between the ways of assembling.
home:
{"".join(f"  {name}: {value!r}" + chr(10) for name, value in plan.home.items())}
# A tracker anywhere; 'known' if measurements are in this link's frame.
base: {{frame: {BASE}, pose: unknown}}

# What is measured: columns <name>_x, <name>_y, <name>_z; about where each point is on its link.
targets:
{targets}
# What may be wrong, and by how much (sigma, one standard deviation).
parametrisation:
{free}
# Standard deviation of one measured coordinate; left out, it is found from the residuals.
# sigma: 0.04 mm
"""


def _of_one_unit(components: str) -> list[str]:
    """Components `x, y, rz` as `x, y` and `rz`: an entry has one sigma."""
    names = components.split(", ")
    parts = ([name for name in names if len(name) == 1], [name for name in names if len(name) > 1])
    return [", ".join(part) for part in parts if part]


def _mm(value: float) -> str:
    return f"{millimetres(value):.9g} mm"

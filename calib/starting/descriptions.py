"""Robot descriptions to start from: text with comments for a plain URDF, for each way to measure."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import yaml

from calib.core.base.sections import COMPONENTS
from calib.core.robots.description import Description
from calib.core.robots.parametrisation import default_sections
from calib.core.robots.urdf.reader import HELD_TYPES
from calib.core.robots.urdf.text import UrdfText

_TEXT = """\
# Robot description of {robot}. Lengths and angles are m and rad, or carry a unit: 0.04 mm, 1.5 deg.
urdf: {urdf}
{xacro}
# Joints with a motor, in the order of every joint vector. Measurement files have one column for each.
{remark}name_mot: {actuated}

{loops}
{measured}
# What may be wrong, and by how much (sigma, one standard deviation). `all` means every joint origin that moves a
# target; an entry with a joint's name overrides it. x, y, z: translation; rx, ry, rz: small rotations about the
# joint frame's axes.
# Joints on the way: {joints}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: {length}}}
  - {{origin: all, components: [rx, ry, rz], sigma: {angle}}}
{held}# priors: false                   # let the measurements alone decide

# What the robot must not touch, and parts of its tool (frame: a link that moves); then only free poses are planned.
# obstacles:
#   floor: {{plane: true, frame: {base}}}     # below z = 0 of the base; xyz: [0, 0, -0.8 m] lowers it
#   table: {{box: [1.2 m, 0.8 m, 40 mm], frame: {base}, xyz: [0.9 m, 0, -0.1 m], clearance: 20 mm}}

{sigma}# Columns of foreign files, and what they stand for.
# columns: {{x1: "{column}", j1: "{example} [deg]"}}
"""
_NO_LOOPS = """\
# Closed loops: cut them open in the URDF, name the two frames that coincide, and constrain only the directions that
# the mechanism constrains (a planar five-bar about x: y and z). Passive joints are those of the loops without a motor.
# closed_loop: [[frame_a, frame_b]]
# type: [3d]                      # 3d: the points coincide; 6d: the whole frames
# closed_loop_axes: [[y, z]]
{home}"""
_HOME = """\
# home: {{{home}}}                # an assembled configuration, needed with loops: every joint of them
"""
_HOME_WITHIN_LIMITS = """\
# Where the robot starts [m, rad], with loops an assembled configuration: the middle of their limits for joints that
# cannot be at 0; the others are at 0.
home: {home}
"""
_LOOPS = """\
# Closed loops, cut open: these frames coincide, in the directions that the mechanism constrains. Passive joints are
# those of the loops without a motor.
closed_loop: {pairs}
type: {types}                       # 3d: the points coincide; 6d: the whole frames
closed_loop_axes: {axes}
# An assembled configuration [m, rad]: it decides between the ways of assembling.
home: {home}
"""
_HELD = """\
# held: [{example}.x]             # keep some at nominal
"""
_HELD_ENDS = """\
# Kept at nominal: the place of the first joint, and of the last one along its axis. Measurements do not separate
# them from the places of board and camera.
held: {held}
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
# Positions are given in the frame of this link. No instrument here shows where it stands in the room.
base: {{frame: {base}}}
"""
_POINT = """\
  # `xyz` is about where the point is on the link; `sigma`: how far off that may be.
  {point}: {{frame: {target}, xyz: [0 mm, 0 mm, 0 mm], position: unknown, sigma: 20 mm}}
"""
_PLAIN = f"""{_BASE_ANYWHERE}
# What is measured: columns <name>_x, <name>_y, <name>_z. `xyz` is about where the point is on the link; `sigma`: how
# far off that may be. A smaller one helps where the last joints hardly turned.
targets:
  {{target}}: {{{{frame: {{target}}, xyz: [0 mm, 0 mm, 0 mm], position: unknown, sigma: 500 mm}}}}
"""


@dataclass(frozen=True)
class Measure:
    """A way to measure: its part of a description, and the file that it fills.

    Attributes:
        text: Base, targets and instruments, as the description has them.
        point: Name of the measured point.
        comments: Advice for filling in the file, line by line; none if a program writes the file.
        column: A column of readings, as an example; that of positions of the point if not given.
        read_apart: Whether readings come in another file, so that this one has the joint values alone; they are made
            between base and end of the robot, at unknown places on both.
    """

    text: str
    point: str
    comments: tuple[str, ...]
    column: str = ""
    read_apart: bool = False


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
    "camera": Measure(
        f"""{_BASE_KNOWN}
targets:
  # The point whose accuracy is reported.
  tool: {{{{frame: {{target}}}}}}
  # Roughly where the first corner of the board is; x to the right and y down on the paper, z into it. Write where
  # yours is: poses are proposed from which the camera sees it. This place is seen from many poses.
  board:
    {{{{frame: {{base}}, xyz: {{board_xyz}}, rpy: {{board_rpy}}, position: unknown, orientation: unknown}}}}

# A camera on the robot that sees it; for a camera beside the robot and the board on it, exchange the two frames.
instruments:
  camera:
    kind: pixel
    target: board
    board: {{board_file}}    # {{board_text}}
    # Its optical frame, about: x to the right and y down in the image, z out of the lens.
    camera: {{{{frame: {{target}}, xyz: [0 mm, 0 mm, 0 mm], rpy: [0 deg, 0 deg, 0 deg], pose: unknown}}}}
    image: {{image}}
    intrinsics: {{intrinsics}}
    # How far off they may be: they are found with the rest. Leave out those that you know.
    unknown_intrinsics: {{unknown_intrinsics}}
    # sigma: 0.2                    # noise of a coordinate [px]; left out, it is found from the residuals
    # focus: [200 mm, 800 mm]      # sharp from .. to ..: no poses are proposed beyond
""",
        "board",
        (
            "one row for each photograph: its name as calib detect writes it, and the joint values of the controller",
            "write the units of your numbers in place of [deg]; 30 photographs or more, with the robot at rest",
        ),
        column="camera_u",
        read_apart=True,
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
# (geometry_msgs/PointStamped, PoseStamped or TransformStamped) [m]. If your topic has another name, translate its
# columns under `columns`: vicon/tool_x: reflector_x. The robot must stand still at each reading; needs rosbags.
instruments:
  reflector: {{{{kind: position, target: reflector}}}}
""",
        "reflector",
        (),
    ),
}
"""Ways to measure of `calib init --measure`, by name."""


def description_text(
    urdf: UrdfText,
    description: Description,
    remark: str = "",
    measure: str | None = None,
    words: Mapping[str, str] | None = None,
) -> str:
    """Return the YAML text of a plain URDF's description, with comments, and a remark on the joints that it leaves out.

    `measure` is a name in `MEASURES` (positions of the target if not given), `words` its further texts, as YAML.
    """
    target = link = next(iter(description.targets))
    lengths, angles = default_sections()
    parent = {joint.child: joint for joint in urdf.joints}
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
        base=quoted(description.base.frame), target=quoted(target), point=point, **(words or {})
    )
    remark = " ".join(remark.split())
    home = _HOME.format(home=", ".join(f"{quoted(name)}: 0" for name in moving[:2]))
    if within := _home_within_limits(urdf, description.name_mot):
        home = _HOME_WITHIN_LIMITS.format(home=quoted(within))
    loops = _NO_LOOPS.format(home=home)
    if description.closed_loop:
        loops = _LOOPS.format(
            pairs=quoted([list(pair) for pair in description.closed_loop]),
            types=quoted(list(description.type)),
            axes=quoted([list(description.loop_axes(k)) for k in range(len(description.type))]),
            home=quoted(description.home),
        )
    lines = textwrap.wrap(remark[:1].upper() + remark[1:], 116, break_long_words=False, break_on_hyphens=False)
    return _TEXT.format(
        remark="".join(f"# {line}\n" for line in lines),
        robot=" ".join(urdf.name.split()) or "a robot",
        urdf=quoted(description.urdf),
        xacro=f"xacro: {quoted(description.xacro)}\n" if description.xacro else "",
        actuated=quoted(list(description.name_mot)),
        loops=loops,
        measured=measured,
        sigma=_SIGMA if how is None else "",
        base=quoted(description.base.frame),
        column=(how and how.column) or f"{quoted(target) if how is None else point}_x [m]",
        joints=" ".join(", ".join(joints).split()),
        length=lengths.sigma,
        angle=angles.sigma,
        held=_HELD_ENDS.format(held=quoted(_end_components(urdf, joints)))
        if how is not None and how.read_apart
        else _HELD.format(example=quoted(description.name_mot[0])),
        example=quoted(description.name_mot[0]),
    )


def schema_text() -> str:
    """Return the JSON schema of robot descriptions, for editors, made of the same classes that read them."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **Description.model_json_schema()}
    text = json.dumps(schema, indent=1) + "\n"
    return text.replace('"oneOf":', '"anyOf":')  # entries of several kinds are told apart by a key that all have


def _home_within_limits(urdf: UrdfText, joints: Sequence[str]) -> dict[str, float]:
    """Middles of the limits of the joints that cannot be at 0 [m or rad], by name."""
    limits = zip(joints, *(ends.tolist() for ends in urdf.limits(joints)), strict=True)
    return {name: float(f"{(low + high) / 2:.6g}") for name, low, high in limits if not low <= 0.0 <= high}


def _end_components(urdf: UrdfText, chain: Sequence[str]) -> list[str]:
    """Parameters of a chain of joints that the unknown places of its ends absorb, by name."""
    by_name = {joint.name: joint for joint in urdf.joints}
    moving = [by_name[name] for name in chain if by_name[name].type not in HELD_TYPES]
    result = [f"{moving[0].name}.{component}" for component in COMPONENTS]
    along = [axis for axis, part in zip("xyz", moving[-1].axis, strict=True) if abs(part) == 1.0]
    if len(moving) > 1 and along:
        shifts = "xyz" if moving[-1].type == "prismatic" else along
        result += [f"{moving[-1].name}.{component}" for component in (*shifts, f"r{along[0]}")]
    return result

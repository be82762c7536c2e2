"""A route as a program for the robot's controller: moves by joint values, with a dwell and a digital output at stops.

Every program first asks the operator whether the robot stands at the start of the route. A stop is a move that ends at
rest, a comment with its pose name and clearance, a dwell for the arm to settle, and an output that is on while the
instrument reads. Corners of paths are moves without a stop. Numbers have enough digits for 1e-7 rad.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.units import in_unit, millimetres
from calib.core.data.measurement_columns import header, pose_columns
from calib.core.data.table_writing import format_table
from calib.motion.route import Route, Stop

_ROBOT_AXES = 6
THIRD_JOINT = ("j3", "j2+j3")
"""The third joint of a robot file on a FANUC controller, whose J3 counts from the horizontal: J3, or J2 + J3."""


@dataclass(frozen=True)
class Motion:
    """Motion of a program.

    Attributes:
        name: Name of the program; letters, digits and underscores.
        speed: Fraction of the speed that the controller allows, 0 to 1.
        joint_speed: Speed of the fastest joint, if the program states it [rad/s or m/s].
        dwell: Time at each stop before the instrument reads [s].
        reading: Time with the output on [s].
        output: Number of the digital output, or None.
        third_joint: Member of `THIRD_JOINT`, for FANUC.
    """

    name: str
    speed: float = 0.2
    joint_speed: float = 0.5
    dwell: float = 1.0
    reading: float = 1.0
    output: int | None = 0
    third_joint: str = "j3"


@dataclass(frozen=True)
class Language:
    """A language of programs: the suffix of its files, and whether its joint moves are only for six turning joints."""

    suffix: str
    write: Callable[[Route, Motion], str]
    six_axes: bool = True


@dataclass(frozen=True)
class _Words:
    """Text templates of a controller's language for the steps of a route.

    Attributes:
        begin, end: Lines before and after the stops, with {name}, {question} and {percent}.
        move: A move, with {joints}; {k}, its number from 1; {speed} [rad/s], {along} [mm/s] or {percent}.
        joint: Text of a joint, with {k}, from 1, and {value}.
        remark: A comment.
        wait: A dwell, with its time [s].
        output: Setting of an output, with its number and value.
        states: Values of an output on and off.
        unit: Unit of joint values.
    """

    begin: str
    end: str
    move: str
    joint: str
    remark: str
    wait: str
    output: str
    states: tuple[str, str]
    unit: str = "deg"

    def joints(self, values: FloatArray) -> str:
        """Return joint values (n,) [rad] as text of a move."""
        return ", ".join(self.joint.format(k=k, value=v + 0.0) for k, v in enumerate(in_unit(values, self.unit), 1))

    def text(self, route: Route, motion: Motion) -> str:
        """Return a route as a program."""
        return "\n".join(self.lines(route, motion, _question(route))) + "\n"

    def lines(self, route: Route, motion: Motion, question: str) -> list[str]:
        """Return the lines of a program, with a question before the first move."""
        along = max(10, round(100 * motion.speed) * 10) if motion.speed < 1 else 1000
        given = {"name": motion.name, "question": question, "speed": motion.joint_speed, "along": along}
        given |= {"percent": max(1, round(100 * motion.speed))}
        moves = itertools.count(1)

        def move(joints: FloatArray) -> str:
            return self.move.format(joints=self.joints(joints), k=next(moves), **given)

        lines = self.begin.format(**given).split("\n")
        for stop in route.stops:
            lines += [move(corner) for corner in stop.corners]
            lines += [self.remark.format(_remark(stop)), move(stop.joints), self.wait.format(motion.dwell)]
            if motion.output is not None:
                on, off = (self.output.format(motion.output, state) for state in self.states)
                lines += [on, self.wait.format(motion.reading), off]
        return [*lines, *self.end.split("\n")]


def write_program(route: Route, language: str, motion: Motion) -> str:
    """Return a route as a program.

    Raises:
        InputError: The language has no joint moves for this robot.
    """
    turning = np.all(route.robot.mechanism.turning)
    if LANGUAGES[language].six_axes and (len(route.robot.joint_names) != _ROBOT_AXES or not turning):
        raise InputError(
            f"--format {language}: its programs move six turning joints, and this robot has"
            f" {', '.join(route.robot.joint_names)}; write csv or ros2"
        )
    return LANGUAGES[language].write(route, motion)


def _question(route: Route, start: FloatArray | None = None) -> str:
    """Question to the operator before the first move, in letters that every controller shows.

    `start` are the route's first joint values as the controller counts them, if different [rad].
    """
    values = ", ".join(f"{value:.1f}" for value in in_unit(route.start if start is None else start, "deg"))
    return (
        f"Robot must stand at {values} deg. Nothing moves before you confirm."
        f" The first stop is {_plain(route.stops[0].name)}"
    )


def _plain(name: str) -> str:
    return re.sub(r"[^\w .:+-]", "_", name, flags=re.ASCII)


def _remark(stop: Stop) -> str:
    """Pose name and clearance of a stop."""
    if not np.isfinite(stop.clearance):
        return f"pose {_plain(stop.name)}"
    at_stop, on_the_way = (
        int(millimetres(value)) for value in (stop.clearance, min(stop.clearance, stop.path_clearance))
    )
    clearance = f"clearance {at_stop} mm ({_plain(stop.pair)}), on the way {on_the_way} mm"
    return f"pose {_plain(stop.name)}, {clearance}"


_URSCRIPT = _Words(
    begin='def {name}():\n  popup("{question}", title="{name}", blocking=True)',
    end="end",
    move="  movej([{joints}], a=1.0, v={speed:g})",
    joint="{value:.9f}",
    remark="  # {}",
    wait="  sleep({:g})",
    output="  set_standard_digital_out({}, {})",
    states=("True", "False"),
    unit="rad",
)
_RAPID = _Words(
    begin='MODULE {name}\n  PROC main()\n    TPWrite "{question:.80}";\n    ! {question}\n    Stop;',
    end="  ENDPROC\nENDMODULE",
    move="    MoveAbsJ [[{joints}], [9E9, 9E9, 9E9, 9E9, 9E9, 9E9]], [{along}, 500, 5000, 1000], fine, tool0;",
    joint="{value:.7f}",
    remark="    ! {}",
    wait="    WaitTime {:g};",
    output="    SetDO do{}, {};",
    states=("1", "0"),
)
_KRL = _Words(
    begin="DEF {name}()\n; {question}\nHALT\nBAS(#INITMOV, 0)\nBAS(#VEL_PTP, {percent})",
    end="END",
    move="PTP {{AXIS: {joints}}}",
    joint="A{k} {value:.7f}",
    remark="; {}",
    wait="WAIT SEC {:g}",
    output="$OUT[{}] = {}",
    states=("TRUE", "FALSE"),
)
_FANUC = _Words(
    begin="!{question:.100}\nPAUSE",
    end="",
    move="J P[{k}] {percent}% FINE",
    joint="J{k} = {value:.7f} deg",
    remark="!{}",
    wait="WAIT {:.2f}(sec)",
    output="DO[{}]={}",
    states=("ON", "OFF"),
)


def _fanuc(route: Route, motion: Motion) -> str:
    """Numbered lines, then the positions of all moves."""
    coupled = (np.arange(len(route.start)) == 2) * (motion.third_joint == THIRD_JOINT[1])

    def counted(joints: FloatArray) -> FloatArray:
        return joints - joints[1] * coupled

    lines = _FANUC.lines(route, motion, _question(route, counted(route.start)))[:-1]
    numbered = [f"{number:4d}:  {line} ;" for number, line in enumerate(lines, 1)]
    places = []
    for number, joints in enumerate((q for stop in route.stops for q in (*stop.corners, stop.joints)), 1):
        values = _FANUC.joints(counted(joints)).split(", ")
        body = ",\n\t".join(", ".join(values[k : k + 3]) for k in (0, 3))
        places.append(f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t{body}\n}};")
    head = f"/PROG  {motion.name.upper()}\n/ATTR\nOWNER = MNEDITOR;\n/APPL\n/MN\n"
    return head + "\n".join(numbered) + "\n/POS\n" + "\n".join(places) + "\n/END\n"


def _ros2(route: Route, motion: Motion) -> str:
    """A `trajectory_msgs/JointTrajectory` that rests at each stop for dwell and reading; `stops` has these times."""
    points, stops, time = [{"positions": route.start.tolist(), "time_from_start": _duration(0.0)}], [], 0.0
    here = route.start
    for stop in route.stops:
        for goal in (*stop.corners, stop.joints):
            time += max(float(np.max(np.abs(goal - here))) / motion.joint_speed, 0.1)
            points.append({"positions": goal.tolist(), "time_from_start": _duration(time)})
            here = goal
        stops.append(
            {
                "pose": stop.name,
                "arrival_s": round(time, 3),
                "read_s": round(time + motion.dwell, 3),
                "remark": _remark(stop),
            }
        )
        time += motion.dwell + motion.reading
        points.append({"positions": here.tolist(), "time_from_start": _duration(time)})
    zero = [0.0] * len(route.robot.joint_names)
    for point in points:  # at rest at every point, so that a controller with splines moves straight
        point |= {"velocities": zero, "accelerations": zero}
    content = {
        "confirm": _question(route),
        "joint_names": list(route.robot.joint_names),
        "points": points,
        "stops": stops,
    }
    return json.dumps(content, indent=1) + "\n"


def _duration(seconds: float) -> dict[str, int]:
    nanoseconds = round(seconds * 1e9)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def _csv(route: Route, motion: Motion) -> str:
    """Every point in order; corners of paths are `via` points without a dwell."""
    rows = [
        (stop.name if k == len(stop.corners) else f"{stop.name} via {k + 1}", q, k == len(stop.corners))
        for stop in route.stops
        for k, q in enumerate((*stop.corners, stop.joints))
    ]
    columns = pose_columns(route.robot, [name for name, *_ in rows], np.array([q for _, q, _ in rows]))
    columns["dwell [s]"] = [motion.dwell if last else 0.0 for *_, last in rows]
    return format_table(list(columns.items()), (_question(route),))


def table_to_fill_in(route: Route) -> str:
    """Return the stops as a table, with empty columns for the readings of the instruments."""
    columns = pose_columns(route.robot, [stop.name for stop in route.stops], route.joints)
    for instrument in route.robot.instruments:
        numbers = [header(column.name, column.dimension) for column in instrument.columns()]
        for name in (*numbers, *instrument.text_columns()):
            columns[name] = [""] * len(route.stops)
    comment = "write the readings of each pose here; an instrument's own log is joined by its column 'pose'"
    return format_table(list(columns.items()), (comment,))


LANGUAGES = {
    "urscript": Language(".script", _URSCRIPT.text),
    "rapid": Language(".mod", _RAPID.text),
    "krl": Language(".src", _KRL.text),
    "fanuc": Language(".ls", _fanuc),
    "ros2": Language(".json", _ros2, six_axes=False),
    "csv": Language(".csv", _csv, six_axes=False),
}

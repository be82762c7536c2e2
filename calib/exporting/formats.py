"""Writing a robot in one of the formats, as `calib export` does."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from calib.core.base.errors import InputError, nearest
from calib.core.base.files import check_file, check_folder, write_files, write_folder
from calib.core.results.urdf import urdf_bytes
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import formats, held_of, loses, remarks_on_file, robot_for
from calib.core.robots.loading import RobotLike, as_robot
from calib.core.robots.robot import Robot
from calib.core.robots.urdf.writing import quote_attribute
from calib.exporting.closed_model import closed_model
from calib.exporting.drake import drake_bytes
from calib.exporting.file_formats import LANGUAGES, function_file
from calib.exporting.gap import Gap, loop_gaps
from calib.exporting.joint_tables import joint_table_files, lost_by_tables, require_own_terms
from calib.exporting.mjcf import Mjcf
from calib.exporting.toolbox import toolbox_yaml

_WITH_URDF = ("urdf", "drake", "toolbox")
_MESH = re.compile(rb"""<mesh\b[^>]*?\sfilename\s*=\s*["'](?=[^"'])(?!/|[^"']*://)""")
_UNTOUCHED = ("urdf", "toolbox")  # their URDF gets a comment only if there is something to say
JOINT_TABLES = "joint-tables"
"""The format that is a folder of files."""
_ENDINGS = {".urdf": "urdf", ".xml": "mjcf", ".mjcf": "mjcf", ".xacro": "xacro", ".c": "c"}


def format_of(path: Path | str) -> str:
    """Return the format of a file by its suffix; `InputError` for an ambiguous or unknown suffix."""
    ending = Path(path).suffix.lower()
    if ending not in _ENDINGS:
        raise InputError(f"{path}: its ending does not say the format; give it ({', '.join(formats())})")
    return _ENDINGS[ending]


def export(
    robot: RobotLike,
    path: Path | str,
    format: str | None = None,
    *,
    free_slide: bool = False,
    meshes: str | None = None,
    provenance: Sequence[str] | None = None,
    note: Callable[[str], None] = lambda text: None,
    force: bool = False,
) -> tuple[Gap, ...]:
    """Write a robot with its current values for another program.

    The file gets the best robot that its format holds. For a format without joint terms, this is the best robot without
    them that a fit found (`calib.core.robots.accuracy_of_files`).

    Args:
        format: `urdf`: the URDF with only the edited origins changed. `mjcf`: for MuJoCo, Pinocchio and Drake, loops
            closed. `drake`: URDF with Drake's ball constraints. `toolbox`: robot.yaml for toolbox-parallel-robots, with
            the URDF beside it under the same name. `dh`, `mdh`: Denavit-Hartenberg tables, standard and modified.
            `ur-kinematics`: for Universal Robots' ROS description. `joint-offsets`: a sign and a zero for each joint.
            `xacro`: joint origins as properties. `joint-tables`: a folder of tables of each joint's error
            (see `calib.exporting.joint_tables`). `klipper`, `marlin`, `duet`: lines for the settings of a delta
            printer. `numpy`, `c`, `jax`, `torch`, `casadi`: the whole model as functions in that language (see
            `calib.exporting.functions`).
        path: File to write, or folder of `joint-tables`.
        free_slide: Formats `mjcf` and `drake`: a free joint for each direction that a closure leaves free.
        meshes: Formats with a URDF (`urdf`, `drake`, `toolbox`): prefix of relative mesh paths, such as
            `package://my_robot`, so that they do not depend on the file's folder.
        provenance: Lines on the origin of the numbers for the comment; without them, formats `urdf` and `toolbox` put
            no comment into a URDF that holds the whole robot.
        note: Called with remarks for the user, such as an omitted mesh, or the content of a format for controllers and
            the error that remains.
        force: Write the file even if its robot is worse than the nominal one, or belongs to joint terms that
            the format cannot hold; and replace files that this program did not write, or inputs of the robot.

    Returns:
        The gaps that 3D constraints would have to absorb, for each direction that a closure leaves free.

    Raises:
        InputError: Unknown format, an option that the format does not have, a path that cannot be written, an existing
            file that must not be replaced, or loops that the format cannot express.
        ComputationError: The robot in the format is worse than the nominal one at the judging poses, or unknown because
            no fit was made without the terms that it cannot hold; or no pose with closed loops is known.
    """
    robot = as_robot(robot)
    format, path = format or format_of(path), Path(path)
    all_formats = formats()
    if format not in all_formats:
        raise InputError(f"format '{format}': unknown{nearest(format, all_formats)}; the path comes before the format")
    if free_slide and format not in ("mjcf", "drake"):
        raise InputError(f"format '{format}' has no variant with free slides; mjcf and drake have one")
    if meshes and format not in _WITH_URDF:
        raise InputError(f"format '{format}' has no mesh paths to change; only {', '.join(_WITH_URDF)} have")
    sources = (robot.urdf.path, robot.path)
    if format == JOINT_TABLES:
        _write_tables(robot, path, provenance or (), note, force=force)
        return ()
    with_urdf = format == "toolbox" and path.name
    urdf = path.with_suffix(".urdf") if with_urdf else path
    if with_urdf and path == urdf:
        raise InputError(f"{path}: format 'toolbox' writes a YAML file and the URDF beside it; name the YAML file")
    for file in {urdf, path}:
        check_file(file, inputs=sources, force=force)
    holds = held_of(robot, format)
    file_robot, remarks = robot_for(robot, format, force=force), remarks_on_file(robot, holds)
    lines: list[str] | None = [*remarks, *(provenance or ())]
    if loses(robot, holds):
        for line in remarks:
            note(line)
    elif provenance is None and format in _UNTOUCHED:
        lines = None
    files = _contents(file_robot, format, path, free_slide, lines, note, force=force)
    if meshes:
        files[urdf] = _with_mesh_prefix(files[urdf], meshes)
    write_files(files, comment=all_formats[format].comment, inputs=sources, force=force)
    return () if free_slide or all_formats[format].write or format in LANGUAGES else loop_gaps(file_robot)


def _with_mesh_prefix(source: bytes, prefix: str) -> bytes:
    """URDF bytes with a prefix before every mesh path that is relative to the URDF."""
    start = quote_attribute(prefix.rstrip("/") + "/")[1:-1].encode("ascii", "xmlcharrefreplace")
    return _MESH.sub(lambda match: match.group() + start, source)


def _write_tables(
    robot: Robot, path: Path, provenance: Sequence[str], note: Callable[[str], None], *, force: bool
) -> None:
    check_folder(path, force=force)
    require_own_terms(robot)
    file_robot, remarks = robot_for(robot, JOINT_TABLES, force=force), remarks_on_file(robot, Holds.TABLES)
    left = lost_by_tables(robot)
    files = joint_table_files(file_robot, [*remarks, *left, *provenance])
    for line in [*(remarks if loses(robot, Holds.TABLES) else ()), *left]:
        note(line)
    write_folder(path, files, inputs=(robot.urdf.path, robot.path), force=force)


def _contents(
    robot: Robot,
    file_format: str,
    path: Path,
    free_slide: bool,
    provenance: Sequence[str] | None,
    note: Callable[[str], None],
    *,
    force: bool,
) -> dict[Path, bytes]:
    if file_format == "urdf":
        return {path: urdf_bytes(robot, provenance)}
    if write := formats()[file_format].write:
        made = write(robot, provenance or ())
        note(made.statement)
        return {path: made.content}
    if file_format in LANGUAGES:
        return {path: function_file(robot, file_format, provenance or ())}
    if file_format == "mjcf":
        written = Mjcf(closed_model(robot, free_slide=free_slide), path, provenance or ())
        for text in written.notes:
            note(text)
        if written.meshes:
            folder = next(iter(written.meshes)).parent
            write_folder(folder, {mesh.name: content for mesh, content in written.meshes.items()}, force=force)
            note(f"meshes that MuJoCo cannot read were converted into {folder}; keep that folder beside {path.name}")
        return {path: written.content}
    if file_format == "drake":
        return {path: drake_bytes(closed_model(robot, free_slide=free_slide), provenance or ())}
    urdf = path.with_suffix(".urdf")
    return {urdf: urdf_bytes(robot, provenance), path: toolbox_yaml(robot, urdf.name, provenance or ())}

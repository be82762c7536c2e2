"""Mesh files of a URDF, by their names in it."""

from __future__ import annotations

import re
from pathlib import Path

from calib.core.base.files import folders_in_variable


def find_mesh(filename: str, urdf_path: str) -> Path | None:
    """Return the path of a mesh, or None: relative to the URDF, or a package:// path below a folder above it.

    Folders of ROS_PACKAGE_PATH and `share` of AMENT_PREFIX_PATH are searched as well.
    """
    folder = Path(urdf_path).resolve().parent
    name = filename.removeprefix("file://")
    if "://" not in name:
        mesh = folder / name  # an absolute name stays as it is
        return mesh if mesh.is_file() and may_read_mesh(filename, mesh, urdf_path) else None
    if not name.startswith("package://"):
        return None
    inside = name.removeprefix("package://")
    places = [root / inside for root in (folder, *folder.parents, *_ros_folders())]
    return next((p for p in places if p.is_file() and may_read_mesh(filename, p, urdf_path)), None)


def may_read_mesh(filename: str, mesh: Path, urdf_path: str) -> bool:
    """Return whether a mesh file may be read under its name in the URDF, which is untrusted.

    With `..`, a name may lead from the URDF's folder only to the folder above, which often has `meshes` beside `urdf`;
    to the URDF's ROS package; and to the folders of ROS.
    """
    if ".." not in re.split(r"[/\\]", filename):
        return True
    above = Path(urdf_path).resolve().parent.parent
    package = next((folder for folder in (above, *above.parents) if (folder / "package.xml").is_file()), above)
    return any(mesh.resolve().is_relative_to(root.resolve()) for root in (above, package, *_ros_folders()))


def _ros_folders() -> list[Path]:
    shares = (Path(prefix, "share") for prefix in folders_in_variable("AMENT_PREFIX_PATH"))
    return [*map(Path, folders_in_variable("ROS_PACKAGE_PATH")), *shares]

"""MedRUE: the robot, its equations in closed form, and the studies of the paper that calibrates it."""

from pathlib import Path


def robot_file() -> Path:
    """Path of the robot description `medrue.yaml`, which names the URDF beside it.

    An installed package carries the folder `urdf` inside itself; in a source checkout it lies beside the
    package.

    Returns:
        Path of an existing file.

    Raises:
        FileNotFoundError: The installation lacks its data.
    """
    package = Path(__file__).resolve().parent
    candidates = [package / "urdf" / "medrue.yaml", package.parent / "urdf" / "medrue.yaml"]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    searched = " or ".join(str(candidate) for candidate in candidates)
    raise FileNotFoundError(f"robot description not found at {searched}: reinstall the package 'medrue'")

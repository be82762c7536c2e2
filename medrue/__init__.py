"""MedRUE: the robot, its equations in closed form, and the studies of the paper that calibrates it."""

from pathlib import Path

__all__ = ["robot_file"]


def robot_file(name: str = "medrue") -> Path:
    """Path of a robot description, which names the URDF beside it.

    An installed package carries the folder `urdf` inside itself; in a source checkout it lies beside the
    package.

    Args:
        name: `medrue`, with the paper's 36 parameters, or `medrue_extended`, with all of its geometry and the errors
            of its rail.

    Returns:
        Path of an existing file.

    Raises:
        FileNotFoundError: The installation lacks its data.
    """
    package = Path(__file__).resolve().parent
    candidates = [folder / "urdf" / f"{name}.yaml" for folder in (package, package.parent)]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    searched = " or ".join(str(candidate) for candidate in candidates)
    raise FileNotFoundError(f"robot description not found at {searched}: reinstall the package 'medrue'")

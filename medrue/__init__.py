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
    return _data_file(f"{name}.yaml", "urdf")


def measurement_file() -> Path:
    """Path of the simulated measurements of MedRUE: 420 poses, 0.04 mm of noise.

    Raises:
        FileNotFoundError: The installation lacks its data.
    """
    return _data_file("medrue_simulated.csv", "docs/examples")


def _data_file(name: str, in_checkout: str) -> Path:
    """A file that an installed package has in its folder `urdf`, and a checkout elsewhere."""
    package = Path(__file__).resolve().parent
    candidates = (package / "urdf" / name, package.parent / in_checkout / name)
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    searched = " or ".join(str(candidate) for candidate in candidates)
    raise FileNotFoundError(f"{name} not found at {searched}: reinstall the package 'medrue'")

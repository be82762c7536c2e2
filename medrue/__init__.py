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
    return _existing(f"urdf/{name}.yaml")


def measurement_file() -> Path:
    """Path of the simulated measurements of MedRUE: 420 poses, 0.04 mm of noise.

    Raises:
        FileNotFoundError: The installation lacks its data.
    """
    return _existing("docs/examples/medrue_simulated.csv")


def page_files() -> dict[str, dict[str, Path]]:
    """Paths of the files that the pages of the documentation use, by folder and name as the pages call them.

    Raises:
        FileNotFoundError: The installation lacks its data.
    """
    return {
        folder: {path.name: path for path in sorted(_existing(f"{folder}/{name}").parent.iterdir()) if path.is_file()}
        for folder, name in (("urdf", "medrue.urdf"), ("docs/examples", "arm.urdf"))
    }


def _existing(name: str) -> Path:
    """A file of a checkout; an installed package has its folder inside itself."""
    package = Path(__file__).resolve().parent
    candidates = (package / name.removeprefix("docs/"), package.parent / name)
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    searched = " or ".join(str(candidate) for candidate in candidates)
    raise FileNotFoundError(f"{name} not found at {searched}: reinstall the package 'medrue'")

"""All codes: a new one is a script here that calls `exchange.main`, and a line in this list."""

import re
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Code:
    """A way to run a package.

    `key` names its environment, `requires` is what pip installs there; none: this one's. `problem` is the kind that it
    solves, `shared` what its user writes besides the script.
    """

    name: str
    script: str
    option: str = ""
    key: str = ""
    requires: tuple[str, ...] = ()
    problem: str = "arm"
    shared: str = ""

    @property
    def lines(self) -> int:
        """Lines that a user writes: between the marks of the scripts, without blank ones, comments, docstrings."""
        own = []
        for name in filter(None, (self.script, self.shared)):
            text = (HERE / name).read_text(encoding="utf-8").partition("# -- what a user writes")[2]
            own += re.sub(r'""".*?"""', "", text.partition("# -- end")[0], flags=re.DOTALL).splitlines()[1:]
        return sum(bool(line.strip()) and not line.strip().startswith("#") for line in own)


OURS = {
    "arm": "this project, auto",
    "photographs": "this project",
    "printers": "this project",
}  # what others are compared with
PLACED = "nominal robot, placed"
CHAIN, LENS = "urdf_chain.py", "exchange.py"
OPENCV = ("opencv-python-headless==4.14.0.94", "scipy")  # 5.0 has no hand-eye solver in Python
CODES = (
    Code(PLACED, "scipy_origins.py", "placed", shared=CHAIN),
    Code("this project", "calib_fit.py", "origins"),
    Code(OURS["arm"], "calib_fit.py", "auto"),
    Code("this project, no priors", "calib_fit.py", "no-priors"),
    Code("SciPy", "scipy_origins.py", "origins", shared=CHAIN),
    Code("SciPy, priors", "scipy_origins.py", "priors", shared=CHAIN),
    Code("Ceres, priors", "ceres_origins.py", "", "pyceres", ("pyceres==2.6", "scipy"), shared=CHAIN),
    Code("GTSAM, priors", "gtsam_origins.py", "", "gtsam", ("gtsam==4.3.0", "scipy"), shared=CHAIN),
    Code("FIGAROH", "figaroh_urdf.py", "structural", "figaroh", ("figaroh==1.0.2",)),
    Code("FIGAROH, excitation", "figaroh_urdf.py", "excitation", "figaroh", ("figaroh==1.0.2",)),
    Code("FIGAROH, map", "figaroh_urdf.py", "map", "figaroh", ("figaroh==1.0.2",)),
    Code("pybotics", "pybotics_mdh.py", key="pybotics", requires=("pybotics==3.1.2",)),
    Code("robotkinecal", "robotkinecal_poe.py", key="robotkinecal", requires=("robotkinecal==0.1.0",)),
    Code(OURS["photographs"], "calib_hand_eye.py", problem="photographs"),
    Code("SciPy, lens as published", "scipy_hand_eye.py", "given", problem="photographs", shared=LENS),
    Code("SciPy, lens found", "scipy_hand_eye.py", "found", problem="photographs", shared=LENS),
    Code("OpenCV, hand-eye", "opencv_hand_eye.py", "hand-eye", "opencv", OPENCV, "photographs"),
    Code("OpenCV, robot-world", "opencv_hand_eye.py", "robot-world", "opencv", OPENCV, "photographs"),
    Code(OURS["printers"], "calib_printer.py", problem="printers"),
    Code("Klipper, re-implemented", "delta_printer.py", problem="printers"),
)

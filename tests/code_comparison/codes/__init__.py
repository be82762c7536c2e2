"""All codes: a new one is a script here that calls `exchange.main`, and a line in this list."""

from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Code:
    """A way to run a package: `key` names its environment, `requires` is what pip installs there; none: this one's."""

    name: str
    script: str
    option: str = ""
    key: str = ""
    requires: tuple[str, ...] = ()

    @property
    def lines(self) -> int:
        """Lines that a user writes: those between the marks of the script, without blank ones and comments."""
        text = (HERE / self.script).read_text(encoding="utf-8")
        own = text.partition("# -- what a user writes")[2].partition("# -- end")[0].splitlines()[1:]
        return sum(bool(line.strip()) and not line.strip().startswith("#") for line in own)


OURS = "this project, auto"
PLACED = "nominal robot, placed"
CODES = (
    Code(PLACED, "scipy_origins.py", "placed"),
    Code("this project", "calib_fit.py", "origins"),
    Code(OURS, "calib_fit.py", "auto"),
    Code("this project, no priors", "calib_fit.py", "no-priors"),
    Code("SciPy", "scipy_origins.py", "origins"),
    Code("SciPy, priors", "scipy_origins.py", "priors"),
    Code("pybotics", "pybotics_mdh.py", key="pybotics", requires=("pybotics==3.1.2",)),
    Code("robotkinecal", "robotkinecal_poe.py", key="robotkinecal", requires=("robotkinecal==0.1.0",)),
)

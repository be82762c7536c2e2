"""What a simulated calibration can go through: a table of small functions, healthy ones and faulty ones.

A scenario gets a `Lab` and returns the measurements that would be handed to `calib fit`. To add one, write such a
function into the file where it belongs, and name it in the table at the end of that file; to add a robot, write a
function that says where it is measured, and name it in `ROBOTS` (`verdict_lab`).
"""

from __future__ import annotations

from verdict_files import FILES
from verdict_healthy import HEALTHY
from verdict_lab import ROBOTS, Scenario, Trial, open_lab
from verdict_readings import READINGS
from verdict_robots import ROBOT

__all__ = ["ROBOTS", "SCENARIOS", "Scenario", "Trial", "open_lab"]

SCENARIOS: dict[str, Scenario] = {**HEALTHY, **FILES, **READINGS, **ROBOT}
"""What is tried, by its name."""

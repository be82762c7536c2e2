"""The page about the robot description names every key that the program knows."""

import re

from snippets import DOCS

from calib.core.robots.description import BaseSection, Description, OriginSection, TargetSection


def test_every_key_is_on_the_page():
    page = (DOCS / "robot_description.md").read_text()
    for section in (Description, BaseSection, TargetSection, OriginSection):
        for key in section.model_fields:
            assert re.search(rf"`[^`]*\b{key}\b[^`]*`", page), f"{section.__name__}.{key}"

"""The page about verdicts has a section for every reason that a verdict can have."""

import re

from snippets import DOCS

from calib.judging.reasons import Code


def test_every_reason_has_a_section_on_the_page():
    page = (DOCS / "howto" / "when_it_fails.md").read_text()
    sections = set(re.findall(r"^### (\w+)$", page, re.MULTILINE))
    assert sections == {code.value for code in Code}

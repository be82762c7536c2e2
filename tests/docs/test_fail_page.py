"""The page about verdicts has a section for every reason that a verdict can have."""

import re

from snippets import DOCS, ROOT


def test_every_reason_has_a_section_on_the_page():
    codes = set()
    for path in (ROOT / "calib" / "judging").glob("*.py"):
        codes |= set(re.findall(r'Reason\(\s*"(?:PASS|CHECK|FAIL)"[^,]*,\s*"(\w+)"', path.read_text()))
    assert len(codes) > 10
    page = (DOCS / "howto" / "when_it_fails.md").read_text()
    sections = set(re.findall(r"^### (\w+)$", page, re.MULTILINE))
    assert codes <= sections
    assert sections - codes == set(), "no such reason"

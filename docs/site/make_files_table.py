"""Write the table of other programs' files into its page, from the table by which they are known.

python docs/site/make_files_table.py
"""

from __future__ import annotations

import re
from pathlib import Path

from calib.core.data.other_formats import other_formats

PAGE = Path(__file__).resolve().parents[1] / "howto" / "foreign_files.md"
_TABLE = re.compile(r"(?<=\| file \| known by \| what becomes of it \|\n\|---\|---\|---\|\n)(?:\|.*\n)*")


def page() -> str:
    """Return the page with its table."""
    rows = []
    for each in other_formats():
        taken = each.taken if each.read is not None else f"not read: {each.taken}"
        cells = (each.name, each.head, re.sub(r"\b(NAME(?:_\w+)?)\b", r"`\1`", taken))
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    return _TABLE.sub(lambda _: "".join(rows), PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

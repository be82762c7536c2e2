"""Write the page about words of other packages from the table that error messages are made of.

python docs/site/make_words_page.py
"""

from __future__ import annotations

from pathlib import Path

from calib.base.other_words import tables

PAGE = Path(__file__).resolve().parents[1] / "howto" / "other_words.md"
_INTRODUCTION = """# Words of other packages

There is one word for each thing here. Who types the word of another package is told the one that is meant: `fit.params`
or `calib fit ... --robust` end in an error that says what to write. This page is made of the same table.
"""


def page() -> str:
    """Return the page."""
    parts = [_INTRODUCTION]
    for place, rows in tables().items():
        parts += [f"## Of {place}\n", "| where | habit | here |", "|---|---|---|"]
        for row in rows:
            words = ", ".join(f"`{word}`" for word in row.words if word != "another") or "measurements as two arrays"
            parts.append(f"| {row.package} | {words} | {row.here} |")
        parts.append("")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

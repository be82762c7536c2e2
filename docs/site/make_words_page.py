"""Write the page about words of other packages from the table that error messages are made of.

python docs/site/make_words_page.py
"""

from __future__ import annotations

from pathlib import Path

from calib.core.base.other_words import tables

PAGE = Path(__file__).resolve().parents[1] / "howto" / "other_words.md"
_INTRODUCTION = """# Words of other packages

For anyone who types the words of another package: at the end you know the word used here. There is one for each thing.
`fit.params` or `calib fit ... --robust` end in an error that says what to write; this page comes from the same table.
"""


def page() -> str:
    """Return the page."""
    parts = [_INTRODUCTION]
    for place, rows in tables().items():
        parts += [f"## Of {place}\n", "| where | habit | here |", "|---|---|---|"]
        for row in rows:
            words = ", ".join(f"`{word}`" for word in row.words if word != "another") or "another argument"
            parts.append(f"| {row.package} | {words} | {row.here} |")
        parts.append("")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

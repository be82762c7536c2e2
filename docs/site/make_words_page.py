"""Write the page about words of other packages from the table that error messages are made of.

python docs/site/make_words_page.py
"""

from __future__ import annotations

from pathlib import Path

from calib.core.base.other_words import tables

PAGE = Path(__file__).resolve().parents[1] / "howto" / "other_words.md"
_TYPED = "command line"  # what a shell is given: its errors stand beside what was typed
_INTRODUCTION = """# Words of other packages

For anyone who knows another package: at the end you know the word used here. Search this page for your word, or type
it: `fit.params`, `calib calibrate` and `calib fit ... --robust` end in an error that says what to write.
"""


def page() -> str:
    """Return the page: a table for each package, with its names in Python, what they are of, and the word here."""
    by_package: dict[str, dict[tuple[str, str], list[str]]] = {}
    for place, row in ((place, row) for place, rows in tables().items() for row in rows if row.package != _TYPED):
        known = by_package.setdefault(row.package, {}).setdefault((place, row.here), [])
        known += [word for word in row.words if word not in known]
    parts = [_INTRODUCTION]
    for package, by_meaning in sorted(by_package.items(), key=lambda item: item[0].lower()):
        parts += [f"## {package}\n", "| word | of | here |", "|---|---|---|"]
        for (place, here), words in by_meaning.items():
            parts.append(f"| {', '.join(f'`{word}`' for word in words)} | {place} | {here} |")
        parts.append("")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

"""Write the page about words of other packages from the table that error messages are made of.

python docs/site/make_words_page.py
"""

from __future__ import annotations

from pathlib import Path

from calib.core.base.other_words import tables

PAGE = Path(__file__).resolve().parents[1] / "howto" / "other_words.md"
_COMMAND_LINE = "command line"
_INTRODUCTION = """# Words of other packages

For anyone who knows another package: at the end you know the word used here. Search this page for your word, or type
it: `fit.params` and `calib fit ... --robust` end in an error that says what to write.
"""


def page() -> str:
    """Return the page: a table for each package, of its words as Python names; commands in a table of their own.

    Options of commands are left out: their errors stand beside what was typed.
    """
    by_package: dict[str, dict[str, list[str]]] = {}
    for rows in tables().values():
        for row in rows:
            words = [word for word in row.words if not (row.package == _COMMAND_LINE and _is_option(word))]
            if words:
                known = by_package.setdefault(row.package, {}).setdefault(row.here, [])
                known += [word for word in words if word not in known]
    parts = [_INTRODUCTION]
    for package, by_meaning in sorted(by_package.items(), key=lambda item: (item[0] == _COMMAND_LINE, item[0].lower())):
        parts += [f"## {package}\n", "| word | here |", "|---|---|"]
        parts += [f"| {', '.join(f'`{word}`' for word in words)} | {here} |" for here, words in by_meaning.items()]
        parts.append("")
    return "\n".join(parts)


def _is_option(word: str) -> bool:
    return word.startswith("-") or word.isupper() or word == "another"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

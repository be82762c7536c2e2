"""Letters that nobody sees: controls, escapes of terminals, marks of direction. No name or message contains them.

A name with a line end cannot be read from the table that it is written to; two names that differ by a mark of no width
look the same; U+202E reverses the text that follows, and an escape moves the cursor, wherever the text is shown.
"""

from __future__ import annotations

import re

_UNSEEN = (
    "\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff"
    "\U000e0000-\U000e007f"
)
_IN_NAMES = re.compile(f"[{_UNSEEN}]")
_WORD, _WORD_SHOWN = 400, 60
_TEXT, _TEXT_SHOWN = 8000, 2000
_LONG_WORD = re.compile(rf"\S{{{_WORD},}}")


def visible(text: str) -> str:
    r"""Return a text in which letters that nobody sees are spelt; line ends and tabs stay.

    >>> visible("a\x1b[31mb")
    'a\\x1b[31mb'
    """
    return text if text.isprintable() else "".join(c if c.isprintable() or c in "\n\t" else _spell(c) for c in text)


def unseen(name: str) -> str:
    r"""Return a complaint about a name with letters that nobody sees; "" if it has none.

    >>> unseen("P\n1"), unseen("P 1")
    ("'P\\n1' holds \\n, which nobody sees; write the name without it", '')
    """
    found = None if name.isascii() and name.isprintable() else _IN_NAMES.search(name)
    if found is None:
        return ""
    shown = _IN_NAMES.sub(lambda letter: _spell(letter[0]), name[:_WORD_SHOWN])
    return f"'{shown}' holds {_spell(found[0])}, which nobody sees; write the name without it"


def brief(text: str) -> str:
    """Return a text with its longest words, and then the whole, cut to a length that a person reads.

    >>> brief("not a number: " + 50_000 * "9")[:50], len(brief(50_000 * "a b "))
    ('not a number: 999999999999999999999999999999999999', 4035)
    """
    words = _LONG_WORD.sub(lambda word: _shorten(word[0], _WORD_SHOWN), text)
    return words if len(words) <= _TEXT else _shorten(words, _TEXT_SHOWN)


def _shorten(text: str, kept: int) -> str:
    return f"{text[:kept]}... ({len(text) - 2 * kept} further characters) ...{text[-kept:]}"


def _spell(letter: str) -> str:
    return letter.encode("unicode_escape").decode()

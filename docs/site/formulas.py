r"""Formulas of the pages as MathML: no script, no font and no request are needed to read them.

In the pages `$...$` is a formula in a line and `$$...$$` one of its own, in LaTeX, as GitHub shows them too.
"""

from __future__ import annotations

import html as entities
import re

from latex2mathml.converter import convert

_INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
_BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)


def to_mathml(html: str, where: str) -> str:
    """Replace the formulas of a page.

    Args:
        html: The page's content.
        where: Its file, for messages.

    Raises:
        ValueError: A formula that cannot be read.
    """
    html = _BLOCK.sub(lambda match: f'<div class="formula">{_mathml(match, "block", where)}</div>', html)
    return _INLINE.sub(lambda match: _mathml(match, "inline", where), html)


def _mathml(match: re.Match[str], display: str, where: str) -> str:
    latex = entities.unescape(match.group(1)).strip()
    try:
        mathml = convert(latex, display=display)
    except Exception as error:
        raise ValueError(f"{where}: formula {latex!r} cannot be converted: {type(error).__name__} {error}") from error
    if "<mi>&</mi>" in mathml:  # `aligned`, whose columns would be printed as they are written
        raise ValueError(f"{where}: formula {latex!r} has columns that cannot be converted; write several formulas")
    return mathml

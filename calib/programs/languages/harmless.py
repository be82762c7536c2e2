"""Words of controllers and of G-code that change no target, tool, frame or mode of motion: see `harmless.txt`.

The lists hold words of the manufacturers' manuals that read their arguments and set none of them. A name that is
neither listed nor declared in the program may change anything.
"""

from __future__ import annotations

import re
from pathlib import Path

_TEXT = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")
LISTS = {part[1]: part[2].split() for part in re.finditer(r"^\[(.*)\]\n([^\[]*)", _TEXT, re.MULTILINE)}
"""Words by the name of their list."""
URSCRIPT = frozenset(LISTS["URScript"])
URSCRIPT_COMPUTED = frozenset(LISTS["URScript COMPUTED"])
"""URScript functions whose motion has a goal that is computed while they run."""
RAPID, RAPID_SETS, KRL, BAS_HARMLESS, BAS_FORMS, FANUC, FANUC_OPTIONS = (
    frozenset(word.upper() for word in LISTS[name])
    for name in ("RAPID", "RAPID SETS", "KRL", "BAS", "BAS FORMS", "FANUC", "FANUC OPTIONS")
)
"""Words in capitals, since case does not count. Words of `RAPID_SETS` set some of their arguments and nothing else.
Words of `FANUC_OPTIONS` follow the targets of a motion and leave them unchanged."""

"""Lines of G-code in parts: commands, words of a letter and a number, names, texts and comments.

The grammar of a line is regular: a sequence of words, or a name and its text. A line is refused if the firmware reads
it differently from its apparent meaning or, for unknown firmware, if firmwares disagree on it.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

from calib.core.base.errors import DataError
from calib.programs.languages.gcode_dialects import TEXT, Dialect, parse_words

AXES = "XYZ"
_LARGEST = 1e6  # largest number in a program
_COMMENT = re.compile(r'"[^"]*"|\([^()]*\)|;.*')  # text in quotation marks is no comment
_CODE_IN_COMMENT = re.compile(r"[XYZEFGMT]\s*[-+.\d]|(?<![A-Z_])[XYZ](?![A-Z_])|;", re.ASCII | re.IGNORECASE)
_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+))\s*", re.ASCII | re.IGNORECASE)
_BLOCK = re.compile(rf";\s*(?:{_WORD.pattern})+(?:[;(].*)?", re.ASCII | re.IGNORECASE)
_NAME = re.compile(r"[A-Z_]{2}\w*(?=\s|$)", re.ASCII | re.IGNORECASE)
_COMMAND = re.compile(r"[GM]\s*\d", re.ASCII | re.IGNORECASE)
_EXPONENT = re.compile(r"[\d.]E\s*[-+.\d]", re.ASCII | re.IGNORECASE)
_HOMING = parse_words("G28 G29 G30")
_OWN_WORDS = parse_words("G4 G10 G92")  # these take the X, Y, Z of their line; so do M words
_WITHOUT_WORDS = parse_words("M0-5 M7-9 M30")  # except these


@dataclass(frozen=True)
class GcodeLine:
    """A line in parts.

    Attributes:
        where: Name of the line in messages.
        counter: The line number (N word); empty if there is none.
        name: The command, if it is a name (`START_PRINT`).
        words: Letters and their numbers.
        rest: Other text: letters without a number, or the text after the name.
        comments: Comments as written.
    """

    where: str
    counter: tuple[str, ...]
    name: str
    words: tuple[tuple[str, str], ...]
    rest: str
    comments: str

    @cached_property
    def codes(self) -> list[str]:
        """Commands, such as G1."""
        return [_code(*word) for word in self.words if word[0] in "GM"]

    @cached_property
    def tool(self) -> str:
        """The tool with which the line begins; empty if there is none."""
        return _code(*self.words[0]) if self.words and self.words[0][0] == "T" else ""

    @cached_property
    def argument_texts(self) -> dict[str, str]:
        """The number of each letter that is no command."""
        return {letter: number for letter, number in self.words if letter not in "GM"}

    @cached_property
    def homing(self) -> str:
        """The command that homes or probes; empty if there is none."""
        return next((code for code in self.codes if code.split(".")[0] in _HOMING), "")

    def owner(self, vouched: Collection[str]) -> str:
        """Return the command other than a motion that takes X, Y, Z; empty if there is none."""
        own = _OWN_WORDS | {*vouched} | {code for code in self.codes if code[0] == "M" and code not in _WITHOUT_WORDS}
        return next((code for code in self.codes if code in own), self.homing)

    def refusal(self, why: str) -> DataError:
        """Return the error that names the line."""
        return DataError(f"{self.where}: {why}")


def _code(letter: str, number: str) -> str:
    return f"{letter}{float(number):g}"


def read_line(line: str, where: str, dialect: Dialect) -> GcodeLine | None:
    """Return the parts of a line; None if it has no code.

    Raises:
        DataError: The line cannot be read, or firmwares read it differently.
    """
    if not line.replace("\t", " ").isprintable():
        raise DataError(f"{where}: is not text; is this a G-code program?")
    comments = [text.strip() for text in _COMMENT.findall(line) if text[0] != '"']
    code = _COMMENT.sub(lambda match: match.group() if match.group()[0] == '"' else " ", line).strip()
    if not code or code == "%":
        return None
    unsure = next((text for text in comments if text[0] == "(" and _CODE_IN_COMMENT.search(text)), "")
    if unsure and not dialect.parentheses:
        raise DataError(f"{where}: '{unsure:.40}' is code for some firmwares; remove it, or say --dialect cnc or rrf")
    block = next((text for text in comments if text[0] == ";" and _BLOCK.fullmatch(text)), "")
    if block and dialect.fanuc:
        raise DataError(f"{where}: '{block:.40}' is code for some controls; remove it, or write it in parentheses")
    if code.startswith("/"):
        raise DataError(f"{where}: it is not known whether lines with / are run; remove the line, or the mark")
    words, end = [], 0
    while match := _WORD.match(code, end):
        words.append((match[1].upper(), match[2]))
        if words[-1][0] in "GM" and not re.fullmatch(dialect.spelling, match.group().strip().upper()):
            raise DataError(f"{where}: '{match.group():.40}' is no command of {dialect.name}; write G1, not G01 or G 1")
        end = match.end()
    counter = [f"N{words.pop(0)[1]}"] if words and words[0][0] == "N" else []
    large = next((word for word in words if abs(float(word[1])) > _LARGEST), None)
    if large is not None:
        raise DataError(f"{where}: '{large[0]}{large[1]:.20}' is beyond what any machine reads; correct it")
    match = None if words else _NAME.match(code, end)
    name, end = (match.group().upper(), match.end()) if match else ("", end)
    parts = GcodeLine(where, tuple(counter), name, tuple(words), code[end:], " ".join(comments))
    if "E" in parts.argument_texts and dialect.exponents and _EXPONENT.search(code) and parts.codes[:1] != [TEXT]:
        raise DataError(f"{parts.where}: has an E that some firmwares take for an exponent; put a space before it")
    return parts


def require_words(line: GcodeLine, dialect: Dialect) -> None:
    """Refuse a repeated letter, and text that no command takes or that may hide another command.

    Raises:
        DataError: The line has such a letter or text.
    """
    letters = [letter for letter, _ in line.words if letter not in "GM"]
    if len(set(letters)) < len(letters):
        raise line.refusal("has a letter twice; write one command per line")
    takes_text = line.codes[:1] == [line.homing] or (line.words and line.words[0][0] == "M")
    hidden = dialect.allows_several and _COMMAND.search(re.sub(r'"[^"]*"', "", line.rest))
    if line.rest and (hidden or not takes_text):
        raise line.refusal(f"'{line.rest:.40}' is not read; write words of a letter and a number")


def require_order(line: GcodeLine, owner: str, dialect: Dialect) -> None:
    """Refuse commands that conflict within a line, or that the firmware does not run.

    Raises:
        DataError: The line has such commands.
    """
    codes, moving = line.codes, [code for code in line.codes if code in ("G0", "G1")]
    takers, command = set(), ""  # commands followed by X, Y, Z or E; an empty text if these precede all commands
    for word in line.words:
        if word[0] in "GM":
            command = _code(*word)
        elif word[0] in "XYZE":
            takers.add(command)
    if len(moving) > 1:
        raise line.refusal("has two motions; write one command per line")
    for pair in (("G20", "G21"), ("G90", "G91")):
        if {*pair} <= {*codes}:
            raise line.refusal(f"has {pair[0]} and {pair[1]}; write one command per line")
    if len(codes) > 1 and not dialect.allows_several:
        raise line.refusal(f"{dialect.name} runs only the first command of a line; write one command per line")
    if takers and not codes and not dialect.modal:
        raise line.refusal(f"{dialect.name} may not run lines without a command; write G0 or G1")
    if dialect.at_once:
        mixed = owner not in ("", line.homing) and bool(moving or "" in takers)
    else:  # words belong to the command before them, and E is written after all others
        mixed = not takers <= {owner or "".join(moving)} or bool(owner and moving and takers)
        behind = codes[max((codes.index(code) + 1 for code in takers if code), default=0) :] if takers else []
        mixed = (
            mixed
            or any(code[0] == "G" for code in behind)
            or ("E" in line.argument_texts and not owner and bool(behind))
        )
    if mixed or TEXT in codes:
        raise line.refusal("has words of several commands; write one command per line")

"""The command reference, from the programs' own `--help`."""

from __future__ import annotations

from collections.abc import Iterator

import click

WIDTH = 92

EXAMPLES = {
    "calib init": "calib init robot.urdf --target reflector --out robot.yaml",
    "calib sample": "calib sample docs/examples/arm.yaml --count 200 --seed 1 --out candidates.csv",
    "calib check": "calib check docs/examples/arm.yaml docs/examples/arm_simulated.csv",
    "calib select": "calib select docs/examples/arm.yaml candidates.csv --count 30 --index O1 --out poses.csv",
    "calib route": "calib route robot.yaml poses.csv --candidates candidates.csv --format urscript --out route",
    "calib simulate": "calib simulate docs/examples/arm.yaml poses.csv --sigma-mm 0.04 --seed 1 --out simulated.csv",
    "calib study": "calib study docs/examples/arm.yaml poses.csv --draws 200 --truth priors",
    "calib board": "calib board --board charuco:5x7:30mm:22mm:DICT_5X5_100 --paper a4 --out board.pdf",
    "calib detect": "calib detect shots --board board.yaml --out pixels.csv --page detected.html",
    "calib hand-eye": "calib hand-eye shots --board board.yaml --poses poses.csv --out hand_eye",
    "calib fit": "calib fit docs/examples/arm.yaml docs/examples/arm_simulated.csv --validate 0.25 --out out/arm",
    "calib watch": "calib watch docs/examples/arm.yaml growing.csv --goal 0.1mm",
    "calib view": "calib view out/arm --map",
    "calib compare": "calib compare out/before out/after --html compared.html",
    "calib fleet": "calib fleet out/robot_1 out/robot_2 out/robot_3 --out fleet.yaml",
    "calib match": "calib match stock.urdf pairs.csv --out out/twin",
    "calib verify": "calib verify out/arm check.csv",
    "calib predict": "calib predict out/arm poses.csv --out predicted.csv",
    "calib solve": "calib solve out/arm goals.csv --out commands.csv",
    "calib compensate": "calib compensate docs/examples/arm.yaml program.csv --result out/arm --out corrected.csv",
    "calib export": "calib export out/arm --format mjcf --out arm.xml",
    "calib qualify": "calib qualify --out out/qualification",
    "calib certificate": "calib certificate out/arm --out certificate.pdf",
    "medrue demo": "medrue demo --out out/demo",
    "medrue examples": "medrue examples",
    "medrue poses": "medrue poses --out poses.csv",
    "medrue study": "medrue study --out out/study",
    "medrue experiment": "medrue experiment --out out/experiment",
    "medrue touch": "medrue touch --out out/touch",
}
"""One for each command, which its own options understand."""

_HEAD = """\
# Commands

For anyone at a terminal: at the end you know every command and its options. This is what `--help` prints, with an
example of each command. `python -m calib` is the same as `calib`.

**Exit codes.** 0: done. 2: the input is wrong; one line on standard error says what, where, and what to do. 3: the
computation could not give an answer that can be trusted, and says why. An existing result is never half overwritten.

**At a terminal**, `calib fit`, `calib check` and `calib select` end with what the grade means (PASS green, CHECK
yellow, FAIL red) and the next command to type: the one that answers the first reason of the verdict, or that goes on.
In files and pipes these lines are left out.

**Completion.** Shells complete commands and options of `calib` after one of these lines; `medrue` does the same with
`_MEDRUE_COMPLETE`:

```sh
eval "$(_CALIB_COMPLETE=bash_source calib)"    # bash: into ~/.bashrc
eval "$(_CALIB_COMPLETE=zsh_source calib)"     # zsh: into ~/.zshrc
_CALIB_COMPLETE=fish_source calib | source     # fish: into ~/.config/fish/completions/calib.fish
```
"""


def programs() -> tuple[click.Group, ...]:
    """The programs that this project installs."""
    from calib.cli import group as calib
    from medrue.cli import group as medrue

    return calib, medrue


def commands() -> Iterator[tuple[str, click.Command, click.Context]]:
    """Every program and command: its full name, itself, and a context to ask it with."""
    for program in programs():
        context = click.Context(
            program,
            info_name=program.name,
            **({"terminal_width": WIDTH, "max_content_width": WIDTH} | program.context_settings),
        )
        yield str(program.name), program, context
        for name in program.list_commands(context):
            command = program.get_command(context, name)
            assert command is not None  # its name is on the list
            yield (
                f"{program.name} {name}",
                command,
                click.Context(command, info_name=name, parent=context, terminal_width=WIDTH, max_content_width=WIDTH),
            )


def page() -> str:
    """Return the page as Markdown."""
    parts = [_HEAD]
    for name, command, context in commands():
        level = "##" if isinstance(command, click.Group) else "###"
        example = f"```sh\n{EXAMPLES[name]}\n```\n\n" if name in EXAMPLES else ""
        parts.append(f"{level} {name}\n\n{example}```text\n{command.get_help(context)}\n```\n")
    return "\n".join(parts)

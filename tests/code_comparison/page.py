"""The page and its plot, written from results alone."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from tests.public_data import markdown
from tests.public_data import written as write_part

from .codes import CODES, OURS, PLACED
from .data_set import DataSet

BEHIND = 1.03  # RMS of this project over the best, up to which the page calls it even
TITLES = {"arm": "Arms", "photographs": "Hand-eye, from photographs", "printers": "Delta printers"}
_MARK = {"better": "", "worse": " ▲", "tie": " ="}
_STYLE = {"svg.fonttype": "none", "svg.hashsalt": "comparison", "font.size": 9}
_COLOURS = ("#7F7F7F", "#56B4E9", "#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7", "#000000")
Row = dict[str, Any]


def written(page: Path, told: dict[str, Any], sets: Sequence[DataSet]) -> None:
    """Write results into the page, between its marks, and the plot into `figures` beside it."""
    rows = told["rows"]
    plot = page.parent / "figures" / f"{page.stem}.svg"
    plot.parent.mkdir(exist_ok=True)
    plot.write_text(drawing(rows), encoding="utf-8")
    units = {data.problem: data.unit for data in sets}
    parts = [_standing(rows), f"![Errors of all codes over those of this project](figures/{plot.name})"]
    for problem, title in TITLES.items():
        own = [row for row in rows if _problem(row) == problem]
        if own:
            key = [] if any(part in (_KEY, _MARKS) for part in parts) else [_KEY, _MARKS]
            tables = [_summary(own), *key[:1], _accuracy(own, *units[problem]), *key[1:], _missing(own)]
            parts += [f"### {title}", *tables]
    parts += [
        _behind(rows, sets),
        "### The data",
        _origins(sets, rows),
        "### Where it ran",
        "\n\n".join(f"{machine}." for machine in _machines(rows)),
        "; ".join(told["versions"]) + ".",
    ]
    write_part(page, "results", "\n\n".join(part for part in parts if part))


_KEY = """\
| column | meaning |
|---|---|
| code | "placed": only base and target are fitted. "auto": with `--terms auto`; without it, this project fits joint \
origins alone. "priors": with the sizes of errors that this project gets. A code that answered nowhere has no line |
| splits | on how many splits of a robot's rows, into fitted and unseen ones, a code gave an answer |
| better, tie, worse | than this project (for arms, its line `auto`), by the RMS of unseen rows. A difference counts \
if it is at least 1 %, and a paired t test of squared errors gives a chance below 1 in 1000 (arms, whose rows follow \
each other in a file) or 1 in 100 (images, printers) |
| error | RMS of unseen rows over that of this project: median over the splits |
| claim | error that a code states over the error of unseen rows: median and range. \\*: it states no error at new \
poses; this is the RMS of its residuals |
| verdict right | PASS if errors are at most 1.25 times those claimed and less than the nominal robot's, else another \
grade; on splits with a claim |
| fit, command | processor time of the fit and of the process: medians |
| lines | those that a user writes for one problem |"""
_MARKS = "▲ marks a code that is better than this project, = a tie, bold the smallest error of a line."


def _problem(row: Row) -> str:
    return str(row.get("problem", "arm"))


def _splits(rows: Sequence[Row]) -> list[tuple[Row, dict[str, Row]]]:
    """One row of each split, and the rows of all codes that answered, by their names."""
    kept: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        kept.setdefault((row["data"], row["split"]), {})[row["code"]] = row
    return [
        (next(iter(by_code.values())), {name: row for name, row in by_code.items() if "rms" in row})
        for by_code in kept.values()
    ]


def _names(rows: Sequence[Row]) -> list[str]:
    answered = {row["code"] for row in rows if "rms" in row}
    return list(dict.fromkeys(code.name for code in CODES if code.name in answered))


def _own(told: Row, own: dict[str, Row]) -> Row | None:
    """The row of this project that others are compared with."""
    return own.get(OURS[_problem(told)])


def _best(own: dict[str, Row]) -> Row:
    return min((row for name, row in own.items() if name != PLACED), key=lambda row: row["rms"])


def _standing(rows: Sequence[Row]) -> str:
    pairs = [(ours, _best(own)) for told, own in _splits(rows) if (ours := _own(told, own)) and len(own) > 1]
    even = sum(best["code"] == ours["code"] or best.get("compared") == "tie" for ours, best in pairs)
    behind = [ours["rms"] / best["rms"] - 1 for ours, best in pairs if best["code"] != ours["code"]
              and best.get("compared") != "tie"]  # fmt: skip
    words = f"; on the other {len(behind)} another code is better, by up to {100 * max(behind):.0f} %" if behind else ""
    return (
        f"On {even} of {len(pairs)} splits this project predicts unseen rows best, or so well that chance explains the"
        f" difference (arms: with `--terms auto`){words}."
    )


def _summary(rows: Sequence[Row]) -> str:
    """One line of each code, over all splits."""
    lines = []
    pairs = [(own, ours) for told, own in _splits(rows) if (ours := _own(told, own))]
    for name in _names(rows):
        n_splits = sum(row["code"] == name for row in rows)
        own = [row for row in rows if row["code"] == name and "rms" in row]
        code = next(code for code in CODES if (code.name, code.problem) == (name, _problem(rows[0])))
        compared = [row["compared"] for row in own if "compared" in row]
        over = [both[name]["rms"] / ours["rms"] for both, ours in pairs if name in both]
        counts = ", ".join(str(compared.count(word)) for word in ("worse", "tie", "better")) if compared else ""
        ratios = sorted(row["claimed_rms"] / row["rms"] for row in own if row["claimed_rms"] and name != PLACED)
        claim = f"{median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})" if ratios else "none"
        claim += "" if not ratios or all(row["own_claim"] for row in own if row["claimed_rms"]) else " \\*"
        verdicts = [row["verdict_right"] for row in own if "verdict_right" in row]
        verdict = f"{sum(verdicts)} of {len(verdicts)}" if verdicts else "none"
        fit, command = (median(r[key] for r in own) for key in ("fit_seconds", "command_seconds"))
        cells = [f"{len(own)} of {n_splits}", counts, f"{median(over):.2f}" if over else "", claim, verdict]
        lines.append([name, *cells, f"{fit:.2f}", f"{command:.1f}", code.lines if name != PLACED else ""])
    head = "code, splits, better/tie/worse, error, claim, verdict right, fit [s], command [s], lines"
    return markdown([name.replace("/", ", ") for name in head.split(", ")], lines)


def _accuracy(rows: Sequence[Row], unit: str, scale: float) -> str:
    names, lines = _names(rows), []
    for told, own in _splits(rows):
        least = min((row["rms"] for row in own.values()), default=0.0)
        cells = []
        for row in (own.get(name) for name in names):
            number = f"{scale * row['rms']:.3f}" if row else ""
            number = f"**{number}**" if row and row["rms"] == least else number
            cells.append(f"{number}{_MARK[row['compared']] if row and 'compared' in row else ''}")
        lines.append([f"{told['data']}: {told['split']}", f"{told['n_train']}, {told['n_unseen']}", *cells])
    return markdown([f"RMS of unseen rows [{unit}]", "rows: fitted, unseen", *names], lines, words=2)


def _behind(rows: Sequence[Row], sets: Sequence[DataSet]) -> str:
    reasons = {data.name: data.reasons for data in sets}
    lines = []
    for told, own in _splits(rows):
        ours, best = _own(told, own), _best(own) if own else None
        if ours and best and ours["rms"] > BEHIND * best["rms"]:
            why = reasons.get(told["data"], {}).get(told["split"], "the reason is not known")
            by = 100 * (ours["rms"] / best["rms"] - 1)
            lines.append(f"| {told['data']}: {told['split']} | {by:.0f} % | {best['code']} | {why} |")
    if not lines:
        return ""
    head = "**Where this project is more than 3 % behind:**\n\n"
    return head + "| | by | best | why |\n|---|---:|---|---|\n" + "\n".join(lines)


def _missing(rows: Sequence[Row]) -> str:
    """Codes without an answer, by the reason; reasons that differ in numbers alone count as one."""
    failed: dict[str, list[Row]] = {}
    for row in rows:
        if "failed" in row:
            failed.setdefault(re.sub(r"\d+", "", row["failed"]), []).append(row)
    lines = []
    for group in failed.values():
        codes, data = (list(dict.fromkeys(row[key] for row in group)) for key in ("code", "data"))
        n_splits = len({(row["data"], row["split"]) for row in group})
        why = group[0]["failed"].replace("|", "/").partition(" (RMS")[0][:200]
        lines.append([", ".join(codes), f"{', '.join(data)} ({n_splits} split{'s' * (n_splits > 1)})", why])
    return markdown(["no answer by", "on", "why"], lines, words=3) if lines else ""


def _machines(rows: Sequence[Row]) -> list[str]:
    """Where and when codes ran; with their names, if not all of them ran in the same month on the same machine."""
    codes: dict[str, dict[str, None]] = {}
    for row in rows:
        codes.setdefault(row["machine"], {})[row["code"]] = None
    if len(codes) == 1:
        return list(codes)
    return [f"{machine}: {', '.join(names)}" for machine, names in codes.items()]


def _origins(sets: Sequence[DataSet], rows: Sequence[Row]) -> str:
    used, lines = {row["data"] for row in rows}, []
    for data in sets:
        if data.name in used:
            origin = re.sub(r"(https://\S+)", r"<\1>", data.origin) + (f"; {data.owners}" if data.owners else "")
            lines.append([data.name, f"{data.robot}; {data.instrument}", origin, data.licence])
    return markdown(["data", "robot, instrument", "origin", "licence"], lines, words=4)


def drawing(rows: Sequence[Row]) -> str:
    """Every split a line, every code a mark: its RMS over this project's, as SVG."""
    splits = [(told, own, ours) for told, own in _splits(rows) if (ours := _own(told, own))]
    with rc_context(_STYLE):
        figure = Figure(figsize=(8.5, 1.6 + 0.24 * len(splits)), layout="constrained")
        axes = figure.add_subplot()
        for k, name in enumerate(_names(rows)):
            at = [(own[name]["rms"] / ours["rms"], -i) for i, (_, own, ours) in enumerate(splits) if name in own]
            x, y = zip(*at, strict=True) if at else ((), ())
            axes.plot(x, y, "osD^v<>P"[k % 8], color=_COLOURS[(k + k // 8) % 8], label=name, markersize=5, alpha=0.8)
        axes.set_yticks([-i for i in range(len(splits))], [f"{told['data']}: {told['split']}" for told, *_ in splits])
        axes.axvline(1.0, color=_COLOURS[2], linewidth=0.8)
        axes.set_xscale("log")
        ticks = [t for t in (0.5, 0.7, 1, 1.5, 2, 3, 5, 10, 20, 50) if axes.get_xlim()[0] < t < axes.get_xlim()[1]]
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.set_xticks([], minor=True)
        axes.set_xlabel("RMS of unseen rows, over that of this project (arms: with --terms auto)")
        figure.legend(loc="outside upper center", ncols=4, frameon=False)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"

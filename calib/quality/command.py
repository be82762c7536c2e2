"""`calib qualify`: proof that this installation computes correctly, as a protocol to sign."""

from __future__ import annotations

import datetime
import time
from importlib.util import find_spec
from pathlib import Path

import click

from calib.core.base.files import write_folder
from calib.core.base.words import count_noun, json_file
from calib.core.commands.common import Output, load_robot, shared_options
from calib.core.data.measurement_files import read_measurements
from calib.quality.documents import Document, DocumentRows
from calib.quality.installation import installation_checks, machine_facts
from calib.quality.operation import operation_work
from calib.quality.performance import performance_work
from calib.quality.protocol import Outcome, Phase, Protocol, run_checks

_NOT_QUALIFIED = 3
_NAMES = ("protocol.html", "protocol.json", "protocol.pdf")
_SIGNED_BY = ("Performed by", "Reviewed by", "Approved by")


@click.command("qualify")
@click.argument("robot", required=False)
@click.argument("data", nargs=-1)
@click.option("--out", metavar="DIR", required=True, help="Folder for the protocol.")
@shared_options(json_output=False)
def command(robot: str | None, data: tuple[str, ...], out: str, output: Output) -> None:
    """Prove that this installation computes rightly, and write a protocol to sign.

    The protocol has three phases: what is installed, what it computes compared with references, and whether
    calibrations keep what they promise. With ROBOT and DATA (CSV), the last phase also calibrates your robot and holds
    out a fifth of the poses. The exit code is 3 if a check fails.
    """
    if robot is not None and not data:
        raise click.UsageError("ROBOT needs measurements: give ROBOT and DATA, or neither of them")
    model = None if robot is None else load_robot(robot, output)
    measured = None if model is None else read_measurements(data, model)
    names = _NAMES if find_spec("fpdf") else _NAMES[:2]
    output.check(folders=[out], names=names)
    work = [
        (Phase.INSTALLATION, "installation", installation_checks),
        *operation_work(),
        *performance_work(model, measured),
    ]
    started, clock = datetime.datetime.now().astimezone().isoformat(timespec="seconds"), time.perf_counter()
    with output.working("qualifying") as progress:
        checks = run_checks(work, progress)
    protocol = Protocol(tuple(checks), machine_facts(), started, time.perf_counter() - clock)
    document = protocol_document(protocol)
    contents = (document.html().encode(), json_file(protocol.to_dict()))
    files = dict(zip(names, (*contents, *([document.pdf()] if len(names) == len(_NAMES) else [])), strict=True))
    write_folder(out, files, force=output.force)
    for check in checks:
        if check.outcome is Outcome.FAIL:
            output.note(f"FAIL: {check.subject}: expected {check.expected}; found {check.found}")
    output.say(f"{document.answer}\n{Path(out) / 'protocol.html'} has every check, and lines to sign")
    if not protocol.passed:
        raise SystemExit(_NOT_QUALIFIED)


def protocol_document(protocol: Protocol) -> Document:
    """Return a protocol as a document."""
    failed = [check for check in protocol.checks if check.outcome is Outcome.FAIL]
    noted = [check for check in protocol.checks if check.outcome is Outcome.NOTED]
    answer = f"FAIL: {len(failed)} of {count_noun(len(protocol.checks), 'check')} failed"
    if protocol.passed:
        answer = f"PASS: {count_noun(len(protocol.checks) - len(noted), 'check')} passed in {protocol.seconds:.0f} s"
        answer += f", {len(noted)} could not be made" if noted else ""
    facts = DocumentRows("Installation", ("what", "found"), (("started", protocol.started), *protocol.machine.items()))
    tables = [
        DocumentRows(
            phase,
            ("check", "expected", "found", "outcome"),
            tuple((c.subject, c.expected, c.found, c.outcome) for c in protocol.checks if c.phase is phase),
        )
        for phase in Phase
    ]
    return Document("Qualification protocol of calib", answer, (facts, *tables), _SIGNED_BY)

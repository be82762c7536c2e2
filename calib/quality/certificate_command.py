"""`calib certificate`: a calibration certificate with its uncertainty budget."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from calib.core.base.errors import InputError, nearest
from calib.core.base.files import read_bytes
from calib.core.base.sections import read_yaml
from calib.core.base.threads import one_blas_thread
from calib.core.commands.common import Output, shared_options
from calib.core.data.measurement_files import read_poses
from calib.core.results.loaded_result import LoadedResult
from calib.core.results.result_reading import load_result
from calib.core.robots.description import validate_description
from calib.core.robots.traceability import TraceabilitySection
from calib.quality.certificate import certificate_content, document
from calib.quality.dcc import xml
from calib.quality.monte_carlo import monte_carlo
from calib.quality.signature import ENDING, signer, verify
from calib.quality.uncertainty_budget import ErrorPropagation, budget

_WRITERS: dict[str, Callable[[Mapping[str, Any]], bytes]] = {
    ".xml": xml,
    ".pdf": lambda content: document(content).pdf(),
    ".html": lambda content: document(content).html().encode(),
    ".json": lambda content: (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode(),
}
_COMMENTS = {".pdf": "%"}


@click.command("certificate")
@click.argument("result")
@click.option("--out", metavar="FILE", help="File to write: .xml, .pdf, .html or .json.")
@click.option(
    "--traceability",
    metavar="FILE",
    help="YAML with the key 'traceability', in place of that of the robot description.",
)
@click.option("--poses", metavar="FILE", help="Further poses (CSV) at which the robot will be used.")
@click.option(
    "--draws",
    type=click.IntRange(min=0),
    default=300,
    show_default=True,
    help="Fits of the Monte Carlo check of the budget; 0 for none.",
)
@click.option("--sign", "key", metavar="KEY", help="Private key (Ed25519, PEM): also write the signature FILE.sig.")
@click.option(
    "--verify",
    "public",
    metavar="KEY",
    help="Public key (PEM): only check the signature beside the certificate RESULT; nothing is written.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the Monte Carlo check.")
@shared_options(json_output=False)
def command(
    result: str,
    out: str | None,
    traceability: str | None,
    poses: str | None,
    draws: int,
    key: str | None,
    public: str | None,
    seed: int,
    output: Output,
) -> None:
    """Write a calibration certificate of RESULT, a folder of `calib fit`, with its uncertainty budget.

    The budget is by the GUM, from the fit and from `traceability` in the robot description, and is checked by Monte
    Carlo (Supplement 1). XML is a digital calibration certificate by PTB's schema (DCC 3.2). Only an accredited
    laboratory gives a certificate legal force.
    """
    if public is not None:
        verify(result, public)
        output.say(f"{result} is unchanged since the owner of {public} signed it")
        return
    if out is None:
        raise click.UsageError("give --out FILE, the certificate to write")
    ending = Path(out).suffix.lower()
    if ending not in _WRITERS:
        raise InputError(f"--out {out}: give it an ending of {', '.join(_WRITERS)}{nearest(ending, _WRITERS)}")
    loaded = load_result(result)
    stated = _traceability(loaded, traceability)
    where = None if poses is None else read_poses(poses, loaded.robot)
    sign = (
        None
        if key is None
        else signer(key, lambda: str(click.prompt("Password of the key", hide_input=True, err=True)))
    )
    output.check(out, None if key is None else out + ENDING)
    with output.working("checking the budget") as progress:
        linear = one_blas_thread(ErrorPropagation.from_fit)(loaded.fit)
        found = one_blas_thread(budget)(linear, stated, where)
        content = one_blas_thread(certificate_content)(loaded, stated, found)
        write = _WRITERS[ending]
        file = write(content)  # before the draws, so that missing entries are reported at once
        if draws:
            drawn = monte_carlo(linear, stated, found, draws, seed, progress)
            content["monte_carlo"] = drawn.to_dict()
            file = write(content)
    output.write(out, file, _COMMENTS.get(ending, ""))
    if sign is not None:  # sign the written file, which also names the program
        output.write(out + ENDING, sign(read_bytes(out, "a certificate", InputError)))
    output.say(
        f"U = {1e6 * found.expanded_uncertainty:.4g} um (k = {found.coverage_factor:.2f}, 95 %) for one coordinate of"
        f" the tool, at poses like the {content['n_poses']} measured"
    )
    if draws:
        difference = (
            f"they differ by {100 * drawn.difference:.1f} % from the budget ({1e6 * found.combined_uncertainty:.4g} um)"
        )
        output.say(f"Monte Carlo: {drawn.draws} draws, {difference}")
    if not stated.model_fields_set:
        output.note("note: no 'traceability' is stated: the budget knows nothing of instrument and temperature")
    output.say(f"Written to {out}" + ("" if key is None else f", signed in {out}{ENDING}"))


def _traceability(result: LoadedResult, path: str | None) -> TraceabilitySection:
    """Return the traceability of a file, or of the description of a result."""
    description = result.nominal.description
    if path is not None:
        content = read_yaml(path, "a YAML file with the key 'traceability'")
        given = content.get("traceability", content) if isinstance(content, dict) else content
        own = description.model_dump(mode="json", exclude_unset=True)
        description = validate_description(own | {"traceability": given}, path)
    return description.traceability or TraceabilitySection()

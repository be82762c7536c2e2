"""`calib certificate`: a calibration certificate with its uncertainty budget, and its signature.

The signature is by a user's key: Ed25519 (RFC 8032), in base 64 in a file next to the certificate. Every byte of the
file counts, whatever its format. OpenSSL makes keys:

    openssl genpkey -algorithm ed25519 -out key.pem
    openssl pkey -in key.pem -pubout -out public.pem
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import click

from calib.core.base.errors import ComputationError, InputError, nearest, require_package
from calib.core.base.files import read_bytes
from calib.core.base.sections import read_yaml
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import quantity_text
from calib.core.base.version import DISTRIBUTION
from calib.core.base.words import json_file
from calib.core.commands.common import Output, shared_options
from calib.core.data.measurement_files import read_poses
from calib.core.results.loaded_result import LoadedResult
from calib.core.results.result_reading import load_result
from calib.core.robots.description import validate_description
from calib.quality.certificate import certificate_content, document
from calib.quality.dcc import xml
from calib.quality.monte_carlo import monte_carlo
from calib.quality.traceability import TraceabilitySection
from calib.quality.uncertainty_budget import ErrorPropagation, budget

_WRITERS: dict[str, Callable[[Mapping[str, Any]], bytes]] = {
    ".xml": xml,
    ".pdf": lambda content: document(content).pdf(),
    ".html": lambda content: document(content).html().encode(),
    ".json": json_file,
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
        f"U = {quantity_text(found.expanded_uncertainty, 'um', '.4g')} (k = {found.coverage_factor:.2f}, 95 %) for one"
        f" coordinate of the tool, at poses like the {content['n_poses']} measured"
    )
    if draws:
        of_budget = quantity_text(found.combined_uncertainty, "um", ".4g")
        difference = f"they differ by {100 * drawn.difference:.1f} % from the budget ({of_budget})"
        output.say(f"Monte Carlo: {drawn.draws} draws, {difference}")
    if content["verdict"] == "FAIL":
        output.note(f"note: the fit in {result} failed; {out} states the verdict")
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


ENDING = ".sig"
_MADE = {
    "private": "openssl genpkey -algorithm ed25519 -out key.pem",
    "public": "openssl pkey -in key.pem -pubout -out public.pem",
}


def signer(key: str, password: Callable[[], str]) -> Callable[[bytes], str]:
    """Return a function that signs a file's content by a private key (PEM); `password` is called if the key has one.

    Raises:
        InputError: `cryptography` is not installed, or the file is no such key.
    """
    text, load = read_bytes(key, "a private key", InputError), _library("serialization").load_pem_private_key
    try:
        private = load(text, None)
    except TypeError:  # it has a password
        private = _read_kind(key, "private", lambda: load(text, password().encode()))
    except ValueError:
        private = None
    if not isinstance(private, _library("asymmetric.ed25519").Ed25519PrivateKey):
        _refuse_key(key, "private")
    return lambda content: base64.b64encode(private.sign(content)).decode() + "\n"


def verify(path: str, key: str) -> None:
    """Check a file by the signature beside it and a public key (PEM).

    Raises:
        InputError: A file is missing, or is no such key.
        ComputationError: The file or its signature has changed, or another key signed it.
    """
    content, text = (read_bytes(each, what, InputError) for each, what in ((path, "a file"), (key, "a public key")))
    lines = read_bytes(path + ENDING, f"the signature of {path}", InputError).splitlines()
    public = _read_kind(key, "public", lambda: _library("serialization").load_pem_public_key(text))
    if not isinstance(public, _library("asymmetric.ed25519").Ed25519PublicKey):
        _refuse_key(key, "public")
    try:
        public.verify(base64.b64decode(lines[0] if lines else b"", validate=True), content)
    except (import_module("cryptography.exceptions").InvalidSignature, binascii.Error):
        raise ComputationError(
            f"{path}: does not match the signature with {key}: it or {path}{ENDING} was changed, or another key signed"
        ) from None


def _library(name: str) -> Any:
    missing = f"a signature needs cryptography: pip install '{DISTRIBUTION}[certificate]'"
    return require_package(f"cryptography.hazmat.primitives.{name}", missing)


def _read_kind(path: str, kind: str, load: Callable[[], Any]) -> Any:
    try:
        return load()
    except ValueError:
        _refuse_key(path, kind)


def _refuse_key(path: str, kind: str) -> NoReturn:
    raise InputError(
        f"{path}: is no {kind} Ed25519 key (PEM), or has another password; '{_MADE[kind]}' makes one"
    ) from None

"""A signature of a file by a user's key: Ed25519 (RFC 8032), in base 64 in a file next to it.

Every byte of the file counts, whatever its format. OpenSSL makes keys:

    openssl genpkey -algorithm ed25519 -out key.pem
    openssl pkey -in key.pem -pubout -out public.pem
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from importlib import import_module
from typing import Any, NoReturn

from calib.core.base.errors import ComputationError, InputError
from calib.core.base.files import read_bytes
from calib.core.base.version import DISTRIBUTION

ENDING = ".sig"
_MADE = {
    "private": "openssl genpkey -algorithm ed25519 -out key.pem",
    "public": "openssl pkey -in key.pem -pubout -out public.pem",
}


def signer(key: str, password: Callable[[], str]) -> Callable[[bytes], str]:
    """Return a function that signs a file's content.

    Args:
        key: File of the private key (PEM).
        password: Function that returns the key's password; called only if the key has one.

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
    """Check a file by the signature beside it.

    Args:
        path: The file.
        key: File of the public key (PEM).

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
    try:
        return import_module(f"cryptography.hazmat.primitives.{name}")
    except ImportError:
        raise InputError(f"a signature needs cryptography: pip install '{DISTRIBUTION}[certificate]'") from None


def _read_kind(path: str, kind: str, load: Callable[[], Any]) -> Any:
    try:
        return load()
    except ValueError:
        _refuse_key(path, kind)


def _refuse_key(path: str, kind: str) -> NoReturn:
    raise InputError(
        f"{path}: is no {kind} Ed25519 key (PEM), or has another password; '{_MADE[kind]}' makes one"
    ) from None

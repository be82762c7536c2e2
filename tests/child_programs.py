"""Programs that tests start and send signals to.

What a process ignores, the programs that it starts ignore too: SIGINT and SIGQUIT in the background of a script, SIGHUP
under nohup. A test that sends a signal starts its program here, where all of them do what they usually do.
"""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

SENT = (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGTERM)


@contextmanager
def usual_signals() -> Iterator[None]:
    """Ignore none of these signals; what is started here does not inherit that they were ignored."""
    ignored = [number for number in SENT if signal.getsignal(number) == signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def start(command: Sequence[object], **options: Any) -> subprocess.Popen[Any]:
    """Start a program that the usual signals end; options are those of `subprocess.Popen`."""
    with usual_signals():
        return subprocess.Popen([str(word) for word in command], **options)

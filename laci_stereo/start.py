"""Start of the console scripts: an interrupt while modules are still being imported ends them without a message."""

from __future__ import annotations

import os
import signal
from importlib import import_module
from types import FrameType

INTERRUPTED = 130
"""Exit code after an interrupt: 128 and the number of the signal."""


def start(module: str) -> None:
    """Import a module, which takes a second, and run its ``main``."""
    # An exception could be raised anywhere in the modules' own code, and be caught or converted into another one there.
    inherited = signal.getsignal(signal.SIGINT)
    if inherited is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
    main = import_module(module).main
    signal.signal(signal.SIGINT, inherited)
    main()


def _end(_signal: int, _frame: FrameType | None) -> None:
    os._exit(INTERRUPTED)


def main() -> None:
    """Run ``laci-stereo``."""
    start("laci_stereo.commands.cli")

"""Running a command line: errors become one line and an exit code."""

from __future__ import annotations

import _thread
import io
import os
import signal
import sys
import threading
from types import FrameType
from typing import TYPE_CHECKING

import click

from laci_stereo.core.errors import CalibrationError, LaciError
from laci_stereo.start import INTERRUPTED

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

NEGATIVE = 1
"""Exit code where the input was read, but it does not determine a calibration, a verdict is fail, results contradict
each other, or a log is of no use."""

UNUSABLE_INPUT = 2
"""Exit code where the input cannot be read or makes no sense."""


AFTER_DESTRUCTOR_S = 0.01
"""Wait before an interrupt is repeated: longer than a destructor takes, and too short to be noticed."""


def _terminate(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _interrupt_again(dropped: UnraisableHookArgs) -> None:
    """Interrupt once more after an interrupt that fell into a destructor, where Python drops every exception."""
    if issubclass(dropped.exc_type, KeyboardInterrupt):
        threading.Timer(AFTER_DESTRUCTOR_S, _interrupt, [threading.get_ident()]).start()
    else:
        sys.__unraisablehook__(dropped)


def _interrupt(thread: int) -> None:
    """Interrupt the main thread and, on POSIX, also what it waits for."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        signal.pthread_kill(thread, signal.SIGTERM)


def run_command(command: click.Command, program: str) -> None:
    """Run a command line: every error of the input becomes one line and an exit code."""
    _silence_decoders()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name may have letters that a terminal lacks
    signal.signal(signal.SIGTERM, _terminate)  # so that a half-written result is removed
    sys.unraisablehook = _interrupt_again
    message, code = _outcome(command, program)
    if message:
        click.echo(f"{program}: {message}", err=True)
    sys.exit(code)


def _outcome(command: click.Command, program: str) -> tuple[str, int]:
    """Return the message, in one line, and the exit code."""
    try:
        command(prog_name=program, standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        return "interrupted; nothing was written", INTERRUPTED
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return "", error.exit_code
    except click.UsageError as error:
        asked = error.ctx.command_path if error.ctx is not None else program
        return f"{error.format_message().rstrip('.')}; see {asked} --help", UNUSABLE_INPUT
    except CalibrationError as error:
        return f"not calibrated: {error}", NEGATIVE
    except LaciError as error:
        return str(error), UNUSABLE_INPUT
    except OSError as error:  # a file system that fails under a path that was readable before
        return f"{error.filename or 'input or output'}: {error.strerror}", UNUSABLE_INPUT
    return "", 0


def _silence_decoders() -> None:
    """Keep standard error for this program: libjpeg writes about damaged images to its descriptor, whatever is set."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    if sys.stderr is None:  # closed by whoever started the command
        sys.stderr = os.fdopen(nowhere, "w", encoding="utf-8")
        return
    ours = os.dup(sys.stderr.fileno())
    os.dup2(nowhere, sys.stderr.fileno())
    os.close(nowhere)
    sys.stderr = os.fdopen(ours, "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors)

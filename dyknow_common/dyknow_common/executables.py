"""Executables: their exit codes, and what they print instead of a traceback.

A command ends with SUCCESS (done, or a verdict that is not false), FALSE (a verdict of false) or
ERROR. An exception that nothing catches would end Python with 1, which means false here.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import fill

from dyknow_common.errors import error_text
from dyknow_main import SIGNALLED, TERMINAL_SIGNALS, handle, ignore

SUCCESS, FALSE, ERROR = 0, 1, 2

CANNOT_START = 1
"""The exit code of a node that cannot run, such as with a wrong configuration."""

FAULT = 70
"""The exit code of a node that a fault ended while it ran (EX_SOFTWARE of sysexits.h)."""

LAUNCHER = 'DYKNOW_LAUNCHER'
"""The variable with the id of the process that started a node and that it must not outlive."""

INTERRUPTED = SIGNALLED + signal.SIGINT

UNREAD = 141
"""The exit code of a command after the reader of its output, such as `head`, has ended."""

SOURCE_ENVIRONMENT = 'run first: source env.sh, or the setup.bash of the workspace'

_HELP_WIDTH = 79

_SCRIPT = """\
# EASY-INSTALL-ENTRY-SCRIPT: %(spec)r,%(group)r,%(name)r
import sys

try:
    from dyknow_main import load

    main = load(%(spec)r, %(name)r, is_node=%(name)r in NODES)
except ImportError as error:
    print(f'%(name)s: cannot start: {error}; SOURCE', file=sys.stderr)
    sys.exit(1 if %(name)r in NODES else 2)
except KeyboardInterrupt:
    sys.exit(0 if %(name)r in NODES else INTERRUPTED)
if __name__ == '__main__':
    sys.exit(main())
"""


def installed_version() -> str:
    """Return the version of the wheel without ROS, or of the packages of the workspace."""
    # It takes 20 ms, which most commands need not wait for.
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    for distribution in ('dyknow', 'dyknow_common'):
        with suppress(PackageNotFoundError):
            return version(distribution)
    return 'of a source folder'


def script_template(nodes: Collection[str] = ()) -> str:
    """Return the text of executables, for `ScriptWriter.template` of setuptools.

    The script of setuptools ends with a traceback where the environment is missing.

    Args:
        nodes: the executables that are nodes, whose exit code is 1 when they cannot start.
    """
    text = _SCRIPT.replace('NODES', repr(sorted(nodes))).replace('SOURCE', SOURCE_ENVIRONMENT)
    return text.replace('INTERRUPTED', str(INTERRUPTED))


def run_main(command: str, work: Callable[[], int]) -> int:
    """Do the work of a command and return its exit code; print errors in one line.

    Args:
        command: its name, for error messages.
        work: returns the exit code.
    """
    _replace_missing_outputs()
    try:
        try:
            return work()
        finally:
            sys.stdout.flush()
    except KeyboardInterrupt as interrupt:
        code = SIGNALLED + interrupt.args[0] if interrupt.args else INTERRUPTED
    except BrokenPipeError:
        code = UNREAD
    except Exception as error:  # noqa: BLE001 - a traceback and exit code 1 would mean false
        code = ERROR
        with suppress(OSError):
            sys.stderr.write(f'{command}: {error_text(error)}\n')
    _discard_output()
    return code


def describe(
    parser: argparse.ArgumentParser, description: str, examples: Sequence[str], exit_codes: str
) -> None:
    """Add to the help of a command what it does, and how it is used.

    Args:
        parser: the parser of the command.
        description: what it does, as a sentence.
        examples: examples of command lines.
        exit_codes: what 0, 1 and 2 mean.
    """
    parser.description = fill(description, _HELP_WIDTH)
    lines = '\n'.join(f'  {each}' for each in examples)
    codes = fill(f'Exit code: {exit_codes}.', _HELP_WIDTH)
    parser.epilog = f'Examples:\n{lines}\n\n{codes}'
    # It keeps the lines of the examples, and does not fill the others.
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


class Interruption:
    """The handler of the first signal that stops a command; later ones are ignored."""

    def __init__(self) -> None:
        self._number: int | None = None
        self._is_deferred = False

    def __call__(self, number: int, _: object) -> None:
        """Raise KeyboardInterrupt(number), unless that is deferred."""
        ignore(TERMINAL_SIGNALS)
        # The exception may end a constructor. Python would print that the finalizer fails then.
        sys.unraisablehook = lambda _: None
        self._number = number
        if not self._is_deferred:
            raise KeyboardInterrupt(number)

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Raise KeyboardInterrupt at the end of a block instead, which is done as a whole."""
        self._is_deferred = True
        try:
            yield
        finally:
            self._is_deferred = False
        if self._number is not None:
            raise KeyboardInterrupt(self._number)


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Raise KeyboardInterrupt(number) in a block at the first signal that stops a command.

    Later signals are ignored, so that they do not disturb the cleanup.
    """
    interruption = Interruption()
    handle(TERMINAL_SIGNALS, interruption)
    try:
        yield interruption
    finally:
        ignore(TERMINAL_SIGNALS)


def _replace_missing_outputs() -> None:
    """Discard text for outputs that the caller has closed; Python sets these to None."""
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open('w', encoding='utf-8'))  # noqa: SIM115
    # Names in formulas may have characters that the terminal's encoding lacks.
    with suppress(AttributeError):
        sys.stdout.reconfigure(errors='backslashreplace')  # type: ignore[union-attr]


def _discard_output() -> None:
    """Keep Python from writing the rest of the output at its end, which would fail again."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        return
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

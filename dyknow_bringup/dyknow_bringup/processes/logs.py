"""The logs of nodes: their warnings and errors, as records that a terminal can show."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_common import SECOND_NS, DyKnowError

LOG_ENVIRONMENT: Final = {
    'RCUTILS_CONSOLE_OUTPUT_FORMAT': '[{severity}] [{time}] [{name}]: {message}',
    'RCUTILS_COLORIZED_OUTPUT': '0',
}
"""Variables with which nodes log in the format that is read here, whatever the user prefers."""

PERIOD_NS: Final = 10 * SECOND_NS
MAX_RECORDS: Final = 20
"""Records of a node that are shown in a period."""

_RECORD: Final = re.compile(r'\[(DEBUG|INFO|WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]*)\]: (.*)')
_FAULTS_OF_PYTHON: Final = (
    'Traceback ',
    'Exception ignored ',
    'Fatal Python error',
    # The watchdog of a node that hangs prints the tracebacks of all threads.
    'Thread 0x',
    'Current thread 0x',
)
_SHOWN: Final = {'WARN', 'ERROR', 'FATAL'}
_MAX_LAST_LINES: Final = 15


@dataclass(frozen=True, slots=True)
class LogRecord:
    """A warning or an error; its text may have several lines.

    Args:
        level: `WARN`, `ERROR` or `FATAL`.
        text: the message.
        logger: the name of the logger, such as `robot1.stream_manager`; empty if there is none.
    """

    level: str
    text: str
    logger: str = ''


class LogReader:
    """The warnings and errors in a log, which grows.

    Records are complete lines. A line without the head of a record continues the record before it:

        [ERROR] [17.2] [stream_manager]: stream 'a' is not made: unknown unit    one record
            compunit u: float nothing((x: float))                                of three
                              ^^^^^^^                                            lines
        [INFO] [17.3] [stream_manager]: ...                                      not shown

    Args:
        file: the log; what it contains already is skipped.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._position = file.stat().st_size if file.exists() else 0
        self._level, self._logger = 'INFO', ''

    def read(self) -> tuple[LogRecord, ...]:
        """Return the warnings and errors since the last call."""
        records: list[tuple[str, str, list[str]]] = []
        for line in self._new_lines():
            head = _RECORD.match(line)
            if head is not None:
                self._level, self._logger, line = head.groups()  # noqa: PLW2901
                records.append((self._level, self._logger, [line]))
            elif line.startswith(_FAULTS_OF_PYTHON) and self._level not in _SHOWN:
                self._level, self._logger = 'ERROR', ''
                records.append((self._level, self._logger, [line]))
            elif records:
                records[-1][2].append(line)
            else:
                records.append((self._level, self._logger, [line]))
        return tuple(
            LogRecord(level, '\n'.join(lines).strip(), logger)
            for level, logger, lines in records
            if level in _SHOWN
        )

    def _new_lines(self) -> list[str]:
        if not self._file.exists():
            return []
        with self._file.open('rb') as log:
            log.seek(self._position)
            complete, newline, _ = log.read().rpartition(b'\n')
        self._position += len(complete) + len(newline)
        return complete.decode(errors='replace').split('\n') if newline else []


class LogThrottle:
    """Limits the records that are shown: MAX_RECORDS of a node in a period, none of them twice."""

    def __init__(self) -> None:
        self._end: int | None = None
        self._shown: Counter[str] = Counter()
        self._known: set[tuple[str, LogRecord]] = set()
        self._left_out: Counter[str] = Counter()

    def admit(self, name: str, record: LogRecord, now: int) -> bool:
        """Return True if a record of a node is to be shown."""
        if self._end is None:
            self._end = now + PERIOD_NS
        if (name, record) in self._known or self._shown[name] >= MAX_RECORDS:
            self._left_out[name] += 1
            return False
        self._known.add((name, record))
        self._shown[name] += 1
        return True

    def left_out(self, now: int) -> Iterator[tuple[str, int]]:
        """At the end of a period, yield the nodes with the number of records not shown."""
        if self._end is not None and now >= self._end:
            yield from self._left_out.items()
            self._end = None
            self._shown.clear()
            self._known.clear()
            self._left_out.clear()


@contextmanager
def log_folder(chosen: Path | None) -> Iterator[Path]:
    """Yield a folder for logs: the chosen one, or a temporary one, which an error alone leaves.

    Raises:
        BringupError: the error that ends the block, with the place of the logs.
    """
    if chosen is not None:
        chosen.mkdir(parents=True, exist_ok=True)
        yield chosen
        return
    folder = Path(tempfile.mkdtemp(prefix='dyknow_'))
    is_needed = False
    try:
        yield folder
    except DyKnowError as error:
        is_needed = True
        raise BringupError(f'{error}\nlogs are in {folder}', error.code) from None
    finally:
        if not is_needed:
            shutil.rmtree(folder, ignore_errors=True)


def last_lines(log: str) -> str:
    """Return the end of a log: what its node printed last beside its records, or the last lines."""
    lines = log.strip().splitlines()[-_MAX_LAST_LINES:]
    logged = [number for number, line in enumerate(lines) if _RECORD.match(line)]
    return '\n'.join(lines[logged[-1] + 1 :] if logged and logged[-1] + 1 < len(lines) else lines)

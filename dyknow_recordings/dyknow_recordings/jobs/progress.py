"""Progress of a check on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.progress import Progress


class ProgressBar:
    """The number of recordings that are checked, on the standard error output if it is a terminal.

    Args:
        total: the number of recordings; of one, nothing is shown.
    """

    def __init__(self, total: int) -> None:
        is_shown = total > 1 and sys.stderr.isatty()
        self._progress = _progress(total) if is_shown else None

    def __enter__(self) -> Self:
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def advance(self) -> None:
        """Count a recording."""
        if self._progress is not None:
            self._progress.advance(self._progress.task_ids[0])

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Remove the bar from the terminal for a while."""
        self.__exit__()
        yield
        self.__enter__()


def _progress(total: int) -> Progress:
    # Only a bar that is shown needs the time to import rich.
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import (  # noqa: PLC0415
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    progress = Progress(
        TextColumn('checking'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # It is removed while results are printed, perhaps to somewhere else.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    progress.add_task('', total=total)
    return progress

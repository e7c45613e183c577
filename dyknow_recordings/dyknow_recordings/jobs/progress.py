"""Progress of a check on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class ProgressBar:
    """The number of recordings that are checked, on the standard error output if it is a terminal.

    Args:
        total: the number of recordings; of one, nothing is shown.
    """

    def __init__(self, total: int) -> None:
        console = Console(stderr=True)
        self._progress = Progress(
            TextColumn('checking'),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            # It is removed while results are printed, perhaps to somewhere else.
            redirect_stdout=False,
            redirect_stderr=False,
            disable=total == 1 or not console.is_terminal,
        )
        self._task = self._progress.add_task('', total=total)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def advance(self) -> None:
        """Count a recording."""
        self._progress.advance(self._task)

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Remove the bar from the terminal for a while."""
        self._progress.stop()
        yield
        self._progress.start()

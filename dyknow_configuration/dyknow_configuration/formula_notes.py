"""Notes on formulas, as commands print them."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import suppress

from dyknow_common import LanguageError
from dyknow_reasoning import notes_on


def warn_of_notes(formulas: Iterable[str]) -> None:
    """Print the notes on formulas as warnings; an incorrect formula has none."""
    for formula in formulas:
        with suppress(LanguageError):
            for note in notes_on(formula):
                print(f'warning: {note}', file=sys.stderr)  # noqa: T201 - of a command

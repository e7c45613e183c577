"""The texts that parameters of the nodes name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

from dyknow_common import read_file
from dyknow_semantics.errors import SemanticsError

Sentence = TypeVar('Sentence')


def read_all(
    paths: Iterable[Path], what: str, parse: Callable[[str], tuple[Sentence, ...]]
) -> tuple[Sentence, ...]:
    """All that is said in some files.

    Args:
        paths: of the files.
        what: what they hold, for error messages.
        parse: makes sense of the text of one.

    Raises:
        SemanticsError: if a file cannot be read or parsed.
    """
    return tuple(
        sentence for path in paths for sentence in read_file(path, what, parse, SemanticsError)
    )

"""Reading files in one of the languages, or in a format of our own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from dyknow_common.errors import DyKnowError, ExitCode

Content = TypeVar('Content')


def read_file(
    path: Path, what: str, parse: Callable[[str], Content], fault: type[DyKnowError]
) -> Content:
    """What a text file says.

    Args:
        path: of the file, in UTF-8.
        what: what it holds, for error messages.
        parse: makes sense of its text.
        fault: the class of the error.

    Raises:
        DyKnowError: of that class, when the file cannot be read (NOT_FOUND) or parsed; it names the
            file.
    """
    try:
        text = path.read_text(encoding='utf-8')
    except OSError as error:
        message = f'cannot read the {what} in {path}: {error.strerror}'
        raise fault(message, ExitCode.NOT_FOUND) from None
    except UnicodeDecodeError:
        raise fault(f'cannot read the {what} in {path}: it is not in UTF-8') from None
    try:
        return parse(text)
    except DyKnowError as error:
        raise fault(f'{path}: {error.message}', error.code) from None

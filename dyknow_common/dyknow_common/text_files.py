"""Reading of text files, and replacing of files; all errors name the file and the reason."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TextIO, TypeVar

from dyknow_common.errors import DyKnowError, ExitCode, shortened
from dyknow_common.limits import MAX_FILE_BYTES

Content = TypeVar('Content')

NO_WAIT: Final = getattr(os, 'O_NONBLOCK', 0)
"""Opens a pipe without a wait for its other end; Windows has no such files."""

MAX_LINE: Final = 1 << 20
"""The most characters of a line of a file that is read line by line."""

_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, 'O_BINARY', 0)
"""Makes a new file; Windows alone would change the ends of its lines."""


@dataclass(frozen=True, slots=True)
class InlineText:
    """A text that is not in a file of its own.

    Args:
        name: says where it comes from, for messages.
        text: the text.
    """

    name: str
    text: str

    def __str__(self) -> str:
        return self.name


@contextmanager
def open_text(path: Path, content: str, error_class: type[DyKnowError]) -> Iterator[Iterator[str]]:
    """Yield the lines of a text file in UTF-8, with or without a byte order mark, one by one.

    It may be a pipe, and of any size: `read_text` is for files that are read as a whole. A line has
    at most MAX_LINE characters.

    Args:
        path: the path of the file.
        content: the kind of content in error messages, such as `streams`.
        error_class: the error class of the errors.

    Raises:
        DyKnowError: an `error_class`, if the file cannot be read (NOT_FOUND) or is not in UTF-8.
    """
    with _errors_of(path, content, error_class), path.open(encoding='utf-8-sig') as file:
        yield _lines(
            file, lambda reason: error_class(f'cannot read the {content} in {path}: {reason}')
        )


def _lines(file: TextIO, error: Callable[[str], DyKnowError]) -> Iterator[str]:
    number = 0
    while line := file.readline(MAX_LINE + 1):
        number += 1
        if len(line) > MAX_LINE:
            raise error(f'line {number} has more than {MAX_LINE:,} characters')
        yield line


def read_text(path: Path | InlineText, content: str, error_class: type[DyKnowError]) -> str:
    """Return the text of a file that a user has given, read in bounded time.

    Arguments and errors as in `open_text`. A folder, a pipe or a device cannot be read
    (NOT_FOUND), nor a file with more than MAX_FILE_BYTES.
    """
    if isinstance(path, InlineText):
        return path.text
    with _errors_of(path, content, error_class):
        read = read_regular(path, MAX_FILE_BYTES)
        if len(read) > MAX_FILE_BYTES:
            reason = f'it has more than {MAX_FILE_BYTES:,} bytes; split it'
            raise error_class(f'cannot read the {content} in {path}: {reason}')
        return read.decode('utf-8-sig').replace('\r\n', '\n').replace('\r', '\n')


def file_fault(path: Path) -> str:
    """Return why a path names no file with a content; an empty text if it does."""
    try:
        fault = f'{path} is no regular file' if path.exists() else f'there is no file {path}'
        return '' if path.is_file() else fault
    except OSError as error:  # Such as a formula in the place of the name, which is too long.
        return f'there is no file {shortened(path)}: {error.strerror}'


def read_regular(path: Path, max_bytes: int) -> bytes:
    """Return the content of a file, or its beginning: one byte more than a number of bytes.

    Raises:
        OSError: also if it is a folder, a pipe or a device, which is not read.
    """
    # Without a wait: a pipe may have no writer.
    with open(path, 'rb', opener=lambda name, flags: os.open(name, flags | NO_WAIT)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(0, 'it is no regular file')
        return file.read(max_bytes + 1)


@contextmanager
def _errors_of(path: Path, content: str, error_class: type[DyKnowError]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        message = f'cannot read the {content} in {shortened(path)}: {error.strerror}'
        raise error_class(message, ExitCode.NOT_FOUND) from None
    except UnicodeDecodeError:
        raise error_class(f'cannot read the {content} in {path}: it is not in UTF-8') from None


def read_file(
    path: Path | InlineText,
    content: str,
    parse: Callable[[str], Content],
    error_class: type[DyKnowError],
) -> Content:
    """Return the parsed text of a file.

    Raises:
        DyKnowError: an `error_class`, as for `open_text`, or with the error of the parser.
    """
    text = read_text(path, content, error_class)
    try:
        return parse(text)
    except DyKnowError as error:
        raise error_class(f'{path}: {error.message}', error.code) from None


def replace_file(path: Path, content: bytes, rights: int = 0o666) -> None:
    """Replace the content of a file.

    An interrupted replacement leaves the old content. A device or a pipe, such as `/dev/stdout`, is
    written to.

    Args:
        path: the path of the file.
        content: the new content.
        rights: the rights of the file, from which the umask of the process takes some.

    Raises:
        OSError: if it cannot be written; the old content is left.
    """
    if path.exists() and not path.is_file():
        path.write_bytes(content)
        return
    draft = path.with_name(f'{path.name}.new')
    try:
        draft.unlink(missing_ok=True)  # It may be a link, or left by an interrupted replacement.
        descriptor = os.open(draft, _CREATE, rights)
        with open(descriptor, 'wb') as file:  # noqa: PTH123 - with its rights
            file.write(content)
            file.flush()
            os.fsync(descriptor)
        draft.replace(path)
    except OSError:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise


def replace_text(path: Path, text: str) -> None:
    """Replace the content of a file by a text in UTF-8; see `replace_file`."""
    replace_file(path, text.encode())


def replace_private(path: Path, text: str) -> None:
    """Replace the content of a file, which its owner alone may read; see `replace_file`."""
    replace_file(path, text.encode(), 0o600)

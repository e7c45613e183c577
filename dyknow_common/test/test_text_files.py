"""Errors of files that cannot be read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dyknow_common import (
    DyKnowError,
    ExitCode,
    open_text,
    read_file,
    read_text,
    replace_file,
    replace_private,
    replace_text,
)


def test_a_missing_file(tmp_path: Path) -> None:
    message = f'cannot read the streams in {tmp_path}/a: No such file'
    with pytest.raises(DyKnowError, match=message) as error:
        read_text(tmp_path / 'a', 'streams', DyKnowError)
    assert error.value.code is ExitCode.NOT_FOUND


def test_a_file_in_another_encoding(tmp_path: Path) -> None:
    path = tmp_path / 'a'
    path.write_bytes(b'a\n\xff\n')
    with pytest.raises(DyKnowError, match='it is not in UTF-8'):
        read_text(path, 'streams', DyKnowError)
    with (
        pytest.raises(DyKnowError, match='it is not in UTF-8'),
        open_text(path, 'streams', DyKnowError) as lines,
    ):
        list(lines)


def test_errors_of_the_parser_name_the_file(tmp_path: Path) -> None:
    def parse(text: str) -> None:
        raise DyKnowError(text, ExitCode.ALREADY_EXISTS)

    path = tmp_path / 'a'
    path.write_text('b', encoding='utf-8')
    with pytest.raises(DyKnowError, match=f'^{path}: b$') as error:
        read_file(path, 'streams', parse, DyKnowError)
    assert error.value.code is ExitCode.ALREADY_EXISTS


def test_replacements_have_their_rights(tmp_path: Path) -> None:
    path = tmp_path / 'a'
    for replace, rights in ((replace_private, 0o600), (replace_text, 0o644)):
        umask = os.umask(0o022)
        try:
            replace(path, 'text ä\n')
        finally:
            os.umask(umask)
        assert path.stat().st_mode & 0o777 == rights
    assert path.read_text(encoding='utf-8') == 'text ä\n'
    with pytest.raises(FileNotFoundError):
        replace_text(tmp_path / 'missing' / 'a', 'text')


def test_a_device_or_a_pipe_is_written_to(tmp_path: Path) -> None:
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    replace_file(pipe, b'content')
    assert os.read(reader, 100) == b'content'
    os.close(reader)
    assert pipe.is_fifo()
    full = tmp_path / 'full'
    full.symlink_to('/dev/full')
    with pytest.raises(OSError, match='No space left on device'):
        replace_file(full, b'content')
    assert full.is_char_device()

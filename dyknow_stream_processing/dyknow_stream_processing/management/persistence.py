"""The file in which a stream manager keeps its streams over a restart, and its text."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Final

from dyknow_common import ExitCode, StreamConstraints, read_file, replace_private
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.management.streams import CreatedStream, RegisteredStream, Stream

_VERSION: Final = 1
"""The version of the format."""


class PersistenceFile:
    """File that keeps streams over a restart.

    Args:
        path: the path of the file; if empty, nothing is kept.
        manager: the name of the node whose streams it keeps.
    """

    def __init__(self, path: str, manager: str) -> None:
        self._manager = manager
        self._path = Path(path) if path else None
        self._written = ''

    def read(self) -> tuple[Stream, ...]:
        """Return the streams in the file; none if there is no file yet.

        Raises:
            StreamError: naming the file, if it cannot be read, was not written by `write`, or is
                the file of another manager.
        """
        if self._path is None or not os.path.lexists(self._path):
            return ()
        if not self._path.is_file():
            message = f'cannot read the streams in {self._path}: it is no regular file'
            raise StreamError(message)
        parse = partial(streams_from_json, manager=self._manager)
        return read_file(self._path, 'streams', parse, StreamError)

    def write(self, streams: Iterable[Stream]) -> None:
        """Replace the content of the file; an interrupted write leaves the old content.

        Raises:
            StreamError: if the file cannot be written.
        """
        if self._path is None:
            return
        text = streams_to_json(streams, self._manager)
        if text == self._written:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            replace_private(self._path, text)
        except OSError as error:
            raise StreamError(
                f'cannot write the memory {self._path}: {error.strerror}', ExitCode.UNAVAILABLE
            ) from None
        self._written = text


def streams_to_json(streams: Iterable[Stream], manager: str) -> str:
    """Return a text from which a manager can recreate its streams; times are in nanoseconds."""
    entries = [_to_entry(stream) for stream in streams]
    document = {'version': _VERSION, 'manager': manager, 'streams': entries}
    return json.dumps(document, indent=2, ensure_ascii=False) + '\n'


def streams_from_json(text: str, manager: str) -> tuple[Stream, ...]:
    """Return the streams in a text of `streams_to_json`; created ones wait for an engine.

    Raises:
        StreamError: if the text has another format, or belongs to another manager.
        LanguageError: if a specification in it is wrong.
    """
    try:
        document = json.loads(text)
        version = document.get('version', _VERSION)
        if version != _VERSION:
            raise StreamError(
                f'it has version {version}, and this stream manager writes version {_VERSION}; '
                'update the stream manager, or move the file away to begin with an empty one'
            )
        writer = document.get('manager', manager)
        if writer != manager:
            raise StreamError(f'it is the memory of {writer}; give {manager} a file of its own')
        return tuple(_from_entry(entry) for entry in document['streams'])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StreamError(
            f'it is not what a stream manager wrote ({type(error).__name__}: {error}); '
            'restore it from a backup, or move it away to begin with an empty one'
        ) from None


def _to_entry(stream: Stream) -> dict[str, Any]:
    if isinstance(stream, RegisteredStream):
        return asdict(stream)
    constraints = asdict(stream.constraints)
    return {
        'name': stream.name,
        'specification': stream.specification,
        'constraints': {key: value for key, value in constraints.items() if value is not None},
    }


def _from_entry(entry: dict[str, Any]) -> Stream:
    if 'specification' not in entry:
        return RegisteredStream(**entry)
    specification = entry['specification']
    parse_specification(specification)
    return CreatedStream(entry['name'], specification, StreamConstraints(**entry['constraints']))

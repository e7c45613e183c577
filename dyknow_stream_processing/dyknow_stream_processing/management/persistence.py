"""Text format in which a stream manager keeps its streams over a restart."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, Final

from dyknow_common import StreamConstraints
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.management.streams import CreatedStream, RegisteredStream, Stream

_VERSION: Final = 1
"""The version of the format."""


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

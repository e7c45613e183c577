"""What a stream manager keeps in a file over its own restart, and that of everybody else."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from dyknow_common import StreamConstraints
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.management.registry import CreatedStream, RegisteredStream, Stream


def write_memory(streams: Iterable[Stream]) -> str:
    """A text that holds what is needed to make streams anew; times are in nanoseconds."""
    entries = [_entry(stream) for stream in streams]
    return json.dumps({'streams': entries}, indent=2, ensure_ascii=False) + '\n'


def read_memory(text: str) -> tuple[Stream, ...]:
    """The streams in a text of `write_memory`; those that engines make wait for one.

    Raises:
        StreamError: when it is not such a text.
        LanguageError: when a specification in it is none.
    """
    try:
        return tuple(_stream(entry) for entry in json.loads(text)['streams'])
    except (ValueError, KeyError, TypeError) as error:
        raise StreamError(
            f'it is not what a stream manager wrote ({type(error).__name__}: {error}); delete it'
        ) from None


def _entry(stream: Stream) -> dict[str, Any]:
    if isinstance(stream, RegisteredStream):
        return asdict(stream)
    demands = {key: value for key, value in asdict(stream.constraints).items() if value is not None}
    return {
        'name': stream.name,
        'specification': stream.specification,
        'constraints': demands,
    }


def _stream(entry: dict[str, Any]) -> Stream:
    if 'specification' not in entry:
        return RegisteredStream(**entry)
    specification = entry['specification']
    parse_specification(specification)
    return CreatedStream(entry['name'], specification, StreamConstraints(**entry['constraints']))

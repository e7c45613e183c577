"""Errors of streams that no engine can make, with the mend."""

from __future__ import annotations

from collections.abc import Iterable

from dyknow_common import ExitCode
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.management.namespaces import Namespaces
from dyknow_stream_processing.management.streams import CreatedStream, Stream


def engines_missing(engines: Iterable[str], namespaces: Namespaces) -> StreamError:
    """Return the error if no engine is running.

    Args:
        engines: all engines that were ever found.
        namespaces: those in which engines are searched.
    """
    known = ', '.join(sorted(engines)) or 'none was ever seen'
    return StreamError(
        f'no stream processing engine is running in {namespaces} ({known}); start one there, or '
        f'name its namespace in the parameter engine_namespaces of the stream manager',
        ExitCode.UNAVAILABLE,
    )


def name_taken(stream: CreatedStream, others: Iterable[CreatedStream]) -> StreamError:
    """Return the error if engines already make streams of the name of a requested stream."""
    found = '; '.join(f'{other.engine} makes {other.definition}' for other in others)
    return StreamError(
        f"there is another stream '{stream.name}': {found}; requested is {stream.definition}; "
        f'destroy the other by stream_destroy of its engine, or choose another name',
        ExitCode.ALREADY_EXISTS,
    )


def two_streams(used: Stream, other: CreatedStream) -> StreamError:
    """Return the error if an engine makes another stream of the name of one in use."""
    if isinstance(used, CreatedStream):
        description = f'that of {used.engine}, {used.definition},'
    else:
        description = f'the registered topic {used.topic}'
    return StreamError(
        f"there are two streams '{used.name}': {description} is used, that of {other.engine}, "
        f'{other.definition}, is not; destroy it by {other.engine}/stream_destroy',
        ExitCode.ALREADY_EXISTS,
    )

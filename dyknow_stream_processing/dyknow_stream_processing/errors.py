"""Errors of streams."""

from collections.abc import Iterable

from dyknow_common import DyKnowError, ExitCode


class StreamError(DyKnowError):
    """A stream cannot be created, found or kept, or a sample does not fit its specification."""


def unknown_stream(name: str, known: Iterable[str]) -> StreamError:
    """Return the error about a stream that does not exist, given those that do."""
    listed = ', '.join(known) or 'none'
    return StreamError(f"there is no stream '{name}' (there are: {listed})", ExitCode.NOT_FOUND)


def stream_replaced(topic: str) -> StreamError:
    """Return the error about a stream that is not the one that its reader has chosen."""
    return StreamError(
        f'{topic} has another stream than the one that was chosen, which was replaced or is being '
        'recreated; ask for the streams again',
        ExitCode.UNAVAILABLE,
    )

"""Errors of streams."""

from collections.abc import Iterable, Mapping

from dyknow_common import Alternatives, DyKnowError, ExitCode, Value


class StreamError(DyKnowError):
    """A stream cannot be created, found or kept, or a sample does not fit its specification."""


def unknown_stream(name: str, known: Iterable[str], topic: str = '') -> StreamError:
    """Return the error about a stream that does not exist.

    Args:
        name: the name of the stream.
        known: the names of the existing streams.
        topic: the absolute topic that was probably meant.
    """
    listed = ', '.join(known) or 'none'
    hint = f'; for the topic, write "{topic}"' if topic else ''
    if topic not in {'', f'/{name}'}:
        hint += f'; where the namespace varies, make a stream or a feature of "{name}"'
    text = f"there is no stream '{name}' (there are: {listed}){hint}"
    return StreamError(text, ExitCode.NOT_FOUND)


def open_value(fields: Mapping[str, Value], use: str) -> StreamError:
    """Return the error about a field that has alternatives, and cannot be used in some way."""
    name, value = next(
        (name, each) for name, each in fields.items() if isinstance(each, Alternatives)
    )
    return StreamError(
        f"field '{name}' is {value.description}, so it cannot be {use}; use it in formulas as it is"
    )


def stream_replaced(topic: str) -> StreamError:
    """Return the error about a stream that another one has replaced."""
    return StreamError(
        f'{topic} has another stream than the one that was chosen, which was replaced or is being '
        'recreated; ask for the streams again',
        ExitCode.UNAVAILABLE,
    )

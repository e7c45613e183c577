"""Streams: samples, the stream language, operators, and what all languages and nodes share."""

from dyknow_stream_processing.durations import (
    DURATION_PATTERN,
    NANOSECONDS,
    format_duration,
    format_time,
    parse_duration,
)
from dyknow_stream_processing.errors import DyKnowError, ExitCode, StreamError
from dyknow_stream_processing.language import NOWHERE, Language, LanguageError, Place
from dyknow_stream_processing.sample import Sample, Value, ValueType

__all__ = [
    'DURATION_PATTERN',
    'NANOSECONDS',
    'NOWHERE',
    'DyKnowError',
    'ExitCode',
    'Language',
    'LanguageError',
    'Place',
    'Sample',
    'StreamError',
    'Value',
    'ValueType',
    'format_duration',
    'format_time',
    'parse_duration',
]

"""Streams: samples, the stream language, operators, and what all languages and nodes share."""

from dyknow_stream_processing.computational_units import Unit, load_units
from dyknow_stream_processing.constraints import NO_CONSTRAINTS, StreamConstraints
from dyknow_stream_processing.dataflow import Dataflow, SourceType, Statistics
from dyknow_stream_processing.demand import ALL
from dyknow_stream_processing.durations import (
    DURATION_PATTERN,
    NANOSECONDS,
    format_duration,
    format_time,
    parse_duration,
    round_duration,
    round_time,
)
from dyknow_stream_processing.errors import DyKnowError, ExitCode, StreamError
from dyknow_stream_processing.field_paths import FIELD_PATH, absence, all_elements, listed_as
from dyknow_stream_processing.language import NOWHERE, Language, LanguageError, Place
from dyknow_stream_processing.parsing import parse_specification
from dyknow_stream_processing.physical_units import check_unit, conversion
from dyknow_stream_processing.resolution import FreeNames, Resolved, free_names, resolve
from dyknow_stream_processing.sample import PartialFields, Sample, Value, ValueType
from dyknow_stream_processing.sinks import specifications_by_sink
from dyknow_stream_processing.specification import (
    Approximation,
    Argument,
    Call,
    Condition,
    Declaration,
    Merge,
    Reference,
    Select,
    Selection,
    SinkDeclaration,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    Sync,
    Term,
    TypedField,
    UnitDeclaration,
    made,
    references,
)
from dyknow_stream_processing.text_files import read_file
from dyknow_stream_processing.violation import Broken, Violation

__all__ = [
    'ALL',
    'DURATION_PATTERN',
    'FIELD_PATH',
    'NANOSECONDS',
    'NOWHERE',
    'NO_CONSTRAINTS',
    'Approximation',
    'Argument',
    'Broken',
    'Call',
    'Condition',
    'Dataflow',
    'Declaration',
    'DyKnowError',
    'ExitCode',
    'FreeNames',
    'Language',
    'LanguageError',
    'Merge',
    'PartialFields',
    'Place',
    'Reference',
    'Resolved',
    'Sample',
    'Select',
    'Selection',
    'SinkDeclaration',
    'SourceDeclaration',
    'SourceType',
    'Specification',
    'Statistics',
    'StreamConstraints',
    'StreamDeclaration',
    'StreamError',
    'Sync',
    'Term',
    'TypedField',
    'Unit',
    'UnitDeclaration',
    'Value',
    'ValueType',
    'Violation',
    'absence',
    'all_elements',
    'check_unit',
    'conversion',
    'format_duration',
    'format_time',
    'free_names',
    'listed_as',
    'load_units',
    'made',
    'parse_duration',
    'parse_specification',
    'read_file',
    'references',
    'resolve',
    'round_duration',
    'round_time',
    'specifications_by_sink',
]

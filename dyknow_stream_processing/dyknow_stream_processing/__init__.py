"""Streams: samples, the stream language, and the dataflow that runs specifications."""

from dyknow_stream_processing.aggregates import NoValueError
from dyknow_stream_processing.dataflow.batches import (
    NeedsStepsError,
    SampleBatch,
    column_of,
    concatenated,
    never,
    rows_of,
)
from dyknow_stream_processing.dataflow.computational_units import STATELESS_UNITS, load_units
from dyknow_stream_processing.dataflow.dataflow import (
    DEFAULT_MAX_LEAD,
    Dataflow,
    Statistics,
    ignore,
)
from dyknow_stream_processing.dataflow.drift import GAP_PERIODS, Coverage
from dyknow_stream_processing.dataflow.forecasts import MAX_STEPS, Forecast
from dyknow_stream_processing.dataflow.operators import (
    OTHER_CLOCK_NS,
    DelayLimits,
    SourceType,
    is_normal_wait,
)
from dyknow_stream_processing.dataflow.received import OVERTAKEN, ReceivedViolations
from dyknow_stream_processing.errors import StreamError, unknown_stream
from dyknow_stream_processing.language.built_in_sources import TF_STATIC, built_in_fields
from dyknow_stream_processing.language.parsing import LONG_TEXT, parse_specification
from dyknow_stream_processing.language.required_fields import ALL, WHOLE, total_demand
from dyknow_stream_processing.language.resolution import FreeNames, free_names, resolve
from dyknow_stream_processing.language.sinks import made, specifications_by_sink
from dyknow_stream_processing.language.specification import (
    Approximation,
    BuiltInSource,
    Call,
    Condition,
    Merge,
    Select,
    Selection,
    SinkDeclaration,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Sync,
    Term,
    TypedField,
    UnitArgument,
    UnitDeclaration,
    references,
    subterms,
)
from dyknow_stream_processing.language.type_rules import Nanoseconds, Unit
from dyknow_stream_processing.management.relocation import in_namespace
from dyknow_stream_processing.management.streams import read_streams
from dyknow_stream_processing.path_values import value_reader
from dyknow_stream_processing.reporting.silence import (
    PEER_STREAMS,
    SILENT_PERIODS,
    joined_reasons,
    nearest_topics,
)
from dyknow_stream_processing.reporting.stream_report import SAMPLE_TYPE
from dyknow_stream_processing.sample import (
    VALUE_PARSERS,
    PartialFields,
    Sample,
    WholeMessage,
    nearest_absence,
)
from dyknow_stream_processing.violation import Violation, ViolationKind

__all__ = [
    'ALL',
    'DEFAULT_MAX_LEAD',
    'GAP_PERIODS',
    'LONG_TEXT',
    'MAX_STEPS',
    'OTHER_CLOCK_NS',
    'OVERTAKEN',
    'PEER_STREAMS',
    'SAMPLE_TYPE',
    'SILENT_PERIODS',
    'STATELESS_UNITS',
    'TF_STATIC',
    'VALUE_PARSERS',
    'WHOLE',
    'Approximation',
    'BuiltInSource',
    'Call',
    'Condition',
    'Coverage',
    'Dataflow',
    'DelayLimits',
    'Forecast',
    'FreeNames',
    'Merge',
    'Nanoseconds',
    'NeedsStepsError',
    'NoValueError',
    'PartialFields',
    'ReceivedViolations',
    'Sample',
    'SampleBatch',
    'Select',
    'Selection',
    'SinkDeclaration',
    'SourceDeclaration',
    'SourceType',
    'Specification',
    'Statistics',
    'StreamDeclaration',
    'StreamError',
    'StreamReference',
    'Sync',
    'Term',
    'TypedField',
    'Unit',
    'UnitArgument',
    'UnitDeclaration',
    'Violation',
    'ViolationKind',
    'WholeMessage',
    'built_in_fields',
    'column_of',
    'concatenated',
    'free_names',
    'ignore',
    'in_namespace',
    'is_normal_wait',
    'joined_reasons',
    'load_units',
    'made',
    'nearest_absence',
    'nearest_topics',
    'never',
    'parse_specification',
    'read_streams',
    'references',
    'resolve',
    'rows_of',
    'specifications_by_sink',
    'subterms',
    'total_demand',
    'unknown_stream',
    'value_reader',
]

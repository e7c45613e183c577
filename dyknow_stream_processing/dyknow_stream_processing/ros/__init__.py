"""What touches ROS: the parts that every node shares, StreamProxy, and the nodes of streams."""

from dyknow_stream_processing.ros.commands import CommandNode, duration, run_command
from dyknow_stream_processing.ros.conversion import (
    constraints_from_message,
    constraints_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_stream_processing.ros.guest import Guest
from dyknow_stream_processing.ros.lease import Lease, with_own_lease
from dyknow_stream_processing.ros.message_conversion import conversion, extractor
from dyknow_stream_processing.ros.message_types import message_class, scalar_fields, stamp_of
from dyknow_stream_processing.ros.message_values import FieldReader, without_element
from dyknow_stream_processing.ros.numbering import Numbering, publishers_of
from dyknow_stream_processing.ros.peer import Peer
from dyknow_stream_processing.ros.runtime import (
    LATCHED,
    LATCHED_HISTORY,
    NO_PUBLISHER_EVENTS,
    NO_SUBSCRIPTION_EVENTS,
    RUNNING,
    SERVICE,
    STREAM,
    VIOLATIONS,
    DyKnowNode,
    fill_exit_status,
    run,
    snake_case,
)
from dyknow_stream_processing.ros.sample_messages import (
    SampleWriter,
    sample_fields,
    sample_to_message,
)
from dyknow_stream_processing.ros.stream_proxy import StreamProxy
from dyknow_stream_processing.ros.topic_sources import source_type

__all__ = [
    'LATCHED',
    'LATCHED_HISTORY',
    'NO_PUBLISHER_EVENTS',
    'NO_SUBSCRIPTION_EVENTS',
    'RUNNING',
    'SERVICE',
    'STREAM',
    'VIOLATIONS',
    'CommandNode',
    'DyKnowNode',
    'FieldReader',
    'Guest',
    'Lease',
    'Numbering',
    'Peer',
    'SampleWriter',
    'StreamProxy',
    'constraints_from_message',
    'constraints_to_message',
    'conversion',
    'duration',
    'extractor',
    'fill_exit_status',
    'message_class',
    'nanoseconds_to_duration',
    'nanoseconds_to_time',
    'publishers_of',
    'run',
    'run_command',
    'sample_fields',
    'sample_to_message',
    'scalar_fields',
    'snake_case',
    'source_type',
    'stamp_of',
    'time_to_nanoseconds',
    'with_own_lease',
    'without_element',
]

"""The ROS layer of streams: StreamProxy, messages and their fields, gaps, pauses, and nodes."""

from dyknow_stream_processing.ros.messages.conversions import (
    extractor,
    message_conversion,
    with_value,
)
from dyknow_stream_processing.ros.messages.message_types import (
    check_fields,
    interface_class,
    message_class,
    scalar_fields,
    valid_time_reader,
)
from dyknow_stream_processing.ros.messages.sample_messages import (
    SampleReader,
    SampleWriter,
    publication_number,
    sample_fields,
    sample_to_message,
    sample_valid_time,
    sample_violated_at,
)
from dyknow_stream_processing.ros.messages.writing import FieldError, MessageWriter
from dyknow_stream_processing.ros.stream_proxy import StreamProxy
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics
from dyknow_stream_processing.ros.topics.process_pauses import (
    PAUSES,
    is_pause_recent,
    time_of_receipt,
)
from dyknow_stream_processing.ros.topics.publications import (
    Publication,
    find_publication,
    next_request,
    publishers_of,
    source_type,
    take_waiting,
)
from dyknow_stream_processing.ros.topics.sequence_gaps import SequenceGaps
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources
from dyknow_stream_processing.ros.topics.violation_relay import violations_topic
from dyknow_stream_processing.ros.topics.watermark_topics import WATERMARKS, watermarks_topic

__all__ = [
    'PAUSES',
    'WATERMARKS',
    'FieldError',
    'MessageWriter',
    'NodeTopics',
    'Publication',
    'SampleReader',
    'SampleWriter',
    'SequenceGaps',
    'StreamProxy',
    'TopicSources',
    'check_fields',
    'extractor',
    'find_publication',
    'interface_class',
    'is_pause_recent',
    'message_class',
    'message_conversion',
    'next_request',
    'publication_number',
    'publishers_of',
    'sample_fields',
    'sample_to_message',
    'sample_valid_time',
    'sample_violated_at',
    'scalar_fields',
    'source_type',
    'take_waiting',
    'time_of_receipt',
    'valid_time_reader',
    'violations_topic',
    'watermarks_topic',
    'with_value',
]

"""StreamProxy: any topic as a stream that keeps its constraints (paper, section VI, Fig. 5)."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from rclpy.node import Node
from rclpy.qos import QoSProfile

from dyknow_common import NO_CONSTRAINTS, StreamConstraints
from dyknow_stream_processing.dataflow.computational_units import load_units
from dyknow_stream_processing.dataflow.dataflow import Dataflow, Statistics
from dyknow_stream_processing.dataflow.operators import SourceType
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.language.parsing import parse_specification
from dyknow_stream_processing.language.required_fields import total_demand
from dyknow_stream_processing.language.resolution import resolve
from dyknow_stream_processing.language.sinks import sink_message
from dyknow_stream_processing.ros.topics.publications import publishers_remark, source_type
from dyknow_stream_processing.ros.topics.topic_sources import TopicSources
from dyknow_stream_processing.sample import Sample
from dyknow_stream_processing.violation import Violation

_TOPIC: Final = re.compile(r'[~/]?[A-Za-z_][\w/]*')
_NAME: Final = 'proxy'


class StreamProxy:
    """A stream within a node, made of topics of any type.

    Topics may appear, disappear and come back with other publishers at any time. The valid time of
    a sample is the stamp of the message's header, or the time of sending if it has none.

    Args:
        node: the node that subscribes; its clock gives the available times.
        stream: the name of a topic, or a specification in the stream language.
        on_sample: receives each sample, in the order of valid times.
        on_violation: receives each violation of a constraint.
        constraints: are added to those in the specification.
        valid_time: the dotted path of a field of the type `builtin_interfaces/Time` that holds the
            valid time; a mapping by topic if the specification names several.
        message_type: the message class, to subscribe before the topic is published; a mapping by
            topic if the specification names several.
        quality_of_service: by default it is matched to the publishers of each topic.

    Raises:
        LanguageError: if the specification is invalid.
        StreamError: if constraints contradict each other, or a topic has no such field of time.
        TypeError: names an argument of a wrong type.
    """

    def __init__(
        self,
        node: Node,
        stream: str,
        *,
        on_sample: Callable[[Sample], None],
        on_violation: Callable[[Violation], None] = lambda _: None,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        valid_time: str | Mapping[str, str] | None = None,
        message_type: Any = None,
        quality_of_service: QoSProfile | None = None,
    ) -> None:
        _check_types(node, stream, constraints, on_sample, on_violation)
        _check_options(valid_time, message_type, quality_of_service)
        text = json.dumps(stream) if _TOPIC.fullmatch(stream) else stream
        valid_times: Mapping[str, str] = {}
        message_types: Mapping[str, Any] = {}

        def type_of(topic: str) -> SourceType | None:
            return source_type(node, topic, message_types.get(topic), valid_times.get(topic))

        self._dataflow = Dataflow(
            load_units(), type_of, remark=lambda topics: publishers_remark(node, topics)
        )
        specification = parse_specification(text)
        if sink_message(specification) is not None:
            raise StreamError("a StreamProxy publishes nothing; leave out the 'as' of the sink")
        if valid_time is not None or message_type is not None:
            resolved = resolve(specification, constraints, {}, lambda _: None, load_units())
            topics = total_demand([resolved.term])
            valid_times = _by_topic('valid_time', valid_time, topics)
            message_types = _by_topic('message_type', message_type, topics)
        self._dataflow.create(_NAME, specification, constraints, on_sample, on_violation)
        self._sources = TopicSources(
            node, self._dataflow, quality_of_service, valid_times, message_types
        )
        self._sources.refresh()

    @property
    def statistics(self) -> Statistics:
        """The numbers of samples, violations and drops so far."""
        return self._dataflow.statistics(_NAME)

    @property
    def drops(self) -> dict[str, int]:
        """The numbers of dropped samples, by reason."""
        return dict(self.statistics.drops)

    def destroy(self) -> None:
        """Destroy all subscriptions; a second call does nothing."""
        self._sources.destroy()


def _check_types(node: object, stream: object, constraints: object, *callbacks: object) -> None:
    if not isinstance(node, Node):
        raise TypeError(f'node must be a node of rclpy, not {node!r}')
    if not isinstance(stream, str):
        raise TypeError(f'stream must be a topic or a specification as a text, not {stream!r}')
    if not isinstance(constraints, StreamConstraints):
        raise TypeError(f'constraints must be a StreamConstraints, not {constraints!r}')
    for name, callback in zip(('on_sample', 'on_violation'), callbacks, strict=True):
        if not callable(callback):
            raise TypeError(f'{name} must be a function, not {callback!r}')


def _check_options(valid_time: object, message_type: object, quality_of_service: object) -> None:
    fields = valid_time.values() if isinstance(valid_time, Mapping) else [valid_time]
    if not all(isinstance(each, str | None) for each in fields):
        raise TypeError(f'valid_time must be a field, or one for each topic, not {valid_time!r}')
    types = message_type.values() if isinstance(message_type, Mapping) else [message_type]
    if not all(each is None or hasattr(each, 'get_fields_and_field_types') for each in types):
        raise TypeError(
            f'message_type must be the class of a message, or one for each topic, not '
            f'{message_type!r}'
        )
    if not isinstance(quality_of_service, QoSProfile | None):
        raise TypeError(f'quality_of_service must be a QoSProfile, not {quality_of_service!r}')


def _by_topic(argument: str, value: Any, topics: Collection[str]) -> Mapping[str, Any]:
    """Return an argument as a mapping by topic; a single value needs a single topic."""
    if value is None:
        return {}
    if isinstance(value, Mapping):
        if unknown := sorted(set(value) - set(topics)):
            raise StreamError(
                f"{argument} is given for '{unknown[0]}', which the stream is not made of "
                f'(it is made of: {", ".join(topics)})'
            )
        return value
    if len(topics) > 1:
        raise StreamError(
            f'the stream is made of several topics ({", ".join(topics)}); give {argument} as a '
            f'mapping from topics'
        )
    return dict.fromkeys(topics, value)

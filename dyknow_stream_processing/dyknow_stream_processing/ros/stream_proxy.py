"""StreamProxy: any topic as a stream that keeps its constraints (paper, section VI, Fig. 5)."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

from dyknow_stream_processing.computational_units import load_units
from dyknow_stream_processing.constraints import NO_CONSTRAINTS, StreamConstraints
from dyknow_stream_processing.dataflow import Dataflow
from dyknow_stream_processing.parsing import parse_specification
from dyknow_stream_processing.ros.topic_sources import TopicSources, source_type

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.qos import QoSProfile

    from dyknow_stream_processing.sample import Sample
    from dyknow_stream_processing.violation import Violation

_TOPIC = re.compile(r'[~/]?[A-Za-z_][\w/]*')
_NAME = 'proxy'


class StreamProxy:
    """A stream within a node, made of topics of any type.

    Args:
        node: the node that listens; its clock tells when samples are available.
        stream: the name of a topic, or a specification in the stream language.
        on_sample: is given each sample, in the order of valid times.
        on_violation: is told when a constraint is broken.
        constraints: are added to those in the specification.
        quality_of_service: by default it is matched to the publishers of each topic.

    Raises:
        LanguageError: when the specification makes no sense.
        StreamError: when constraints contradict each other.
    """

    def __init__(
        self,
        node: Node,
        stream: str,
        *,
        on_sample: Callable[[Sample], None],
        on_violation: Callable[[Violation], None] = lambda _: None,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        quality_of_service: QoSProfile | None = None,
    ) -> None:
        text = json.dumps(stream) if _TOPIC.fullmatch(stream) else stream
        self._dataflow = Dataflow(load_units(), lambda topic: source_type(node, topic))
        self._dataflow.create(
            _NAME, parse_specification(text), constraints, on_sample, on_violation
        )
        self._sources = TopicSources(node, self._dataflow, quality_of_service)
        self._sources.refresh()

    @property
    def drops(self) -> dict[str, int]:
        """How many samples were dropped, by reason."""
        return dict(self._dataflow.statistics(_NAME).drops)

    def destroy(self) -> None:
        """Stops listening."""
        self._sources.destroy()

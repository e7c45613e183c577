"""The seven nodes of DyKnow in one process, each with its own name, parameters and services.

ros2 run dyknow_bringup dyknow_nodes --ros-args -p stream_manager:streams:='[robot.streams]'

The module of a node is imported just before the node is made. Other processes so discover the
topics and services over a second, while the next modules are imported. All at once, they would
fill the receive buffers of processes that have no processor at that time; the middleware repeats
what is lost only one to three seconds later.
"""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any, Final

from dyknow_common import DyKnowError
from dyknow_common.executables import SOURCE_ENVIRONMENT
from dyknow_common.ros import run
from dyknow_main import without_collections

NODES: Final = (
    'dyknow_stream_processing.ros.stream_processing_engine:StreamProcessingEngine',
    'dyknow_stream_processing.ros.stream_manager:StreamManager',
    'dyknow_reasoning.ros.stream_reasoning_engine:StreamReasoningEngine',
    'dyknow_semantics.ros.ontology_manager:OntologyManager',
    'dyknow_semantics.ros.semantic_matching_engine:SemanticMatchingEngine',
    'dyknow_semantics.ros.stream_semantics_manager:StreamSemanticsManager',
    'dyknow_coordinator.ros.stream_reasoning_coordinator:StreamReasoningCoordinator',
)


def main() -> int:
    """Run the executable dyknow_nodes."""
    return run(*map(_imported_later, NODES))


def _imported_later(path: str) -> Callable[[], Any]:
    """Return a function that imports the class of a node and makes the node."""

    def make_node() -> Any:
        try:
            with without_collections():
                node_class = resolve_name(path)
        except ImportError as error:
            raise DyKnowError(f'cannot start: {error}; {SOURCE_ENVIRONMENT}') from error
        return node_class()

    make_node.__name__ = path.partition(':')[2]
    return make_node

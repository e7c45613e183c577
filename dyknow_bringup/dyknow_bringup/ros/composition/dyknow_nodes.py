"""The seven nodes of DyKnow in one process, each with its own name, parameters and services.

ros2 run dyknow_bringup dyknow_nodes --ros-args -p stream_manager:streams:='[robot.streams]'
"""

from __future__ import annotations

from dyknow_common.ros import run
from dyknow_coordinator.ros.stream_reasoning_coordinator import StreamReasoningCoordinator
from dyknow_reasoning.ros.stream_reasoning_engine import StreamReasoningEngine
from dyknow_semantics.ros.ontology_manager import OntologyManager
from dyknow_semantics.ros.semantic_matching_engine import SemanticMatchingEngine
from dyknow_semantics.ros.stream_semantics_manager import StreamSemanticsManager
from dyknow_stream_processing.ros.stream_manager import StreamManager
from dyknow_stream_processing.ros.stream_processing_engine import StreamProcessingEngine

NODES = (
    OntologyManager,
    SemanticMatchingEngine,
    StreamManager,
    StreamProcessingEngine,
    StreamReasoningCoordinator,
    StreamReasoningEngine,
    StreamSemanticsManager,
)


def main() -> int:
    """Run the executable dyknow_nodes."""
    return run(*NODES)

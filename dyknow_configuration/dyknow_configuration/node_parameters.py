"""The parameters of the nodes of DyKnow, which a check reads without ROS.

A test compares them with the reference of the nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

COMMON: Final = ('hang_limit', 'use_sim_time')
"""The parameters of every node."""

PARAMETERS: Final[Mapping[str, tuple[str, ...]]] = {
    'stream_processing_engine': (
        'clock_tolerance',
        'default_max_delay',
        'default_max_lead',
        'default_transport_delay',
        'max_specification',
        'max_streams',
        'stream_prefix',
        'watermark_period',
    ),
    'stream_manager': (
        'discovery_period',
        'engine_namespaces',
        'max_specification',
        'max_streams',
        'memory',
        'naming_convention',
        'streams',
    ),
    'ontology_manager': (
        'allow_download',
        'bridges',
        'load_limit',
        'max_bytes',
        'max_solutions',
        'max_statements',
        'ontologies',
        'ontology_path',
        'query_limit',
        'reasoner',
        'reasoning_limit',
        'store',
        'worker_memory',
    ),
    'stream_semantics_manager': (
        'annotations',
        'max_annotations',
        'max_characters',
        'ontology_manager',
        'store',
        'stream_manager',
    ),
    'semantic_matching_engine': (
        'bridges',
        'max_characters',
        'max_matches',
        'ontology_manager',
        'stream_semantics_manager',
    ),
    'stream_reasoning_engine': (
        'formula_limit',
        'group_limit',
        'idle_group_limit',
        'instance_limit',
        'instance_part_limit',
        'node_limit',
        'object_limit',
        'orphan_limit',
        'part_limit',
        'possibility_limit',
        'progress_period',
        'total_part_limit',
        'violation_patience',
    ),
    'stream_reasoning_coordinator': (
        'default_timeout',
        'ended_limit',
        'evaluation_limit',
        'feature_limit',
        'keep_ended',
        'object_limit',
        'ontology_manager',
        'plan_limit',
        'plan_part_limit',
        'semantic_matching_engine',
        'silence_limit',
        'stream_manager',
        'stream_reasoning_engine',
        'stream_semantics_manager',
        'timeout_limit',
        'verdict_topic_limit',
    ),
    'black_box_recorder': (
        'coordinator',
        'folder',
        'folder_bytes',
        'max_boxes',
        'max_per_minute',
        'memory_bytes',
        'memory_messages',
        'ontology_manager',
        'robot',
        'snapshot_service',
        'stream_manager',
    ),
}
"""The other parameters of the nodes that a file may configure."""

"""The parameters of the recorder of black boxes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from dyknow_common.ros import DyKnowNode

_NAMES = {
    'coordinator': ('stream_reasoning_coordinator', 'Name of the coordinator node.'),
    'stream_manager': ('stream_manager', 'Name of the stream manager node.'),
    'ontology_manager': ('ontology_manager', 'Name of the ontology manager node.'),
    'folder': ('~/.ros/dyknow/black_boxes', 'Folder of the black boxes; it is made if needed.'),
    'robot': ('', 'robot.yaml of the system, whose text is put into the boxes.'),
    'snapshot_service': (
        '',
        'Snapshot service of a recorder of rosbag2, which is called instead of writing boxes.',
    ),
}
_LIMITS = {
    'memory_bytes': (200_000_000, 'Bytes of all messages that are kept in memory.'),
    'memory_messages': (200_000, 'Messages that are kept in memory.'),
    'folder_bytes': (1_000_000_000, 'Bytes of all boxes; the oldest are removed for new ones.'),
    'max_boxes': (100, 'Boxes in the folder; the oldest are removed for new ones.'),
    'max_per_minute': (10, 'Boxes that are written within a minute.'),
}


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """Values of the parameters of the recorder, which are their names."""

    coordinator: str
    stream_manager: str
    ontology_manager: str
    folder: str
    robot: str
    snapshot_service: str
    memory_bytes: int
    memory_messages: int
    folder_bytes: int
    max_boxes: int
    max_per_minute: int

    @classmethod
    def declare(cls, node: DyKnowNode) -> Self:
        """Declare the parameters of a node, and return their values."""
        names = {name: node.parameter(name, *rest) for name, rest in _NAMES.items()}
        limits = {name: node.parameter(name, *rest, (1, 10**12)) for name, rest in _LIMITS.items()}
        return cls(**names, **limits)

    @property
    def path(self) -> Path:
        """The folder of the black boxes."""
        return Path(self.folder).expanduser().absolute()

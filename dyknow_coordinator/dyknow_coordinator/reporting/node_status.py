"""Diagnosis of the nodes that the coordinator depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from dyknow_common import SECOND_NS, round_duration
from dyknow_coordinator.reporting.evaluation_status import Diagnosis, Level

START_UP_NS: Final = 5 * SECOND_NS
"""The time after the first search for a node, within which the node may be missing."""


@dataclass(frozen=True, slots=True)
class NodeState:
    """A node as the coordinator sees it.

    Args:
        alive: True if its liveliness lease holds.
        level: the level of its own status.
        message: the message of its own status; empty if it has never been heard of.
        absent: the time for which it has been gone, or searched for in vain; nanoseconds.
    """

    alive: bool = False
    level: Level = Level.OK
    message: str = ''
    absent: int = 0

    @property
    def is_new(self) -> bool:
        """True before the first sign of life, for the time that it may take."""
        return not (self.alive or self.message) and self.absent < START_UP_NS


def has_loaded(statuses: Mapping[str, Mapping[str, str]]) -> bool:
    """Return True if the nodes that load files have checked all of them, and an engine is found.

    Args:
        statuses: the values of the status of each node, by the type of the node.
    """
    semantics = statuses.get('stream_semantics_manager', {})
    streams = statuses.get('stream_manager', {})
    # An annotation is checked against the ontology; a stream waits for an engine.
    is_placed = streams.get('waiting') == '' and bool(streams.get('engines'))
    return 'refused' in semantics and is_placed


def diagnose_node(state: NodeState) -> Diagnosis:
    """Return the diagnosis of a node: its own, or ERROR if it is gone or was never there."""
    absent = round_duration(state.absent)
    if state.alive:
        return Diagnosis(state.level, state.message)
    if state.message:
        reason = 'it was stopped or killed, or is out of reach'
        return Diagnosis(Level.ERROR, f'gone for {absent}: {reason}')
    if state.is_new:
        return Diagnosis(Level.WARN, 'not found yet')
    question = 'is it running, in this namespace and ROS domain?'
    return Diagnosis(Level.ERROR, f'not found within {absent}: {question}')

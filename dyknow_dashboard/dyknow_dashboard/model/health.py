"""The health of nodes: DyKnow's by their heartbeats, others' by `/diagnostics`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from dyknow_common import SECOND_NS
from dyknow_coordinator import Level
from dyknow_coordinator.reporting.node_status import NodeState, diagnose_node

MAX_DIAGNOSES: Final = 200
"""The number of entries of `/diagnostics` that are shown."""

STALE_NS: Final = 10 * SECOND_NS
"""The time after which an entry of `/diagnostics` counts as stale."""

_WORDS: Final = {Level.OK: 'ok', Level.WARN: 'warning', Level.ERROR: 'error'}


@dataclass(frozen=True, slots=True)
class NodeHealth:
    """A node of DyKnow.

    Args:
        name: absolute.
        state: as its heartbeats and its status tell.
        values: the values of its status.
    """

    name: str
    state: NodeState
    values: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class DiagnosedPart:
    """An entry of `/diagnostics`."""

    name: str
    level: int
    message: str


class HealthTable:
    """The nodes of DyKnow, and what other nodes publish on `/diagnostics`."""

    def __init__(self) -> None:
        self.nodes: tuple[NodeHealth, ...] = ()
        self._diagnoses: dict[str, tuple[int, DiagnosedPart]] = {}
        self.version = 0

    def update(self, nodes: Iterable[NodeHealth], now: int) -> None:
        """Take the present health of all nodes, and forget diagnoses that are too old."""
        self.nodes = tuple(nodes)
        kept = {name: each for name, each in self._diagnoses.items() if now - each[0] < STALE_NS}
        self._diagnoses = kept
        self.version += 1

    def diagnose(self, parts: Iterable[DiagnosedPart], now: int) -> None:
        """Take a message of `/diagnostics` at a time in nanoseconds."""
        for each in parts:
            if each.name in self._diagnoses or len(self._diagnoses) < MAX_DIAGNOSES:
                self._diagnoses[each.name] = now, each

    def document(self) -> dict[str, Any]:
        """Return all nodes, and the diagnoses of others."""
        # The coordinator tells there of the nodes and the formulas, which the page has anyway.
        ours = tuple(f'{each.name}: ' for each in self.nodes)
        return {
            'nodes': [_row(each) for each in self.nodes],
            'diagnoses': [
                {
                    'name': each.name,
                    'level': _word(each.level),
                    'message': each.message,
                }
                for _, each in self._diagnoses.values()
                if not each.name.startswith(ours)
            ],
        }


def _row(node: NodeHealth) -> dict[str, Any]:
    diagnosis = diagnose_node(node.state)
    return {
        'name': node.name,
        'alive': node.state.alive,
        'level': _WORDS[diagnosis.level],
        'message': diagnosis.text,
        'values': [list(each) for each in node.values],
    }


def _word(level: int) -> str:
    return _WORDS[Level(level)] if level in set(Level) else 'stale'

"""The table of peers: what a page gets, and what its code makes of it, run by node."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from dyknow_common import SECOND_NS
from dyknow_coordinator import Level
from dyknow_coordinator.reporting.node_status import NodeState
from dyknow_dashboard.model.board import MAX_PEERS_SHOWN, Board, PageState
from dyknow_dashboard.model.health import HealthTable, NodeHealth
from dyknow_dashboard.model.requests import Interest
from dyknow_federation.report import FederationReport, LinkState, PeerReport

NODE = shutil.which('node')
CARRIER = PeerReport(
    'carrier1',
    LinkState.STALE,
    4 * SECOND_NS,
    delay=2_000_000,
    offset=-1_200_000_000,
    uncertainty=1_000_000,
    bytes_sent=1234,
    bytes_received=99,
    lost=2,
    shares=('Charge_carrier1', 'X_carrier1'),
    asked=('Charge_carrier1',),
    fault='it has another version',
)
TEXTS = [
    'carrier1', 'stale', '4 s', '2 ms', '-1.2 s \u00b1 1 ms', '1.2 kB', '0.1 kB', '2',
    'Charge_carrier1, X_carrier1', 'Charge_carrier1', '', 'it has another version',
]  # fmt: skip


def shown(*reports: FederationReport | None) -> dict[str, Any]:
    """Return the message for a page that shows the nodes."""
    board, page = Board(lambda: 0), PageState(Interest('nodes'))
    for each in reports:
        board.peers.update(each)
    (found,) = (each for each in board.changes(page) if each['type'] == 'peers')
    assert list(board.changes(page)) == [], 'it has changed nothing since then'
    return found


def test_a_page_has_the_table_of_the_command() -> None:
    message = shown(FederationReport('base', (CARRIER,), ('X',), ('nobody carries Y',)))
    assert message['shares'] == 'base shares X'
    assert message['faults'] == ['nobody carries Y']
    assert [list(each.values()) for each in message['peers']] == [TEXTS]


def test_the_number_of_peers_is_limited() -> None:
    message = shown(FederationReport('base', (CARRIER,) * (MAX_PEERS_SHOWN + 3)))
    assert (len(message['peers']), message['hidden']) == (MAX_PEERS_SHOWN, 3)


@pytest.mark.skipif(NODE is None, reason='node is not installed')
def test_the_page_folds_the_table_away_without_a_federation_and_says_what_is_old() -> None:
    page = resources.files('dyknow_dashboard.page')
    script = Path(__file__).with_name('peers_page.js')
    joined = FederationReport('base', (CARRIER,))
    table = HealthTable()
    gone = NodeState(False, Level.OK, 'running', 7 * SECOND_NS)
    table.update([NodeHealth(f'/{name}', gone) for name in ('federation', 'stream_manager')], 0)
    nodes = {'type': 'nodes', **table.document()}
    messages = [shown(), shown(joined), nodes, shown(joined, None)]
    line = [str(NODE), str(script), str(page), json.dumps(messages)]
    done = subprocess.run(line, capture_output=True, text=True, check=True, timeout=120)
    alone, linked, old, forgotten = (json.loads(each) for each in done.stdout.splitlines())
    assert alone == {'hidden': True, 'shares': '', 'rows': [], 'old': []}
    expected = {'hidden': False, 'shares': 'base shares nothing', 'rows': [TEXTS], 'old': []}
    assert linked == expected
    assert old == {**expected, 'old': ['old-streams', 'old-graph', 'old-peers']}
    assert forgotten == {**alone, 'old': old['old']}

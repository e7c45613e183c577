"""`dyknow federation` shows links, clocks, and what is shared with whom."""

from __future__ import annotations

import json
from dataclasses import asdict

from rich.console import Console

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_federation.report import FederationReport, LinkState, PeerReport, federation_table

MS = NANOSECONDS['ms']
CARRIER = PeerReport(
    'carrier1', LinkState.LINKED, SECOND_NS, 2 * MS, -1200 * MS, MS, 1234, 99_000, 2,
    shares=[f'X{number}' for number in range(100)], asked=['X1'], given=['Wind'],
)  # fmt: skip
REPORT = FederationReport('base', (CARRIER,), ['Wind'], ['nobody carries Y'])


def test_the_table_shows_what_is_shared_with_whom() -> None:
    console = Console(width=80, record=True)
    console.print(federation_table(REPORT))
    text = ' '.join(console.export_text().split())
    for each in ('carrier1', 'linked', '2 ms', '-1.2 s ± 1 ms', '1.2 kB', '99.0 kB'):
        assert each in text
    assert 'carrier1: shares X0, X1, ' in text
    assert 'asked for X1; given Wind base shares Wind nobody carries Y' in text


def test_a_report_crosses_as_a_document() -> None:
    assert FederationReport.of(json.loads(json.dumps(asdict(REPORT)))) == REPORT

"""The peers of this host as the page shows them: what `dyknow federation` shows."""

from __future__ import annotations

from typing import Any, Final

from dyknow_federation.report import FederationReport, peer_texts, shares_text

MAX_PEERS_SHOWN: Final = 200
"""The number of peers that are shown."""


class PeerTable:
    """The latest report of the federation node, where there is one."""

    def __init__(self) -> None:
        self.version = 0
        self._report: FederationReport | None = None

    def update(self, report: FederationReport) -> None:
        """Take a report."""
        self._report = report
        self.version += 1

    def document(self) -> dict[str, Any]:
        """Return the peers, with their links and clocks; nothing is shared without a federation."""
        report = self._report
        if report is None:
            return {'shares': '', 'peers': [], 'faults': [], 'hidden': 0}
        shown = report.peers[:MAX_PEERS_SHOWN]
        return {
            'shares': shares_text(report),
            'peers': [peer_texts(each) for each in shown],
            'faults': list(report.faults),
            'hidden': len(report.peers) - len(shown),
        }

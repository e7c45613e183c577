"""What the federation of a host reports: its peers, links, clocks, and what is shared with whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from dyknow_common import listed, round_duration
from dyknow_common.tables import Cell, ReportTable, figure, fixed, named
from dyknow_federation.clocks import Offset


class LinkState(StrEnum):
    """The state of the link to a peer."""

    LINKED = 'linked'
    STALE = 'stale'
    LEFT = 'left'


@dataclass(frozen=True, slots=True)
class PeerReport:
    """A peer; durations are in nanoseconds, None where nothing is known yet.

    Args:
        name: its name.
        state: the state of the link.
        silent_for: the time since the peer was last heard.
        delay: the round trip.
        offset: the offset of its clock; positive if the clock is ahead.
        uncertainty: the true offset is at most this far from `offset`.
        bytes_sent: the number of bytes sent to this peer alone.
        bytes_received: the number of bytes received from it.
        lost: the number of its samples that are lost for good.
        shares: the streams that it shares.
        asked: its streams that are read here.
        given: the own streams that it has asked for.
        fault: why its last refused message was refused.
    """

    name: str
    state: LinkState
    silent_for: int
    delay: int | None = None
    offset: int | None = None
    uncertainty: int | None = None
    bytes_sent: int = 0
    bytes_received: int = 0
    lost: int = 0
    shares: Sequence[str] = ()
    asked: Sequence[str] = ()
    given: Sequence[str] = ()
    fault: str = ''


@dataclass(frozen=True, slots=True)
class FederationReport:
    """A host among its peers.

    Args:
        name: the name of the host.
        peers: the peers by name.
        shares: the own streams that peers may ask for.
        faults: what cannot be shared with peers, or used from them, and why.
    """

    name: str
    peers: tuple[PeerReport, ...] = ()
    shares: Sequence[str] = ()
    faults: Sequence[str] = ()

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> FederationReport:
        """Return the report that `asdict` has made a document of."""
        peers = (
            PeerReport(**each | {'state': LinkState(each['state'])}) for each in document['peers']
        )
        return cls(document['name'], tuple(peers), document['shares'], document['faults'])


_STYLES = {LinkState.LINKED: 'green', LinkState.STALE: 'yellow', LinkState.LEFT: 'bold red'}

_COLUMNS = (
    named('peer'),
    fixed('link'),
    *map(figure, ('silent', 'delay', 'clock', 'sent', 'received', 'lost')),
)
_BELOW = ('shares', 'asked for', 'given', 'fault')
"""Values with lines of their own below the table: with them, it would exceed 80 columns."""


def federation_table(report: FederationReport) -> RenderableType:
    """Return a table with a line for each peer, followed by what is shared with whom."""
    rows: list[list[Cell]] = []
    lines = []
    for each in report.peers:
        texts = peer_texts(each)
        below = [f'{name} {texts[name]}' for name in _BELOW if texts[name]]
        lines += [f'{each.name}: {"; ".join(below)}'] * bool(below)
        name, link, *others = (text for name, text in texts.items() if name not in _BELOW)
        rows.append([name, Text(link, _STYLES[each.state]), *others])
    lines.append(shares_text(report))
    faults = [Text(each, 'yellow') for each in report.faults]
    if not rows:
        lines.insert(0, 'No peer is known yet: see "connect" and "listen" of the key federation.')
        return Group(Text('\n'.join(lines)), *faults)
    return Group(ReportTable(_COLUMNS, rows), Text('\n'.join(lines)), *faults)


def shares_text(report: FederationReport) -> str:
    """Return what the host shares, as a sentence."""
    return f'{report.name} shares {", ".join(report.shares) or "nothing"}'


def peer_texts(report: PeerReport) -> dict[str, str]:
    """Return what tables show of a peer, in the order of their columns."""
    return {
        'peer': report.name,
        'link': report.state.value,
        'silent': round_duration(report.silent_for),
        'delay': '' if report.delay is None else round_duration(report.delay),
        'clock': _clock(report),
        'sent': f'{report.bytes_sent / 1e3:,.1f} kB',
        'received': f'{report.bytes_received / 1e3:,.1f} kB',
        'lost': str(report.lost),
        'shares': listed(report.shares),
        'asked for': ', '.join(report.asked),
        'given': ', '.join(report.given),
        'fault': report.fault,
    }


def _clock(report: PeerReport) -> str:
    if report.offset is None or report.uncertainty is None:
        return ''
    return str(Offset(report.offset, report.uncertainty)).replace(' plus or minus ', ' ± ')

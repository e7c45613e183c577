"""The formulas that peers have asked for: evaluated by the coordinator, as for any client."""

from __future__ import annotations

from functools import partial
from typing import Final

from dyknow_common import StreamConstraints, Verdict
from dyknow_coordinator import Answer, Grounding
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_federation.peer import FormulaForPeer
from dyknow_federation.push_down import UNDECIDED, verdict_text, with_prefix
from dyknow_federation.ros.own_streams import NAME, OwnStreams
from dyknow_stream_processing import ViolationKind

MAX_TIMEOUT_S: Final = 365 * 86_400.0
"""The timeout of their evaluations, in seconds: they end when their peer needs them no more."""


class OwnFormulas:
    """The formulas that peers have asked for.

    Args:
        streams: the own streams, which these formulas are about.
    """

    def __init__(self, streams: OwnStreams) -> None:
        self._streams = streams
        self._client = FormulaClient(streams.node)
        self._running: dict[str, Monitor] = {}
        self._promised: dict[str, int] = {}
        """The time until which each is as it was told."""

    def close(self) -> None:
        """End all evaluations."""
        self._client.close()

    def reconcile(self) -> None:
        """Evaluate those whose verdict is requested, and no others; tell that this goes on."""
        peer, now = self._streams.peer, self._streams.node.now()
        asked = {name: each for name, each in peer.formulas.items() if name in peer.sent}
        for name in self._running.keys() - asked.keys():
            self._running.pop(name).cancel()
            del self._promised[name]
        self._streams.needed = frozenset().union(*(each.streams for each in asked.values()))
        for name, each in asked.items():
            if name in self._running:
                self._promise(name, now)
            elif each.streams <= self._streams.made:
                self._start(name, each)

    def _start(self, name: str, asked: FormulaForPeer) -> None:
        request, streams = asked.request, self._streams
        now = streams.node.now()
        streams.peer.publish(name, now, UNDECIDED, now)
        self._promised[name] = now
        streams.changed()
        self._running[name] = self._client.monitor(
            with_prefix(request.formula, NAME),
            name=f'{asked.asker}{name}',
            on_verdict=partial(self._tell, name, asked.streams),
            grounding=Grounding.SYNTACTIC,
            constraints=StreamConstraints(sample_period=request.sample_period or None),
            timeout=MAX_TIMEOUT_S,
        )

    def _promise(self, name: str, now: int) -> None:
        self._promised[name] = max(self._promised[name], now - 1)
        self._streams.peer.promise(name, now - 1, now)

    def _tell(self, name: str, about: frozenset[str], answer: Answer) -> None:
        """Tell the verdict, or why there is none, in the words of the ontology."""
        if name not in self._running:
            return  # The peer needs it no more.
        streams, error = self._streams, answer.error
        text = answer.explanation if error is None else error.message
        for stream in about & streams.offers.keys():
            text = text.replace(f'{NAME}{stream}.value', str(streams.offers[stream].ground))
        if error is not None:
            streams.violate(name, ViolationKind.MESSAGE, text)
            return
        now = streams.node.now()
        verdict = verdict_text(is_true=answer.verdict is Verdict.TRUE, reason=text)
        # It is certain at its peer with the promise, as soon as both have crossed.
        streams.peer.publish(name, self._promised[name] + 1, verdict, now)
        self._promise(name, now)
        streams.changed()

"""The formulas that peers have asked for: evaluated by the coordinator, as for any client."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dyknow_common import SECOND_NS, StreamConstraints
from dyknow_coordinator import Answer, Grounding, Progress
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_federation.offers import VALUE
from dyknow_federation.own_verdict import OwnVerdict
from dyknow_federation.peer import FormulaForPeer
from dyknow_federation.push_down import MAX_TIMEOUT, with_prefix
from dyknow_federation.ros.own_streams import NAME, OwnStreams


@dataclass(eq=False, slots=True)
class _Asked:
    """A formula that a peer has asked for, and its evaluation, once that has begun."""

    about: frozenset[str]
    verdict: OwnVerdict
    monitor: Monitor | None = None


class OwnFormulas:
    """The formulas that peers have asked for.

    Args:
        streams: the own streams, which these formulas are about.
    """

    def __init__(self, streams: OwnStreams) -> None:
        self._streams = streams
        self._client = FormulaClient(streams.node)
        self._asked: dict[str, _Asked] = {}

    def close(self) -> None:
        """End all evaluations."""
        self._client.close()

    def reconcile(self) -> None:
        """Evaluate only formulas whose verdict is requested; tell peers that this goes on."""
        streams, now = self._streams, self._streams.node.now()
        peer = streams.peer
        due = {name: each for name, each in peer.formulas.items() if name in peer.sent}
        for name in self._asked.keys() - due.keys():
            if (monitor := self._asked.pop(name).monitor) is not None:
                monitor.cancel()
        streams.needed = frozenset().union(*(each.streams for each in due.values()))
        for name, each in due.items():
            if name not in self._asked:
                self._asked[name] = _Asked(each.streams, OwnVerdict(peer, name))
            self._go_on(name, each, now)

    def _go_on(self, name: str, requested: FormulaForPeer, now: int) -> None:
        """Begin with an evaluation once its streams are made; tell how far it has come."""
        asked, streams = self._asked[name], self._streams
        is_made = asked.about <= streams.made
        if is_made and (fault := streams.fault_of(asked.about)):
            asked.verdict.fail(fault, now)
        if asked.monitor is None and is_made:
            asked.monitor = self._begin(asked, requested)
        elif asked.monitor is None:
            asked.verdict.wait('; '.join(streams.faults), now)
        asked.verdict.advance(streams.known_until(asked.about) if is_made else None, now)

    def _begin(self, asked: _Asked, requested: FormulaForPeer) -> Monitor:
        request = requested.request
        monitor = self._client.monitor(
            with_prefix(request.formula, NAME),
            on_feedback=lambda progress: self._note(asked, progress),
            grounding=Grounding.SYNTACTIC,
            constraints=StreamConstraints(sample_period=request.sample_period or None),
            timeout=MAX_TIMEOUT / SECOND_NS,
        )
        monitor.outcome.add_done_callback(lambda _: self._end(asked, monitor.outcome.result()))
        return monitor

    def _note(self, asked: _Asked, progress: Progress) -> None:
        waits_for = self._in_words(progress.waits_for, asked)
        asked.verdict.note(replace(progress, waits_for=waits_for), self._streams.node.now())
        self._streams.changed()

    def _end(self, asked: _Asked, answer: Answer) -> None:
        """Tell the verdict, or why there is none."""
        if asked not in self._asked.values():
            return  # The peer needs it no more.
        now = self._streams.node.now()
        if answer.error is None:
            asked.verdict.decide(answer, self._in_words(answer.explanation, asked), now)
        else:
            asked.verdict.fail(self._in_words(answer.error.message, asked), now)
        self._streams.changed()

    def _in_words(self, text: str, asked: _Asked) -> str:
        """Return a text in the words of the ontology."""
        offers = self._streams.offers
        for stream in asked.about & offers.keys():
            text = text.replace(f'{NAME}{stream}.{VALUE}', str(offers[stream].ground))
        return text

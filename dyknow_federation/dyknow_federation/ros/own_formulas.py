"""The formulas that peers have asked for: evaluated by the coordinator, as for any client."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dyknow_common import SECOND_NS, StreamConstraints, Verdict
from dyknow_coordinator import Answer, Grounding, Progress
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_federation.offers import VALUE
from dyknow_federation.peer import FormulaForPeer
from dyknow_federation.push_down import PRESUMABLY_FALSE, UNDECIDED, verdict_text, with_prefix
from dyknow_federation.ros.own_streams import NAME, OwnStreams
from dyknow_stream_processing import ViolationKind

MAX_TIMEOUT_S: Final = 365 * 86_400.0
"""The timeout of their evaluations, in seconds: they end when their peer needs them no more."""

REPEAT_NS: Final = 2 * SECOND_NS
"""The time after which a verdict is told again: no reader takes its stream for silent."""


@dataclass(slots=True)
class _Running:
    """A formula that is evaluated.

    Args:
        told_at: when its verdict was told last.
        promised: the time until which its verdict is as it was told.
        has_failed: True if it has ended without a verdict.
    """

    monitor: Monitor
    told_at: int
    promised: int
    verdict: str = UNDECIDED
    has_failed: bool = False


class OwnFormulas:
    """The formulas that peers have asked for.

    Args:
        streams: the own streams, which these formulas are about.
    """

    def __init__(self, streams: OwnStreams) -> None:
        self._streams = streams
        self._client = FormulaClient(streams.node)
        self._running: dict[str, _Running] = {}

    def close(self) -> None:
        """End all evaluations."""
        self._client.close()

    def reconcile(self) -> None:
        """Evaluate those whose verdict is requested, and no others; tell that this goes on."""
        peer, now = self._streams.peer, self._streams.node.now()
        asked = {name: each for name, each in peer.formulas.items() if name in peer.sent}
        for name in self._running.keys() - asked.keys():
            self._running.pop(name).monitor.cancel()
        self._streams.needed = frozenset().union(*(each.streams for each in asked.values()))
        for name, each in asked.items():
            if name in self._running:
                self._go_on(name, now)
            elif each.streams <= self._streams.made:
                self._start(name, each)

    def _start(self, name: str, asked: FormulaForPeer) -> None:
        request, now = asked.request, self._streams.node.now()
        monitor = self._client.monitor(
            with_prefix(request.formula, NAME),
            on_feedback=lambda progress: self._on_progress(name, monitor, progress),
            grounding=Grounding.SYNTACTIC,
            constraints=StreamConstraints(sample_period=request.sample_period or None),
            timeout=MAX_TIMEOUT_S,
        )
        self._running[name] = _Running(monitor, told_at=now, promised=now - 1)
        self._tell(name, UNDECIDED, now)
        monitor.outcome.add_done_callback(lambda _: self._end(name, asked.streams, monitor))

    def _on_progress(self, name: str, monitor: Monitor, progress: Progress) -> None:
        """Tell if it would be false without further states, when that has changed."""
        running = self._running.get(name)
        if running is None or running.monitor is not monitor or monitor.outcome.done():
            return  # Feedback may arrive after the verdict.
        verdict = PRESUMABLY_FALSE if progress.presumably_false else UNDECIDED
        if verdict != running.verdict:
            self._tell(name, verdict, self._streams.node.now())

    def _go_on(self, name: str, now: int) -> None:
        """Promise that the verdict is as it was told, which is told again once in a while."""
        running = self._running[name]
        if running.has_failed:
            return
        running.promised = max(running.promised, now - 1)
        self._streams.peer.promise(name, running.promised, now)
        if now - running.told_at >= REPEAT_NS:
            self._tell(name, running.verdict, now)

    def _tell(self, name: str, verdict: str, now: int) -> None:
        """Tell a verdict, which is certain at the peer as soon as the promise has crossed, too."""
        running = self._running[name]
        self._streams.peer.publish(name, running.promised + 1, verdict, now)
        running.verdict, running.told_at = verdict, now
        running.promised = max(running.promised + 1, now - 1)
        self._streams.peer.promise(name, running.promised, now)
        self._streams.changed()

    def _end(self, name: str, about: frozenset[str], monitor: Monitor) -> None:
        """Tell the verdict, or why there is none, in the words of the ontology."""
        if name not in self._running:
            return  # The peer needs it no more.
        answer: Answer = monitor.outcome.result()
        streams, error = self._streams, answer.error
        text = answer.explanation if error is None else error.message
        for stream in about & streams.offers.keys():
            text = text.replace(f'{NAME}{stream}.{VALUE}', str(streams.offers[stream].ground))
        if error is not None:
            self._running[name].has_failed = True
            streams.violate(name, ViolationKind.MESSAGE, text)
            return
        verdict = verdict_text(is_true=answer.verdict is Verdict.TRUE, reason=text)
        self._tell(name, verdict, streams.node.now())

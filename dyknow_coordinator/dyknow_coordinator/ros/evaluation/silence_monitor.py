"""Monitor of silence: of states that do not come, and of topics that streams are made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from dyknow_common import SECOND_NS, format_duration, with_readable_times
from dyknow_common.ros import LogOnce
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.evaluation_group import EvaluationGroup, EvaluationGroups
from dyknow_stream_processing import is_normal_wait

PERIOD_S: Final = 0.5

WAITING_LIMIT_S: Final = 3.0
"""Time that a new state stream has for its first state before its evaluations are waiting."""

REPORT_LIMIT_NS: Final = 5 * SECOND_NS
"""Time without a new report on the topics, which come each second, before operators are told."""


class SilenceMonitor:
    """Replaces streams whose topics are silent or that are worse than others, periodically.

    A stream without constraints breaks none by being silent. If nothing can replace it, its
    evaluations are waiting, clients and operators are told why, and the log has a warning. A stream
    with a `sample_period` and no bound of its delay, which no violation ends, fails them if it is
    silent for that much longer.

    Silence counts until the time that the engines have reported, not until now: an engine, the
    stream manager or this node may not run for a while, and then messages wait, unreported.

        0.0 s  an engine reports a message of a topic
        0.2 s  the computer is too busy for the engine; messages of the topic wait
        6.0 s  the topics are known until 0.0 s: a warning says so, and none is silent
        6.5 s  the engine processes the messages, and reports

    Args:
        limit_s: returns the time without a message after which a topic is silent.
    """

    def __init__(
        self, context: CoordinatorContext, groups: EvaluationGroups, limit_s: Callable[[], float]
    ) -> None:
        self._context = context
        self._groups = groups
        self._limit_s = limit_s
        self._log = LogOnce()
        self._time_passes_since = context.wall_time()
        context.node.create_timer(PERIOD_S, self._check, clock=context.node.wall_clock)

    def _check(self) -> None:
        streams = self._context.streams
        if streams.known_until >= self._context.node.now():
            self._time_passes_since = self._context.wall_time()
        groups = self._groups.running()
        self._report_waiting(groups)
        for group in groups:
            group.states.look(round(self._limit_s() * SECOND_NS))

    def _report_waiting(self, groups: Sequence[EvaluationGroup]) -> None:
        now_s, outdated = self._context.wall_time_s(), self._outdated()
        for group in groups:
            stream = group.states.stream
            is_still = now_s - stream.arrived_at_s > REPORT_LIMIT_NS / SECOND_NS
            reason = group.states.waits_for or (outdated if is_still else '')
            group.set_waiting(reason if now_s - stream.created_at_s >= WAITING_LIMIT_S else '')
        found = {
            f'no state comes for {group.titles}: {group.waits_for}': group
            for group in groups
            if group.waits_for
        }
        waiting = {text: group.logger for text, group in found.items()}
        # The first window of a rate is no fault.
        normal = {text for text, group in found.items() if is_normal_wait(group.waits_for)}
        if any(group.states.chosen for group in groups) and outdated:
            waiting[outdated] = self._context.node.get_logger()
        for text in self._log.new(waiting):
            # A line of code logs with one severity only.
            if text in normal:
                waiting[text].info(with_readable_times(text))
            else:
                waiting[text].warning(with_readable_times(text))

    def _outdated(self) -> str:
        """Return that the latest report is old, else ''; simulated time may stand still."""
        since = max(self._context.streams.heard_at, self._time_passes_since)
        if self._context.wall_time() - since <= REPORT_LIMIT_NS:
            return ''
        return (
            f'nothing was reported about topics for {format_duration(REPORT_LIMIT_NS)}, so none of '
            'them is taken for silent: this node, the stream manager or an engine was stopped, or '
            'the computer is too busy for them'
        )

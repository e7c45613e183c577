"""Formulas over the same states, and the supervision of the states.

The rules are as in the coordinator (`StateSupervisor`, `SilenceMonitor`), with one clock: the log
time of the recording. Other streams replace failed streams at once; nodes need a few hundred
milliseconds. A `StateLine` decides which states count, as in the reasoning engine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from typing import Any, Final

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, round_time, without_generated_text
from dyknow_coordinator import (
    CoordinationError,
    FeatureSource,
    FormulaInputs,
    SourceSession,
    SymbolGrounding,
    describe_sources,
    describe_violation,
    state_specification,
)
from dyknow_reasoning import Breach, StateLine
from dyknow_recordings.evaluation.episodes import EpisodeGroup, EpisodeStart
from dyknow_recordings.evaluation.standby import GroupStream, RecordedStandby, RecordedStates
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.reading.recording import END, LostMessages
from dyknow_stream_processing import OTHER_CLOCK_NS, Sample, SampleBatch, Violation

WAITING_LIMIT_NS: Final = 3 * SECOND_NS
"""The time without states after which a formula is waiting for them."""


class StateGroup:
    """Formulas over one state stream after another.

    Args:
        name: the name of the group and its streams; no stream of a file has a space in its name.
        inputs: the inputs of all its formulas.
        episodes: the episodes of these formulas.
        streams: the streams of the recording.
        start: the time from which its formulas are evaluated.
        on_fault: called when `react` has something to do.
        silence_limit: the time without a message after which a topic is silent, in nanoseconds.
    """

    def __init__(
        self,
        name: str,
        inputs: FormulaInputs,
        episodes: EpisodeGroup,
        streams: RecordedStreams,
        start: EpisodeStart,
        on_fault: Callable[[], None],
        silence_limit: int,
    ) -> None:
        self.episodes = episodes
        self.groundings: tuple[SymbolGrounding, ...] = ()
        self.waits_for = ''
        self.lack = ''
        """From when to when its formulas have had no states, and why; empty if to the end."""
        self._name, self._inputs, self._streams = name, inputs, streams
        self._start, self._on_fault = start, on_fault
        # States that are valid earlier do not count.
        self._begin = max(start.begin, start.first_state)
        self._line: StateLine[RecordedStates] = StateLine(episodes.gap, episodes.end_gap)
        self._session = SourceSession(inputs, lambda: streams.known, can_wait=False)
        self._session.silence_limit = silence_limit
        self._standby = RecordedStandby(self._session.standby, streams, self._create, self._line)
        found = Counter(each.feature for each in inputs.candidates.found)
        self._is_replaceable = any(found[each] > 1 for each in inputs.features)
        self.origins = frozenset(
            name for each in inputs.candidates.found for name in streams.known.origins(each)
        )
        """The streams of files that its states may be made of."""
        self._topics_to_begin = set(streams.known.topics(inputs.candidates.found))
        # The log time from which on the stream in use is.
        self._used_since = 0
        self._latest_receipt, self._streams_made = -1, 0

    def start(self, now: int) -> None:
        """Make the states, unless no formula needs them."""
        if self.episodes.has_ended:
            return
        try:
            chosen = self._session.choose(self._inputs.candidates, now)
            if not chosen:
                raise CoordinationError('the formula depends on no feature, so it has no states')
            self._switch(chosen, now)
        except DyKnowError as error:
            self._fail(error)
            self._on_fault()

    @property
    def has_ended(self) -> bool:
        """True if all formulas have their results, and nobody observes the states."""
        return self.episodes.has_ended and not (
            self._line.stream and self.episodes.is_observed_to_end
        )

    @property
    def _is_idle(self) -> bool:
        """True if a stream is made that nobody needs any more."""
        is_in_use = self.episodes.is_observed_to_end and self._standby.stream is None
        return self.episodes.has_ended and not is_in_use

    @property
    def group_streams(self) -> Sequence[GroupStream]:
        """The stream in use, and the standby; none unless their states may be made as columns."""
        line, used = self._line, self._line.stream
        is_unsteady = line.is_in_gap or line.pause or line.catches_up or line.next
        if used is None or is_unsteady or self._session.faults or self.has_ended:
            return ()
        if self._is_replaceable and self._begun_topics():
            return ()  # At the next look, their sources may be better.
        stream = GroupStream(
            used.name,
            used.created_at,
            self._receive_many,
            self._is_replaceable,
            self._standby.due,
            self._awaited_topics() if self._is_replaceable else frozenset(),
        )
        return stream, *self._standby.group_streams

    def _receive_many(self, states: SampleBatch) -> None:
        receipts = states.emission_times()
        states = states.rows(self._is_asked_for(states.valid_times, receipts))
        if len(states):
            self._line.latest = int(states.valid_times[-1])
            self._latest_receipt = int(states.emission_times()[-1])
            self.episodes.progress_many(states.valid_times, states.columns)
            if self._is_idle:
                self._on_fault()

    def react(self, now: int) -> None:
        """Replace streams that have failed, or fail; free the states at the end."""
        session, faults = self._session, self._session.faults
        while faults and not self.episodes.has_ended:
            standby = self._standby.take(now)
            chosen = session.react(now, standby.chosen if standby else ())
            if chosen is None:
                self._fail(session.failure())
                break
            try:
                if not standby:
                    self._switch(chosen, now)
            except DyKnowError as error:
                session.note_obstacle(chosen, error, now)
                continue
            # The kept states may end the formulas.
            self.episodes.add_event(session.note_replaced(chosen))
            if standby:
                self._take_over(standby, now)
        if self._standby.is_due(now) and (better := self._standby.take(now)):
            made_of = describe_sources(better.chosen)
            self.episodes.add_event(f'other streams are better now; {made_of}')
            self._take_over(better, now)
        self._renew_standby(now)
        # States that are only observed any more are not made of other streams.
        if self.episodes.has_ended:
            self._standby.end()
            if faults or not self.episodes.is_observed_to_end:
                faults.clear()
                self._destroy()

    def lose(self, lost: LostMessages, now: int, *, is_late: bool = False) -> None:
        """Note a gap if messages are lost that the states are made of.

        Args:
            lost: the messages; the streams that are made of their topics have begun anew.
            now: the log time, in nanoseconds.
            is_late: True if there are states that lack these messages.
        """
        if self._standby.lose(lost):
            self._on_fault()
        stream = self._line.stream
        if stream is None or not lost.concerns(self._streams.topics(stream.name)):
            return
        stream.created_at = now
        self._line.note_gap()
        if lost.last >= self._begin:
            is_final = is_late or self._streams.has_memory(stream.name)
            self.episodes.lose(lost, is_final=is_final)
            if self._streams.reorders(stream.name):
                # Lost messages may have later stamps than the first ones that come.
                lead = self._streams.dataflow.max_lead
                self._begin = min(lost.last, END - lead) + lead
        self._on_fault()

    def check_silence(self, now: int) -> None:
        """Replace the sources of topics that have been silent for too long."""
        stream = self._line.stream
        if stream is None:
            return
        self._session.look(
            stream.name,
            self._streams.received(stream.name),
            max(self._used_since, self._start.first_state),
            now,
            known_until=now,
        )
        self._renew_standby(now)
        if self._session.faults or self._standby.is_due(now):
            self._on_fault()

    def finish(self, start: int, end: int) -> None:
        """Record what remains undecided, and why no states came lately, if that is known.

        Args:
            start: the start of the recording, in nanoseconds.
            end: the end of the recording.
        """
        stream = self._line.stream
        if stream is None or self.episodes.has_ended:
            return
        # Operators that it shares may have had samples before it was made; it has not had them.
        first = max(start, self._begin) - 1
        made = stream.created_at if stream.created_at > first + 1 else first
        # What would pass for an undecided formula may be one whose states have failed.
        if violation := self._session.unexplained(stream.name):
            text = describe_violation(violation)
            self.episodes.fail(CoordinationError(text, ExitCode.CONSTRAINT_VIOLATION))
        elif self._line.is_in_gap and not self.episodes.losses:
            reason = self._streams.waits_for(stream.name, made) or 'no state has come since'
            error = self._session.cause
            self.episodes.fail(CoordinationError(f'{error.message}; {reason}', error.code))
        self.episodes.finish()
        since, latest = end - WAITING_LIMIT_NS, self._line.latest
        if latest is None:
            self.waits_for = self._streams.waits_for(stream.name, made)
            return
        topics = self._streams.topics(stream.name)
        received = max(map(self._streams.latest_valid_time, topics), default=0)
        is_behind = min(received, end) - latest > self._session.silence_limit
        if is_behind or self._latest_receipt <= since:
            span = None if is_behind else (start, end)
            self.waits_for = self._streams.waits_for(stream.name, max(since, made), span)
        is_over = end - self._latest_receipt > self._session.silence_limit
        if is_behind or (is_over and self.waits_for):
            times = f'{round_time(latest)} of {round_time(end)}'
            self.lack = f'was evaluated until {times}: {self.waits_for or "no state follows"}'

    def _switch(self, chosen: tuple[FeatureSource, ...], now: int) -> None:
        """Make the states of other sources from now on."""
        self._standby.end()
        stream = RecordedStates(self._next_name(), chosen, now)
        self._line.note_gap()
        try:
            # Operators that both streams share go on, as they do for streams of other groups.
            self._create(stream)
        finally:
            self._destroy()
        self._use(stream, now)

    def _take_over(self, standby: RecordedStates, now: int) -> None:
        """Use the states that were kept of the standby."""
        if self._line.stream:
            self._streams.destroy(self._line.stream.name)
        self._use(standby, now)
        for state in standby.kept.take():
            self._receive(standby, state)

    def _use(self, stream: RecordedStates, now: int) -> None:
        self._line.change(stream, now)
        self._session.chosen, self._used_since = stream.chosen, now
        self.groundings = self._inputs.candidates.symbol_groundings(stream.chosen)
        self._stand_by(stream, now)

    def _stand_by(self, stream: RecordedStates, now: int) -> None:
        received = self._streams.received(stream.name)
        best = self._session.better(received, now, now)
        self._standby.follow(self._next_name(), stream.chosen, best, now)
        if self._session.may_be_silent(received, now) and self._standby.due:
            self._standby.due = now

    def _renew_standby(self, now: int) -> None:
        stream = self._line.stream
        if stream is None or self.episodes.has_ended:
            return
        begun = self._begun_topics()
        self._topics_to_begin -= begun
        if begun or self._standby.is_outdated(now):
            self._stand_by(stream, now)

    def _awaited_topics(self) -> AbstractSet[str]:
        """Return the topics whose first messages may change which sources are used or stand by."""
        best = self._inputs.candidates.choose(self._inputs.features)
        streams = [self._line.stream]
        if self._session.chosen == best:
            streams.append(self._standby.stream)
        used = (self._streams.topics(each.name) for each in streams if each)
        return self._topics_to_begin.difference(*used)

    def _begun_topics(self) -> set[str]:
        """Return the topics that have begun since the last look for a standby."""
        return {each for each in self._topics_to_begin if self._streams.received_at(each)}

    def _next_name(self) -> str:
        self._streams_made += 1
        return f'{self._name}.{self._streams_made}'

    def _create(self, stream: RecordedStates) -> None:
        self._streams.create(
            stream.name,
            state_specification(stream.chosen),
            self._inputs.constraints,
            partial(self._receive, stream),
            partial(self._on_violation, stream),
        )

    def _destroy(self) -> None:
        self._standby.end()
        if self._line.stream:
            self._streams.destroy(self._line.stream.name)
            self._line.stream = None

    def _fail(self, error: DyKnowError) -> None:
        self._session.faults.clear()
        plain = without_generated_text(error.message)
        self.episodes.fail(
            error if plain == error.message else CoordinationError(plain, error.code)
        )
        self._destroy()

    def _receive(self, stream: RecordedStates, state: Sample) -> None:
        if stream is not self._line.stream:
            self._standby.receive(state)
        elif self._counts(state):
            self._latest_receipt = state.available_time
            self.episodes.progress(state.valid_time, state.fields)
        if self._is_idle or self._standby.is_due(state.available_time):
            self._on_fault()

    def _counts(self, state: Sample) -> bool:
        is_asked_for = self._is_asked_for(state.valid_time, state.available_time)
        return is_asked_for and not self.has_ended and self._line.receive(state.valid_time)

    def _is_asked_for(self, valid_time: Any, received_at: Any) -> Any:
        """Return True for a state that is not from before the begin; the times may be vectors."""
        is_other_clock = received_at - valid_time > OTHER_CLOCK_NS
        may_be_earlier = self._begin == self._start.begin
        return (valid_time >= self._begin) | (is_other_clock & may_be_earlier)

    def _on_violation(self, stream: RecordedStates, violation: Violation) -> None:
        if self.has_ended or violation.available_time < self._start.first_state:
            return
        self._standby.note_violation(stream, violation)
        if stream is not self._line.stream:
            self._on_fault()
            return
        stream.breach = Breach(violation.valid_time, violation.message)
        stream.doubt(violation.doubtful_from)
        self._line.break_off(stream, violation.available_time)
        self.episodes.add_violation(violation)
        now = violation.available_time
        self._session.note_violation(violation, stream.name, stream.chosen, now)
        self._on_fault()

"""Evaluation of formulas over a recording, with the verdicts of the running system.

The parts correspond to the nodes: a vocabulary (ontology manager and matching), streams (stream
manager and processing engine), and groups of formulas over the same states (coordinator and
reasoning engine). One loop drives all of them by the log times of the recording:

    log time    event
    10.00 s     a deadline of the dataflow: a sample of /b that should have come is missing. The
                group whose states need it switches to another stream, with a gap, or fails
    10.02 s     a message of /a: the states that it completes are progressed
    10.50 s     every SILENCE_PERIOD_NS: topics that have been silent for too long are replaced.
                Formulas that have failed before, at 10.02 s, are evaluated again if that is asked
                for: as by another request from now on
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import chain, count
from operator import attrgetter
from typing import Final

import numpy as np

from dyknow_common import (
    NANOSECONDS,
    SECOND_NS,
    DyKnowError,
    round_duration,
)
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import Range, UnknownFeatures
from dyknow_recordings.evaluation.checked_formula import MAX_ATTEMPTS, CheckedFormula
from dyknow_recordings.evaluation.episodes import (
    FROM_FIRST_STATE,
    EpisodeGroup,
    EpisodeStart,
    Every,
    FormulaEpisodes,
)
from dyknow_recordings.evaluation.grounding import FormulaGrounder, GroundedFormula
from dyknow_recordings.evaluation.observation import SignalRecorder, terms_of
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.evaluation.standby import GroupStream
from dyknow_recordings.evaluation.state_group import StateGroup
from dyknow_recordings.evaluation.streams import RecordedStreams
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles, Vocabulary
from dyknow_recordings.reading.columns import MessageColumns, TopicContent
from dyknow_recordings.reading.recording import (
    BEGINNING,
    LostMessages,
    RecordingReader,
    batches,
    parts_by_topic,
    rows_of,
    split,
    without,
)

SILENCE_PERIOD_NS: Final = 500 * NANOSECONDS['ms']
"""The period in which silent topics are looked for."""

SILENCE_LOOKS_NS: Final = 60 * SECOND_NS
"""The time after the silence limit in which they are: later, the silence of all is known."""

MAX_STEP_NS: Final = 30 * SECOND_NS
"""The longest time without a message: after a longer one, the clock may have been stopped."""

_TopicParts = Mapping[str, Sequence[MessageColumns]]


def evaluate_recording(
    recording: RecordingReader,
    formulas: Sequence[RequestedFormula],
    files: MonitoringFiles = NO_FILES,
    start: EpisodeStart = FROM_FIRST_STATE,
    *,
    keep_signals: bool = False,
    margins: bool = False,
    probabilities: bool = False,
    retries: bool = False,
) -> RecordingReport:
    """Evaluate formulas over a recording.

    Args:
        recording: the recording.
        formulas: the formulas; an error of one does not affect the others.
        files: the ontologies, annotations and streams of the running system.
        start: from when formulas are evaluated; formulas with `every_state` are evaluated from
            every state on, unless `start` begins other episodes.
        keep_signals: True to keep the signals of the states, for pictures.
        margins: True to compute the margins of all formulas, even if they do not ask for it.
        probabilities: True to compute the probabilities of formulas from the first state on.
        retries: True to evaluate a formula again after an error, as the running system does.

    Raises:
        DyKnowError: naming a file that cannot be read, or a recording that cannot be read.
    """
    kept = {'keep_signals': keep_signals, 'margins': margins}
    make = partial(RecordingEvaluation, recording, formulas, files, start, **kept)
    report = (evaluation := make()).run()
    if retries and evaluation.may_retry:
        make.keywords['retries'] = True
        report, evaluation = _with_retries(make)
    if probabilities:
        report = _with_probabilities(report, make(probabilities=True).run())
    if keep_signals and (probabilities or evaluation.has_ended_early):
        report = _with_signals(report, make(probabilities=probabilities))
    return report


def _with_retries(
    make: partial[RecordingEvaluation],
) -> tuple[RecordingReport, RecordingEvaluation]:
    """Return the results with retries; without columns, if a formula fails within a batch."""
    try:
        return (evaluation := make()).run(), evaluation
    except _ErrorInColumns:
        make.keywords['has_columns'] = False
        return (evaluation := make()).run(), evaluation


def _with_probabilities(report: RecordingReport, another: RecordingReport) -> RecordingReport:
    """Return a report with the probabilities that another evaluation has computed.

    They need further features, and states after the verdict, whose faults are none of the verdict.
    """
    notes, formulas = list(report.notes), []
    for each, other in zip(report.formulas, another.formulas, strict=True):
        if other.error and not each.error:
            notes.append(f"'{each.name}' has no probability: {other.error}")
        found = replace(
            each,
            states=max(each.states, other.states),
            probability=other.probability,
            probability_so_far=other.probability_so_far,
            asked_probability=other.asked_probability,
        )
        formulas.append(found)
    return replace(report, formulas=tuple(formulas), notes=tuple(notes))


def _with_signals(report: RecordingReport, another: RecordingEvaluation) -> RecordingReport:
    """Return a report with the signals until the end, which another evaluation keeps.

    States that are made for pictures alone share operators with the states of other formulas, and
    may change the results of those formulas.
    """
    another.observe_to_end()
    pairs = zip(report.formulas, another.run().formulas, strict=True)
    formulas = tuple(replace(each, signals=other.signals) for each, other in pairs)
    return replace(report, formulas=formulas)


class _ErrorInColumns(Exception):  # noqa: N818 - no fault of anyone
    """A formula has failed in a batch of columns, and is to be evaluated again within it."""


class RecordingEvaluation:
    """The evaluation of formulas over one recording; see `evaluate_recording`."""

    _vocabulary_notes: tuple[str, ...] = ()
    _observes_to_end = False
    # The log time up to which all messages have been progressed.
    _reached = BEGINNING

    def __init__(
        self,
        recording: RecordingReader,
        formulas: Sequence[RequestedFormula],
        files: MonitoringFiles,
        start: EpisodeStart,
        *,
        keep_signals: bool = False,
        margins: bool = False,
        probabilities: bool = False,
        retries: bool = False,
        has_columns: bool = True,
    ) -> None:
        self._recording, self._files = recording, files
        self._keep_signals, self._start, self._retries = keep_signals, start, retries
        self._margins, self._probabilities, self._has_columns = margins, probabilities, has_columns
        self._streams = RecordedStreams(
            recording.contents,
            files.streams,
            recording.fault_of,
            absent_is_unknown=files.missing_is_unknown,
            other_clock=recording.other_clock,
        )
        self._pending: list[StateGroup] = []
        self._requests = self._ground_all(formulas, files)
        inputs = [each.grounded.inputs for each in self._requests if each.grounded]
        sources = dict.fromkeys(source for each in inputs for source in each.candidates.found)
        self._fields = self._streams.prepare(sources, {x for each in inputs for x in each.unknown})
        self._columns = ColumnStates(self._streams, recording.start_time, self._files.silence_limit)
        self._next_look = max(recording.start_time, start.begin)
        self._group_numbers = count(1)
        self._failed: list[CheckedFormula] = []
        self._groups = self._make_groups()
        self._running = [group for group in self._groups if not group.has_ended]
        # The groups without states so far, and the times from which on they have some.
        self._waiting = dict.fromkeys(self._running, self._next_look)
        self._losses: list[LostMessages] = []
        self._losses_to_come: list[LostMessages] = []
        # Losses that may have begun, but not ended.
        self._open_losses: list[LostMessages] = []

    def observe_to_end(self) -> None:
        """Keep signals also of the states that no formula needs any more."""
        self._observes_to_end = True
        for group in self._groups:
            group.episodes.is_observed_to_end = group.episodes.observer is not None

    @property
    def has_ended_early(self) -> bool:
        """True if states may have come to an end before the recording, with their formulas."""
        return any(group.has_ended for group in self._groups)

    @property
    def may_retry(self) -> bool:
        """True if a formula has ended with an error that a later evaluation may not have."""
        return any(each.may_be_retried for each in self._requests)

    def _ends_early(self) -> bool:
        """Return True if such a formula ended so long before the end that it may be retried."""
        last = self._recording.end_time - SILENCE_PERIOD_NS
        return any(
            max(each.last_state or 0, *(it.available_time for it in each.violations), 0) <= last
            for each in (request.episodes for request in self._requests if request.may_be_retried)
            if each
        )

    def run(self) -> RecordingReport:
        """Read the recording and return the results."""
        recording = self._recording
        start, end = recording.start_time, recording.end_time
        if self._running:
            self._advance(start)
            for batch in batches(recording.columns(self._fields)):
                self._take(batch)
                if not self._running:
                    break
            else:
                self._react(end)
                self._find_losses()
                for lost in self._losses_to_come:
                    self._lose(lost, max(start, min(lost.first, end + 1)))
                self._advance(end)
        ends_early = self._ends_early()
        for group in self._running:
            group.finish(start, end)
        return RecordingReport(
            recording=str(recording.path),
            start_time=start,
            end_time=end,
            formulas=tuple(each.report() for each in self._requests),
            notes=(
                *self._vocabulary_notes,
                *self._streams.notes,
                *map(str, recording.faults),
                *self._lacks(),
            ),
            topics=tuple(self._fields),
            ends_early=ends_early,
        )

    def _take(self, batch: Sequence[MessageColumns]) -> None:
        """Progress over a batch, and over the losses that begin before its end."""
        self._find_losses()
        end = max(int(part.log_times[-1]) for part in batch)
        if self._open_losses:
            start = min(int(part.log_times[0]) for part in batch)
            self._open_losses = [each for each in self._open_losses if each.last >= start]
            for lost in self._open_losses:
                batch = without(batch, lost)
        while self._losses_to_come and self._losses_to_come[0].first <= end and self._running:
            lost = self._losses_to_come.pop(0)
            before, after = split(batch, lost.first)
            if before:
                self._progress(before)
            self._lose(lost, max(lost.first, self._recording.start_time))
            batch = without(after, lost)
        if batch and self._running:
            self._progress(batch)
        self._reached = end

    def _find_losses(self) -> None:
        new = [each for each in self._recording.losses if each not in self._losses]
        if new:
            self._losses += new
            self._losses_to_come = sorted([*self._losses_to_come, *new], key=attrgetter('first'))

    def _lose(self, lost: LostMessages, now: int) -> None:
        """Begin the streams anew that are made of messages that are lost from now on."""
        self._advance(now)
        self._open_losses.append(lost)
        self._streams.forget(lost.topics)
        for group in self._running:
            group.lose(lost, now, is_late=lost.first <= self._reached)
        self._react(now)

    def _progress(self, batch: Sequence[MessageColumns]) -> None:
        """Progress over a batch, as columns if that gives the same results."""
        end = max(int(part.log_times[-1]) for part in batch)
        has_columns = self._has_columns and not (self._retries and self._waiting)
        if has_columns and self._columns.progress(batch, self._running):
            # The results of an observer are signals alone: it may begin a batch later.
            if not self._observes_to_end and any(each.may_be_retried for each in self._failed):
                raise _ErrorInColumns
            looks = (end - self._next_look) // SILENCE_PERIOD_NS + 1
            self._next_look += max(looks, 0) * SILENCE_PERIOD_NS
            self._react(end)
            return
        for message in rows_of(batch):
            self._advance(message.log_time)
            self._streams.push(message)
            self._react(message.log_time)
            if not self._running:
                return

    def _ground_all(
        self, formulas: Sequence[RequestedFormula], files: MonitoringFiles
    ) -> list[CheckedFormula]:
        with closing(load_vocabulary(files, self._recording.contents)) as vocabulary:
            self._vocabulary_notes = tuple(vocabulary.notes)
            grounder = FormulaGrounder(
                vocabulary,
                self._streams,
                states=files.states,
                constraints=files.constraints,
                types=lambda: self._recording.constants,
            )
            return [self._ground(grounder, each) for each in formulas]

    def _ground(self, grounder: FormulaGrounder, requested: RequestedFormula) -> CheckedFormula:
        try:
            grounded = grounder.ground(
                requested.text,
                self._start.trigger,
                requested.constants,
                margin=self._margins or requested.margin,
                probability=self._probabilities,
            )
            return CheckedFormula(requested, grounded)
        except DyKnowError as error:
            return CheckedFormula(requested, error=error)

    def _make_groups(self) -> list[StateGroup]:
        """Make a group for all formulas over the same streams."""
        members: dict[tuple[str, ...], list[tuple[CheckedFormula, GroundedFormula]]] = {}
        for request in self._requests:
            if request.grounded is not None:
                features = tuple(sorted(request.grounded.inputs.features))
                members.setdefault(features, []).append((request, request.grounded))
        return [self._make_group(found, self._start) for found in members.values()]

    def _make_group(
        self,
        members: Sequence[tuple[CheckedFormula, GroundedFormula]],
        start: EpisodeStart,
        former: StateGroup | None = None,
    ) -> StateGroup:
        """Make a group, whose states begin later; `former` is the group that failed before."""
        domains: dict[str, tuple[str, ...]] = {}
        ranges: dict[str, Range] = {}
        for request, grounded in members:
            domains |= grounded.inputs.domains
            ranges |= grounded.inputs.unknown
            request.episodes = FormulaEpisodes(grounded, self._every(request.requested, grounded))
        observer = self._observer(members, domains, former)
        episodes = EpisodeGroup(
            [each.episodes for each, _ in members if each.episodes],
            domains,
            observer,
            UnknownFeatures(ranges, all_may_be=self._files.missing_is_unknown),
            is_suffix=start.is_suffix,
        )
        episodes.is_observed_to_end = self._observes_to_end and observer is not None
        group = StateGroup(
            f'states {next(self._group_numbers)}',
            members[0][1].inputs,
            episodes,
            self._streams,
            start,
            lambda: self._pending.append(group),
            self._files.silence_limit,
        )
        for request, _ in members:
            request.group, request.begin = group, max(start.begin, self._recording.start_time)
            request.observer = request.observer or observer
            if self._retries and request.episodes:
                request.episodes.on_end = partial(self._failed.append, request)
        return group

    def _observer(
        self,
        members: Sequence[tuple[CheckedFormula, GroundedFormula]],
        domains: Mapping[str, tuple[str, ...]],
        former: StateGroup | None,
    ) -> SignalRecorder | None:
        """Return what keeps the signals of a group; a group that goes on keeps its own."""
        if former is not None:
            observer = former.episodes.observer if former.has_ended else None
            if observer is not None:
                observer.gap()
            return observer
        if not self._keep_signals:
            return None
        texts = (text for _, each in members for text in (each.formula, each.probability))
        is_asked_once = all(each.episodes and each.episodes.every.is_one for each, _ in members)
        terms = terms_of(filter(None, texts), domains)
        return SignalRecorder(terms, domains, is_asked_once=is_asked_once)

    def _retry(self, now: int) -> None:
        """Make groups for the formulas that have just failed; they begin at a later look."""
        members: dict[tuple[StateGroup, int], list[tuple[CheckedFormula, GroundedFormula]]] = {}
        while self._failed:
            request = self._failed.pop(0)
            episodes, group = request.episodes, request.group
            if not (request.may_be_retried and episodes and group):
                continue
            wait = request.fail(now) - self._next_look
            begin = self._next_look + max(wait // SILENCE_PERIOD_NS, 0) * SILENCE_PERIOD_NS
            if begin <= self._recording.end_time and not request.is_given_up:
                request.end_attempt()
                members.setdefault((group, begin), []).append((request, episodes.grounded))
        for (former, begin), found in members.items():
            start = replace(self._start, begin=begin, is_suffix=False)
            group = self._make_group(found, start, former)
            self._waiting[group] = begin
            self._running.append(group)

    def _every(self, requested: RequestedFormula, grounded: GroundedFormula) -> Every:
        """Return which states begin an episode; a formula without features has no states."""
        if not grounded.inputs.features:
            return Every.FIRST
        is_asked_again = self._start.every is Every.FIRST and requested.every_state
        return Every.STATE if is_asked_again else self._start.every

    def _advance(self, until: int) -> None:
        """Do what is due before a time, each at its own time."""
        last_look = min(until, self._next_look + self._files.silence_limit + SILENCE_LOOKS_NS)
        while True:
            deadline = self._streams.dataflow.next_deadline()
            due = self._next_look if deadline is None else min(deadline, self._next_look)
            if due > until:
                return
            self._streams.dataflow.advance(due)
            self._react(due)
            if due == self._next_look:
                self._look(due)
                goes_on = due < last_look or self._waiting
                self._next_look = max(due if goes_on else until, due) + SILENCE_PERIOD_NS

    def _look(self, now: int) -> None:
        """Start the groups whose states begin now; look for silent topics of the others."""
        for group in self._running:
            if group not in self._waiting:
                group.check_silence(now)
            elif self._waiting[group] <= now:
                del self._waiting[group]
                if group not in self._groups:  # What happened to the one before is over.
                    self._streams.forget_rejected()
                group.start(now)
                for lost in self._losses:
                    if lost not in self._losses_to_come:
                        group.lose(lost, now)
        self._react(now)

    def _react(self, now: int) -> None:
        if self._pending or self._failed:
            while self._pending:
                self._pending.pop().react(now)
            self._retry(now)
            running = [group for group in self._running if not group.has_ended]
            if len(running) < len(self._running):
                self._streams.keep(frozenset().union(*(each.origins for each in running)))
            self._running = running

    def _lacks(self) -> Iterator[str]:
        """Yield notes on formulas that are evaluated over a part of the recording."""
        for each in self._requests:
            if each.failed_at is not None and each.is_given_up:
                left_out = round_duration(self._recording.end_time - each.failed_at)
                text = f'has ended with {MAX_ATTEMPTS} errors: its last {left_out} are not checked'
                yield f"'{each.name}' {text}"
            if each.group and each.group.lack and each.episodes and not each.episodes.has_ended:
                yield f"'{each.name}' {each.group.lack}"


class ColumnStates:
    """The states of groups, made as columns where that gives the same ones: many at once, by numpy.

    A batch is processed as columns if nothing happens in it but states: no operator refuses its
    part, no group is to be given other streams, and no topic is silent. Any other batch goes
    message by message through the same operators.

    Args:
        streams: the streams of the recording.
        start: the log time at which it begins, in nanoseconds.
        silence_limit: the time without a message after which a topic is silent, in nanoseconds.
    """

    def __init__(self, streams: RecordedStreams, start: int, silence_limit: int) -> None:
        self._streams, self._start = streams, start
        self._silence_limit = silence_limit

    def progress(self, batch: Sequence[MessageColumns], groups: Sequence[StateGroup]) -> bool:
        """Progress groups over a batch; return False, without an effect, if that needs messages."""
        used = [group.group_streams for group in groups]
        times = np.sort(np.concatenate([part.log_times for part in batch]))
        before, end = max(self._start, self._streams.latest_receipt), int(times[-1])
        longest = max(int(times[0]) - before, int(np.diff(times).max(initial=0)))
        if not all(used) or longest > MAX_STEP_NS:
            return False
        parts = parts_by_topic(batch)
        streams = list(chain(*used))
        if any(not each.awaited.isdisjoint(parts) for each in streams):
            return False
        if any(self._may_change(each, parts, end) for each in streams):
            return False
        states = self._streams.step_many(parts, end)
        if states is None:
            return False
        for each in streams:
            each.receive_many(states[each.name])
        return True

    def _may_change(self, state: GroupStream, parts: _TopicParts, end: int) -> bool:
        """Return True if a group may be given another stream, or fail, until a time."""
        if state.until is not None and end >= state.until:
            return True
        if not (state.is_replaceable or self._streams.is_regular(state.name)):
            return False
        for topic in self._streams.topics(state.name):
            latest = max(self._streams.received_at(topic), state.created_at)
            log_times = np.sort(
                np.concatenate(
                    [[latest], *(part.log_times for part in parts.get(topic, ())), [end]]
                )
            )
            if np.diff(log_times).max() > self._silence_limit:
                return True
        return False


def load_vocabulary(files: MonitoringFiles, topics: Mapping[str, TopicContent]) -> Vocabulary:
    """Return the vocabulary of some files.

    Args:
        files: the files.
        topics: the recorded topics, against whose fields the annotations are checked.

    Raises:
        DyKnowError: naming a file that cannot be read.
    """
    if not (files.ontologies or files.annotations):
        return Vocabulary(files.domains)
    # The libraries for ontologies take a second to load.
    from dyknow_recordings.evaluation.semantics import SemanticVocabulary  # noqa: PLC0415

    return SemanticVocabulary(files, topics)

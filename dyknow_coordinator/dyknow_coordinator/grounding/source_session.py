"""The sources of the states of a formula group: in use, at fault, and on standby."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS, DyKnowError, ExitCode, round_duration
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.known_streams import KnownStreams
from dyknow_coordinator.grounding.state_specification import FormulaInputs
from dyknow_stream_processing import Violation, ViolationKind

SILENCE_LIMIT_NS: Final = 5 * SECOND_NS
"""The default time after which a topic without a message is silent, as is a stream of states."""

SILENCE_LIMITS_S: Final = (0.1, 1e9)
"""The least and the greatest time that can be set instead, in seconds."""

_MAX_LAG_NS: Final = SECOND_NS

EXCLUSION_NS: Final = 10 * SECOND_NS
"""Time for which a source that failed is not chosen again."""

TRANSIENT: Final = frozenset({ViolationKind.LOST, ViolationKind.SOURCE})
"""Violations on the way of the samples: the stream itself may be chosen again."""

REPORT_NS: Final = 1200 * NANOSECONDS['ms']
"""Time after which it is known which topics are silent when states break a constraint."""


@dataclass(frozen=True, slots=True)
class StateFault:
    """Reason to replace the streams in use.

    Args:
        error: the error of the formulas if nothing can replace them.
        transient: True if the streams themselves are not at fault, and may be chosen again.
    """

    error: CoordinationError
    transient: bool


class SourceChoice:
    """Chooses the best available source of each ground feature that has not failed recently.

    All times are of one clock, in nanoseconds.
    """

    def __init__(self) -> None:
        self._failed: dict[FeatureSource, int] = {}

    def choose(
        self,
        features: Iterable[str],
        candidates: Candidates,
        known: KnownStreams,
        now: int,
        *preferences: Callable[[FeatureSource], bool],
    ) -> tuple[FeatureSource, ...]:
        """Return a source for each ground feature; see `Candidates.choose`.

        One that nobody publishes is worse than one that has failed. Further preferences are less
        important.
        """
        return candidates.choose(
            features,
            known.is_available,
            lambda source: not self.is_excluded(source, now),
            *preferences,
        )

    def replacements(
        self, features: Iterable[str], candidates: Candidates, known: KnownStreams, now: int
    ) -> tuple[FeatureSource, ...]:
        """Choose as `choose` does, but prefer sources that have samples.

        Call this after a failure: at the start, the first samples may still be on their way.
        """
        return self.choose(features, candidates, known, now, known.is_flowing)

    def better(
        self,
        in_use: Sequence[FeatureSource],
        candidates: Candidates,
        known: KnownStreams,
        now: int,
    ) -> tuple[FeatureSource, ...]:
        """Return the best source with samples of each feature; the present ones if none is better.

        Args:
            in_use: the sources in use, ordered by feature.
            candidates: all sources.
            known: all streams.
            now: the time.
        """
        used = frozenset(in_use)
        found = self.choose(
            [each.feature for each in in_use],
            candidates,
            known,
            now,
            lambda source: source in used or known.is_flowing(source),
        )
        return tuple(
            new if self.can_replace([old], [new], known, now) else old
            for new, old in zip(found, in_use, strict=True)
        )

    def stand_ins(
        self,
        in_use: Sequence[FeatureSource],
        candidates: Candidates,
        known: KnownStreams,
        now: int,
        present: Sequence[FeatureSource] = (),
    ) -> tuple[FeatureSource, ...]:
        """Return another available source of each feature, or else its source in use.

        Return none if no feature has another source, or if a feature has only a source that failed
        recently. A source whose streams have samples is preferred to one whose streams wait.

        Args:
            in_use: the sources in use.
            candidates: all sources.
            known: all streams.
            now: the time.
            present: sources that are preferred to better ones, as they stand by already.
        """
        used = frozenset(in_use)

        def is_well(source: FeatureSource) -> bool:
            return not self.is_excluded(source, now) and known.is_available(source)

        features = [each.feature for each in in_use]
        found = candidates.choose(
            features,
            is_well,
            lambda source: source not in used,
            known.is_flowing,
            present.__contains__,
        )
        return found if set(found) != used and all(map(is_well, found)) else ()

    def exclude(self, sources: Iterable[FeatureSource], now: int) -> None:
        """Record that sources have failed."""
        self._failed.update(dict.fromkeys(sources, now))

    def is_excluded(self, source: FeatureSource, now: int) -> bool:
        """Return True if a source has failed recently."""
        return source in self._failed and now - self._failed[source] < EXCLUSION_NS

    def have_failed(self, sources: Iterable[FeatureSource], now: int) -> bool:
        """Return True if one of some sources has failed recently."""
        return any(self.is_excluded(each, now) for each in sources)

    def exclusion_end(self, sources: Iterable[FeatureSource], now: int) -> int | None:
        """Return when the first of some sources is no longer excluded; None if none is."""
        failed = [self._failed[each] for each in sources if self.is_excluded(each, now)]
        return min(failed) + EXCLUSION_NS if failed else None

    def can_replace(
        self,
        sources: Iterable[FeatureSource],
        others: Iterable[FeatureSource],
        known: KnownStreams,
        now: int,
    ) -> bool:
        """Return True if others have samples for the features of sources, and have not failed.

        Sources that have failed recently would be replaced again at once, without end.
        """
        features = {each.feature for each in sources}
        new = {each for each in others if each.feature in features}
        are_well = all(known.is_available(each) and known.is_flowing(each) for each in new)
        are_others = bool(new) and new.isdisjoint(sources)
        return are_others and are_well and not self.have_failed(new, now)


def may_be_silent(received: Iterable[int], now: int, limit: int) -> bool:
    """Return True if a topic may have fallen silent, which will soon be known.

    Better streams could then only follow with a gap, while a standby has kept states.

    Args:
        received: when the latest message of each topic was received; 0 before the first.
        now: the time, in nanoseconds.
        limit: the time without a message after which a topic is silent.
    """
    return any(_MAX_LAG_NS < now - latest < 2 * limit for latest in received)


def worst_fault(faults: Sequence[StateFault]) -> StateFault:
    """Return the latest fault of the streams themselves; if there is none, the latest."""
    return next((each for each in reversed(faults) if not each.transient), faults[-1])


def describe_sources(chosen: Iterable[FeatureSource]) -> str:
    """Return the sources that states are made of, for clients."""
    return f'states are made of {", ".join(sorted(map(str, chosen)))}'


def describe_violation(violation: Violation) -> str:
    """Return the description of a violation for clients."""
    observed, allowed = violation.observed, violation.allowed
    measured = (
        f' ({violation.constraint}: {round_duration(observed, allowed)} observed, '
        f'{round_duration(allowed, observed)} allowed)'
        if observed or allowed
        else f' ({violation.constraint})'
    )
    return f'{violation.message}{measured}'


class SourceSession:
    """Decides which sources a group uses, and which are at fault.

    It makes no streams. The caller makes streams, reports violations, looks periodically, and while
    there are `faults`, does what `react` says. All times are in nanoseconds; receipts may be on a
    different clock than `now`.

        4.0 s  the states break the client's `max_gap`; which source is at fault is not known
        5.5 s  look: /b has had no message for longer than `max_gap`; its sources are excluded, and
               there is a fault
        5.5 s  `react` returns other sources; if all have failed, the formulas fail

    Args:
        inputs: the inputs of the group.
        known: returns all streams.
        can_wait: True if a stream that cannot be made now may be made later.
    """

    def __init__(
        self, inputs: FormulaInputs, known: Callable[[], KnownStreams], *, can_wait: bool = True
    ) -> None:
        self.inputs = inputs
        self.standby = StandbySources(known, inputs.candidates)
        """Which others stand by; whatever is excluded is so for them, too."""
        self.chosen: tuple[FeatureSource, ...] = ()
        """The sources in use."""
        self.faults: list[StateFault] = []
        """Reasons to replace them."""
        self.cause = CoordinationError('')
        """Why states may be missing: the latest reason to replace sources; empty without any."""
        self.silence_limit = SILENCE_LIMIT_NS
        """The time without a message after which a topic is silent."""
        self.choice = SourceChoice()
        """Chooses among all sources, and knows which have failed."""
        self._known, self._can_wait = known, can_wait
        # Why the latest attempt to replace sources has failed, and the faults that it was about.
        self._obstacle, self._faults_met = '', 0
        # A broken constraint of the client, and the time at which the source at fault is known.
        self._unexplained: tuple[int, Violation] | None = None

    def choose(self, candidates: Candidates, now: int) -> tuple[FeatureSource, ...]:
        """Return the sources among some candidates that a new group would use."""
        return self.choice.choose(self.inputs.features, candidates, self._known(), now)

    def react(
        self, now: int, standby: tuple[FeatureSource, ...] = ()
    ) -> tuple[FeatureSource, ...] | None:
        """Return the sources to use after faults; None if nothing can replace the sources in use.

        Args:
            now: the time.
            standby: the sources whose states are kept; none unless they are well.
        """
        fault = worst_fault(self.faults)
        self.cause, self._faults_met = fault.error, len(self.faults)
        chosen = standby or self._replacements(now)
        # Streams that are not at fault themselves may be made once more.
        is_final = not fault.transient or (self._obstacle and not self._can_wait)
        is_over = not standby and is_final and self.choice.have_failed(chosen, now)
        return None if is_over else chosen

    def note_obstacle(
        self, chosen: tuple[FeatureSource, ...], error: DyKnowError, now: int
    ) -> None:
        """Note that sources that `react` returned cannot be used."""
        self._obstacle = error.message
        others = set(chosen) - set(self.chosen)
        if not self._can_wait:
            self.exclude(others or chosen, now)
        elif error.code is not ExitCode.UNAVAILABLE:
            self.exclude(others, now)

    def note_replaced(self, chosen: Iterable[FeatureSource]) -> str:
        """Note that sources that `react` returned are used; return what people are told."""
        self._obstacle = ''
        del self.faults[: self._faults_met]
        return f'{self.cause.message}; {describe_sources(chosen)}'

    def _replacements(self, now: int) -> tuple[FeatureSource, ...]:
        inputs = self.inputs
        return self.choice.replacements(inputs.features, inputs.candidates, self._known(), now)

    def better(
        self, received: Mapping[str, int], known_until: int, now: int
    ) -> tuple[FeatureSource, ...]:
        """Return the best sources that have samples; they may be the sources in use.

        Args:
            received: when the latest message of each topic was received; 0 before the first.
            known_until: the time until which messages are known.
            now: the time.
        """
        if self.may_be_silent(received, known_until):
            return self.chosen
        return self.choice.better(self.chosen, self.inputs.candidates, self._known(), now)

    def may_be_silent(self, received: Mapping[str, int], known_until: int) -> bool:
        """Return True if one of the topics in use may have fallen silent; see `better`."""
        return may_be_silent(received.values(), known_until, self.silence_limit)

    def exclude(self, sources: Iterable[FeatureSource], now: int) -> None:
        """Record that sources have failed."""
        self.choice.exclude(sources, now)
        self.standby.exclude(sources, now)

    def note_violation(
        self, violation: Violation, stream: str, chosen: Sequence[FeatureSource], now: int
    ) -> None:
        """Note a violation in a state stream that is made of some sources.

        If the states break a constraint of the client, `look` finds the source at fault later.
        """
        if violation.constraint in TRANSIENT:
            self.note_loss(describe_violation(violation))
        elif not violation.stream_name:
            # The clock was set back: states of no source continue the former ones.
            self._blame(self.inputs.candidates.found, violation, now)
        elif violation.stream_name != stream:
            affected = self._known().affected(chosen, violation.stream_name)
            self._blame(affected or chosen, violation, now)
        elif self.unexplained(stream) is None:
            self._unexplained = now + REPORT_NS, violation

    def note_loss(self, text: str, *, transient: bool = True) -> None:
        """Note why samples are missing; if transient, the sources themselves are not at fault."""
        self.faults.append(StateFault(CoordinationError(text, ExitCode.UNAVAILABLE), transient))

    def unexplained(self, stream: str) -> Violation | None:
        """Return the violation in a state stream whose source is not known yet, if any."""
        violation = self._unexplained[1] if self._unexplained else None
        return violation if violation and violation.stream_name == stream else None

    def look(
        self,
        stream: str,
        received: Mapping[str, int],
        since: int,
        now: int,
        *,
        known_until: int,
    ) -> None:
        """Find the sources at fault: of a broken constraint, and of silent topics.

        Args:
            stream: the state stream in use.
            received: when the latest message of each of its topics was received; 0 before the
                first.
            since: the time since which it is in use.
            now: the time.
            known_until: the time until which messages are known.
        """
        if self._unexplained and self._unexplained[0] <= now:
            if violation := self.unexplained(stream):
                self._explain(violation, received, now)
            self._unexplained = None
        self._find_silence(received, since, now, known_until)

    def failure(self) -> CoordinationError:
        """Return the error of the formulas if nothing can replace the sources at fault."""
        error = worst_fault(self.faults).error
        reason = f'; no other states: {self._obstacle}' if self._obstacle else ''
        return CoordinationError(f'{error.message}{reason}', error.code)

    def _explain(self, violation: Violation, received: Mapping[str, int], now: int) -> None:
        oldest = max(received.values(), default=0) - violation.allowed
        silent = [topic for topic, latest in received.items() if latest < oldest]
        known = self._known()
        found = [each for topic in silent for each in known.affected(self.chosen, topic)]
        # If the source at fault is unknown, all are excluded: the fault must not go unnoticed.
        self._blame(found or self.chosen, violation, now)

    def _find_silence(
        self, received: Mapping[str, int], since: int, now: int, known_until: int
    ) -> None:
        limit, known = self.silence_limit, self._known()
        oldest = known_until - limit
        silences = {topic: oldest - max(latest, since) for topic, latest in received.items()}
        started = {topic: each for topic, each in silences.items() if received[topic]}
        for topic in [topic for topic, silence in silences.items() if silence > 0]:
            sources = known.affected(self.chosen, topic)
            self.exclude(sources, now)
            can_replace = self.choice.can_replace(sources, self._replacements(now), known, now)
            if can_replace or any(known.is_overdue(each, started) for each in sources):
                text = f"topic '{topic}' has been silent for {limit / SECOND_NS:g} s"
                self.note_loss(text, transient=can_replace)

    def _blame(self, sources: Sequence[FeatureSource], violation: Violation, now: int) -> None:
        self.exclude(sources, now)
        error = CoordinationError(describe_violation(violation), ExitCode.CONSTRAINT_VIOLATION)
        self.faults.append(StateFault(error, transient=False))


class StandbySources:
    """Decides which sources stand by for the sources in use.

    It makes no streams: the caller makes them, sets `chosen`, and reports faults. A failed source
    does not stand by for a while. All times are on one clock, in nanoseconds.

    Args:
        known: returns all streams.
        candidates: all sources.
    """

    def __init__(self, known: Callable[[], KnownStreams], candidates: Candidates) -> None:
        self.in_use: tuple[FeatureSource, ...] = ()
        self.candidates = candidates
        self.chosen: tuple[FeatureSource, ...] = ()
        """The sources of the standby; none without one."""
        self.is_broken = False
        """True if states of the standby may be missing or wrong."""
        self._known = known
        self._choice = SourceChoice()

    def wanted(self, now: int, best: tuple[FeatureSource, ...] = ()) -> tuple[FeatureSource, ...]:
        """Return the sources that should stand by; none if no others may.

        Args:
            now: the time.
            best: the best sources; they stand by if they differ from the sources in use.
        """
        if best and best != self.in_use and not self._choice.have_failed(best, now):
            return best
        return self._choice.stand_ins(self.in_use, self.candidates, self._known(), now, self.chosen)

    def give_up(self) -> None:
        """Note that there is no standby."""
        self.chosen, self.is_broken = (), False

    def exclude(self, sources: Iterable[FeatureSource], now: int) -> None:
        """Use no states of sources that have failed."""
        self._choice.exclude(sources, now)

    def exclude_unusable(self, chosen: Iterable[FeatureSource], now: int) -> None:
        """Use no states of sources that no stream can be made of."""
        self.exclude(set(chosen) - set(self.in_use), now)

    def exclusion_end(self, now: int) -> int | None:
        """Return when the first source may be used again that has failed; None without any."""
        return self._choice.exclusion_end(self.candidates.found, now)

    def note_violation(self, violation: Violation, now: int, *, is_own: bool) -> None:
        """Use no sources that a violation concerns.

        Args:
            violation: in the states in use, or in the states of the standby.
            now: the time.
            is_own: True if it is in the states of the standby.
        """
        either = (*self.in_use, *self.chosen)
        affected = self._known().affected(either, violation.stream_name)
        self.exclude(affected or (self.chosen if is_own else ()), now)
        # Without a name, it concerns all streams: the clock was set back.
        if is_own or not violation.stream_name or set(affected) & set(self.chosen):
            self.is_broken = True

    def is_well(self, now: int) -> bool:
        """Return True if the states of the standby may be used.

        Without samples of its sources, it is not well: they may never have any.
        """
        known = self._known()
        if not self.chosen or self.is_broken or self._choice.have_failed(self.chosen, now):
            return False
        return all(known.is_available(each) and known.is_flowing(each) for each in self.chosen)

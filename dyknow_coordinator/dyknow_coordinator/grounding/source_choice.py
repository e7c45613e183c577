"""The choice among the sources of the ground features, and the faults that lead to another one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from dyknow_common import SECOND_NS, round_duration
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.known_streams import KnownStreams
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
        """Return what `choose` does, but a source that has samples if there is one.

        It is asked after a failure: at the start, the first samples may still be on their way.
        """
        return self.choose(features, candidates, known, now, known.is_flowing)

    def better(
        self,
        in_use: Sequence[FeatureSource],
        candidates: Candidates,
        known: KnownStreams,
        now: int,
    ) -> tuple[FeatureSource, ...]:
        """Return the best source of each feature that has samples; those in use if none is better.

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
        """Return another available source of each feature that has one, else the one in use.

        Return none if no feature has another one, or if one has only a source that failed recently.
        A source whose streams have samples is preferred to one whose streams wait for them.

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
        return are_others and are_well and not any(self.is_excluded(each, now) for each in new)


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

"""The sources on standby: which stand by for those in use, until when, and whether to use them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.known_streams import KnownStreams
from dyknow_coordinator.grounding.source_choice import SourceChoice
from dyknow_stream_processing import Violation


class StandbySources:
    """Decides which sources stand by for those in use.

    It makes no streams: whoever does sets `chosen`, and tells it of faults. A failed source does
    not stand by for a while. All times are of one clock, in nanoseconds.

    Args:
        known: returns all streams.
    """

    def __init__(self, known: Callable[[], KnownStreams]) -> None:
        self.in_use: tuple[FeatureSource, ...] = ()
        self.candidates = Candidates(())
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
            best: the best sources, which stand by if they are others than those in use.
        """
        if best and best != self.in_use and not self._have_failed(best, now):
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
            violation: in the states in use, or in those of the standby.
            now: the time.
            is_own: True if it is in those of the standby.
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
        if not self.chosen or self.is_broken or self._have_failed(self.chosen, now):
            return False
        return all(known.is_available(each) and known.is_flowing(each) for each in self.chosen)

    def _have_failed(self, sources: Iterable[FeatureSource], now: int) -> bool:
        return any(self._choice.is_excluded(each, now) for each in sources)

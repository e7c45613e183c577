"""Verdicts on formulas, and their margins and probabilities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from math import ceil, floor, inf, isfinite
from typing import Any, Final

from dyknow_common.durations import round_time

_SHOWN: Final = 1_000_000
"""Bounds of probabilities are shown in multiples of its inverse."""

_SAME: Final = 1e-9

_BAR: Final = 10
"""The number of characters of the bar of a probability."""


class Verdict(IntEnum):
    """The verdict on a formula; numbers as in dyknow_interfaces/msg/FormulaResult."""

    UNDECIDED = 0
    TRUE = 1
    FALSE = 2


@dataclass(frozen=True, slots=True)
class Margin:
    """Distance of a formula from the change of its verdict (its robustness).

    Above zero the formula is true, below zero false. The bounds are equal once no further state
    changes them. `str` is for people: `2.5 W (Power[uav1] > 150)`, `at most 3 m (...)`.

    Args:
        lower: the least margin that is still possible.
        upper: the greatest one.
        unit: the unit of the comparison; empty for a number without a unit.
        atom: the comparison that limits the margin; empty if none does.
    """

    lower: float = -inf
    upper: float = inf
    unit: str = ''
    atom: str = ''

    @property
    def document(self) -> dict[str, Any]:
        """The margin for JSON, which has no infinite numbers: these are texts."""
        bounds = {'lower': self.lower, 'upper': self.upper}
        finite = {name: each if isfinite(each) else str(each) for name, each in bounds.items()}
        return {**finite, 'unit': self.unit, 'atom': self.atom}

    def __str__(self) -> str:
        unit = f' {self.unit}' if self.unit else ''
        atom = f' ({self.atom})' if self.atom else ''
        if self.lower == self.upper:
            return f'{self.lower:.6g}{unit}{atom}'
        if self.lower == -inf:
            return 'unknown' if self.upper == inf else f'at most {self.upper:.6g}{unit}{atom}'
        if self.upper == inf:
            return f'at least {self.lower:.6g}{unit}{atom}'
        return f'{self.lower:.6g} to {self.upper:.6g}{unit}{atom}'


@dataclass(frozen=True, slots=True)
class ProbabilityInterval:
    """Bounds of the probability of a formula, with what they assume.

    `str` is for people: `at least 0.987, assuming nothing about correlation`.

    Args:
        lower: the least probability that is possible.
        upper: the greatest one.
        assumption: the assumption of the bounds, in words.
    """

    lower: float
    upper: float
    assumption: str

    @property
    def document(self) -> dict[str, Any]:
        """The interval for JSON."""
        return {'lower': self.lower, 'upper': self.upper, 'assumption': self.assumption}

    def __str__(self) -> str:
        return f'{self.bounds}, {self.assumption}'

    @property
    def bar(self) -> str:
        """The interval as a bar: full up to the lower bound, half full up to the upper one."""
        # Bounds are rounded outwards here, too.
        full, end = floor(self.lower * _BAR + _SAME), ceil(self.upper * _BAR - _SAME)
        return '█' * full + '▒' * (end - full) + '░' * (_BAR - end)

    @property
    def bounds(self) -> str:
        """The bounds for people, without the assumption."""
        # Bounds are rounded outwards: 0.9999996 is not 1.
        if self.upper - self.lower < _SAME:
            shown = f'{self.lower:.6g}'
            return f'{self.lower:.10g}' if shown == '1' else shown
        lower, upper = floor(self.lower * _SHOWN) / _SHOWN, ceil(self.upper * _SHOWN) / _SHOWN
        if lower <= 0:
            return 'unknown' if upper >= 1 else f'at most {upper:g}'
        return f'at least {lower:g}' if upper >= 1 else f'{lower:g} to {upper:g}'


@dataclass(frozen=True, slots=True)
class ViolationEpisode:
    """Consecutive start states: a formula is false from each of them.

    Args:
        begin: the valid time of the first state, in nanoseconds.
        end: the valid time of the last state so far.
        decided_at: the valid time of the state that decided the formula from the first state on.
        states: the number of states.
        has_ended: True if the formula holds again after the last state.
        explanation: the reason for the verdict from the first state on, for people.
        worst: the least margin from one of the states; None if margins were not asked for.
    """

    begin: int
    end: int
    decided_at: int
    states: int
    has_ended: bool
    explanation: str
    worst: Margin | None = None

    @property
    def text(self) -> str:
        """The reason and the worst margin, for people."""
        return f'{self.explanation}{f"; at worst {self.worst}" if self.worst else ""}'

    @property
    def past_text(self) -> str:
        """The times of an episode that has ended, and its reason, for people."""
        return f'it was violated from {self.span}: {self.text}'

    @property
    def span(self) -> str:
        """The times of an episode that has ended, for people."""
        return f'{round_time(self.begin, self.end)} to {round_time(self.end, self.begin)}'


@dataclass(frozen=True, slots=True)
class StandingVerdicts:
    """Verdicts on a formula that is asked at every state.

    Args:
        holds: the number of states from which the formula is true.
        fails: the number of states from which it is false.
        undecided: the number of states from which it is not decided yet.
        unknown: the number of states from which nothing can decide it any more, because states are
            missing or values are unknown.
        is_violated: True if an episode has not ended.
        episode_count: the number of episodes.
        latest_episodes: the last ten, the latest last.
    """

    holds: int = 0
    fails: int = 0
    undecided: int = 0
    unknown: int = 0
    is_violated: bool = False
    episode_count: int = 0
    latest_episodes: tuple[ViolationEpisode, ...] = ()

    @property
    def states(self) -> int:
        """The number of states from which it was asked."""
        return self.holds + self.fails + self.undecided + self.unknown

    @property
    def verdict(self) -> Verdict:
        """FALSE if it is false from a state, TRUE if it is true from all states."""
        if self.fails:
            return Verdict.FALSE
        is_known = self.holds and not (self.undecided or self.unknown)
        return Verdict.TRUE if is_known else Verdict.UNDECIDED

    @property
    def text(self) -> str:
        """The verdicts in one line, for people."""
        episodes = f' in {_plural(self.episode_count, "episode")}'
        others = (
            f', fails from {self.fails}{episodes}' if self.fails else '',
            f', undecided from {self.undecided}' if self.undecided else '',
            f', unknown from {self.unknown}' if self.unknown else '',
        )
        return f'holds from {self.holds} of {_plural(self.states, "state")}{"".join(others)}'

    @property
    def is_known(self) -> bool:
        """True if it is known from a state if it is true."""
        return bool(self.holds or self.fails)

    def known_after(self, before: StandingVerdicts) -> StandingVerdicts:
        """Return these, or the former ones while nothing is known: episodes outlast restarts."""
        return self if self.is_known else before

    def _has_restarted(self, before: StandingVerdicts) -> bool:
        more = self.episode_count - before.episode_count
        if more < 0 or not before.latest_episodes or more >= len(self.latest_episodes):
            return more < 0
        # The same episode, or one that began after it.
        return self.latest_episodes[-1 - more].begin > before.latest_episodes[-1].end

    def change(self, before: StandingVerdicts) -> str:
        """Return what has happened since earlier verdicts, for people; empty if nothing has."""
        more = self.episode_count - before.episode_count
        latest = self.latest_episodes[-1] if self.latest_episodes else None
        if latest is None or (more <= 0 and self.is_violated == before.is_violated):
            return ''
        others = f' ({more} episodes since the last report)' if more > 1 else ''
        if self.is_violated:
            return f'violated from {round_time(latest.begin)} on{others}: {latest.text}'
        since = f'{latest.span}{others}: {latest.text}'
        return f'holds again, after it was false from {since}'

    def changes(self, before: StandingVerdicts) -> Iterator[tuple[ViolationEpisode, bool]]:
        """Yield the episodes that have begun or ended since earlier verdicts, in their order.

        An episode comes with False for its begin, and with True for its end. If there were more
        than ten episodes since then, only the last ten are known. A formula that restarts with
        other objects counts its episodes from 0; if it then holds, the former episode has ended.
        """
        if not self.is_known:
            return
        has_restarted = self._has_restarted(before)
        known = 0 if has_restarted else before.episode_count
        if has_restarted and before.is_violated and not self.latest_episodes:
            yield before.latest_episodes[-1], True
        first = self.episode_count - len(self.latest_episodes) + 1
        for number, each in enumerate(self.latest_episodes, start=first):
            if number > known:
                yield each, False
            if each.has_ended and (number > known or (number == known and before.is_violated)):
                yield each, True


def _plural(count: int, noun: str) -> str:
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'

"""The judgement of `clocks.py`: formulas by their definition, over the messages of two robots."""

from __future__ import annotations

import sys
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / 'dyknow_reasoning' / 'test'))

from clock_robots import MS, STAMPED, Message, Topic
from dyknow_interfaces.msg import ExitStatus
from reasoning_reference import holds
from running_system import outcome_of

from dyknow_common import SECOND_NS, round_time
from dyknow_common.ros import time_to_nanoseconds
from dyknow_reasoning import parse_formula

MAX_LEAD_NS = 100 * MS
MAX_DELAY_NS = SECOND_NS
"""The limits of stamps by default: ahead of the clock, and behind it."""

TRANSPORT_NS = 100 * MS
"""The time that a message may take from its publisher to the engine."""

TOLERANCE_NS = 300 * MS
"""Tolerance of the begin of a formula where true times decide: two and a half periods."""


MISSED = 'max_gap is'
"""A part of errors about messages that are missed, as they are late or were dropped."""

VERDICTS = {'true': True, 'false': False}

RIGHT, RIGHT_BY_OFFSET, WRONG = 'right', 'right by an allowed offset', 'wrong'
ALLOWED, NOT_ALLOWED = 'error, allowed', 'error, not allowed'
JUDGEMENTS = (RIGHT, RIGHT_BY_OFFSET, WRONG, ALLOWED, NOT_ALLOWED)


States = list[tuple[int, dict[str, int]]]


def states_of(topics: Mapping[str, Sequence[Message]], time_of: Callable[[Message], int]) -> States:
    """Return the states of some topics, each with its time, at the times of their messages.

    Args:
        topics: the messages of each topic, by the name of its level in the formula.
        time_of: returns the time from which on a message counts.
    """
    times = {name: [time_of(each) for each in found] for name, found in topics.items()}
    begin = max(each[0] for each in times.values())
    return [
        (at, {name: topics[name][bisect_right(times[name], at) - 1].level for name in topics})
        for at in sorted({at for each in times.values() for at in each if at >= begin})
    ]


@dataclass
class Question:
    """A formula about two robots, and its answer; times in nanoseconds.

    Args:
        text: of the formula.
        topics: by the names of their levels in the formula.
        begin: no state of the formula is earlier.
        limit: the time by which a stamped message may come after its stamp.
        asked: the time of the question.
        episode: its description.
    """

    text: str
    topics: Mapping[str, Topic]
    begin: int
    limit: int
    asked: int
    episode: str
    answered: int = 0
    answer: Any = None

    @property
    def outcome(self) -> str:
        """The outcome in a word or two."""
        return outcome_of(self.answer)

    @property
    def decided_at(self) -> int:
        """The valid time of the deciding state."""
        return time_to_nanoseconds(self.answer.decided_at)


class Judge:
    """Judges the answer of a question by the messages of its topics."""

    def __init__(self, question: Question) -> None:
        self._question = question
        self._formula = parse_formula(question.text)
        self._messages = {name: each.messages for name, each in question.topics.items()}
        self._stamped = [each.messages for each in question.topics.values() if each.kind == STAMPED]
        self._error = question.answer.exit_status

    def judgement(self) -> str:
        """Return one of `JUDGEMENTS`."""
        question = self._question
        if question.outcome not in VERDICTS:
            return ALLOWED if self._may_fail() else NOT_ALLOWED
        verdict = VERDICTS[question.outcome]
        if not self._is_within_limits():
            return RIGHT if self._agrees_with_life(verdict) else WRONG
        if not self._agrees_with_stamps(verdict):
            return WRONG
        return RIGHT if self._agrees_with_life(verdict) else RIGHT_BY_OFFSET

    def _may_fail(self) -> bool:
        """Return True if the error is due to a message that may have broken a limit.

        The error names this message; or the one before or after it, if it is missed. A timeout
        names none.
        """
        return any(
            self._may_break_limit(each) and self._is_meant(before, each, after)
            for messages in self._stamped
            for before, each, after in zip(
                [messages[0], *messages], messages, [*messages[1:], messages[-1]], strict=False
            )
        )

    def _is_meant(self, before: Message, message: Message, after: Message) -> bool:
        question, text = self._question, self._error.message
        if self._error.code == ExitStatus.TIMEOUT:
            return question.asked < message.ended and message.begun < question.answered
        named = (before, after) if MISSED in text else (message,)
        return any(f'valid at {round_time(each.stamp)}' in text for each in named)

    def _may_break_limit(self, message: Message) -> bool:
        is_ahead = message.stamp - message.begun > MAX_LEAD_NS
        is_late = message.ended + TRANSPORT_NS - message.stamp > self._question.limit
        if MISSED in self._error.message or self._error.code == ExitStatus.TIMEOUT:
            return is_ahead or is_late
        return is_ahead if 'ahead of the clock' in self._error.message else is_late

    def _is_within_limits(self) -> bool:
        """Return False if a message that the verdict depends on has surely broken a limit."""
        question = self._question
        begin, end = question.begin - TOLERANCE_NS, question.decided_at
        return not any(
            each.stamp - each.ended - TRANSPORT_NS > MAX_LEAD_NS
            or each.begun - each.stamp > question.limit
            for messages in self._stamped
            for each in messages
            if begin <= each.stamp <= end
        )

    def _agrees_with_stamps(self, verdict: bool) -> bool:  # noqa: FBT001
        """Return True if the states until the deciding one, by the stamps, have this verdict.

        An unstamped message was sent at some time of its publication.
        """
        question = self._question
        for time_of in (
            lambda each: each.stamp or each.begun,
            lambda each: each.stamp or each.ended,
        ):
            states = states_of(self._messages, time_of)
            begin = bisect_left(states, question.begin, key=itemgetter(0))
            end = bisect_right(states, question.decided_at, key=itemgetter(0))
            if begin < end and holds(self._formula, states[:end], begin) is verdict:
                return True
        return False

    def _agrees_with_life(self, verdict: bool) -> bool:  # noqa: FBT001
        """Return True if the formula has this verdict by the true times."""
        question = self._question
        states = states_of(self._messages, lambda each: each.true or each.begun)
        begin = bisect_left(states, question.begin - TOLERANCE_NS, key=itemgetter(0))
        end = bisect_right(states, question.begin + TOLERANCE_NS, key=itemgetter(0))
        return any(holds(self._formula, states, each) is verdict for each in range(begin, end))

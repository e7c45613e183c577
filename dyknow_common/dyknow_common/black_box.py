"""The recording around the moment when a formula fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dyknow_common.durations import SECOND_NS, round_duration
from dyknow_common.errors import DyKnowError, shortened

MAX_RECORDED_NS: Final = 600 * SECOND_NS
"""The longest time before a failure, and the longest after it."""

MAX_RECORDED_TOPICS: Final = 200


@dataclass(frozen=True, slots=True)
class BlackBoxOptions:
    """A black box of a formula.

    Args:
        topics: the topics to record; empty: its verdicts and the topics of its states.
        before: the time before a failure that is recorded, nanoseconds.
        after: the time after it.

    Raises:
        DyKnowError: if a time or the number of topics is out of range.
    """

    topics: tuple[str, ...] = ()
    before: int = 10 * SECOND_NS
    after: int = 2 * SECOND_NS

    def __post_init__(self) -> None:
        """Check the options."""
        for name, time in (('before', self.before), ('after', self.after)):
            if not 0 <= time <= MAX_RECORDED_NS:
                raise DyKnowError(
                    f"record: '{name}' is {round_duration(time)}; give a time from 0 s to "
                    f'{round_duration(MAX_RECORDED_NS)}'
                )
        if len(self.topics) > MAX_RECORDED_TOPICS:
            raise DyKnowError(
                f'record: {len(self.topics)} topics are more than {MAX_RECORDED_TOPICS}; name fewer'
            )
        for topic in self.topics:
            if not topic.strip('/') or any(each.isspace() for each in topic):
                raise DyKnowError(f"record: '{shortened(topic)}' is no name of a topic")

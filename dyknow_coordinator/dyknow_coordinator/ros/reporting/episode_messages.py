"""Conversion between the verdicts on a formula that is asked at every state and their messages."""

from __future__ import annotations

from typing import Final

from dyknow_interfaces.msg import Episode, FormulaEpisodes

from dyknow_common.ros import (
    margin_from_message,
    margin_to_message,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from dyknow_coordinator.evaluation import StandingVerdicts, ViolationEpisode

_FIELDS: Final = ('holds', 'fails', 'undecided', 'unknown', 'is_violated', 'episode_count')
_EPISODE_FIELDS: Final = ('states', 'has_ended', 'explanation')


def verdicts_to_message(verdicts: StandingVerdicts) -> FormulaEpisodes:
    """Return a FormulaEpisodes message, without the names of the formula."""
    return FormulaEpisodes(
        **{name: getattr(verdicts, name) for name in _FIELDS},
        latest_episodes=[
            Episode(
                begin=nanoseconds_to_time(each.begin),
                end=nanoseconds_to_time(each.end),
                decided_at=nanoseconds_to_time(each.decided_at),
                worst=margin_to_message(each.worst),
                **{name: getattr(each, name) for name in _EPISODE_FIELDS},
            )
            for each in verdicts.latest_episodes
        ],
    )


def verdicts_from_message(message: FormulaEpisodes) -> StandingVerdicts:
    """Return the verdicts in a FormulaEpisodes message."""
    return StandingVerdicts(
        **{name: getattr(message, name) for name in _FIELDS},
        latest_episodes=tuple(
            ViolationEpisode(
                begin=time_to_nanoseconds(each.begin),
                end=time_to_nanoseconds(each.end),
                decided_at=time_to_nanoseconds(each.decided_at),
                worst=margin_from_message(each.worst),
                **{name: getattr(each, name) for name in _EPISODE_FIELDS},
            )
            for each in message.latest_episodes
        ),
    )

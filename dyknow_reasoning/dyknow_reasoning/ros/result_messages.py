"""Results of formulas, and reports on undecided ones, as messages."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from dyknow_interfaces.msg import Episode, FormulaEpisodes, FormulaProgress
from dyknow_interfaces.msg import FormulaResult as FormulaResultMessage

from dyknow_common.ros import fill_exit_status, margin_to_message, nanoseconds_to_time
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.results import FormulaResult
from dyknow_reasoning.standing import EpisodeSummary, FailureEpisode


def result_to_message(result: FormulaResult, group_id: int, stamp: Time) -> FormulaResultMessage:
    """Return the message of a result of a formula in a group."""
    message = FormulaResultMessage(
        formula_group_id=group_id,
        formula_id=result.formula_id,
        formula_name=result.name,
        verdict=int(result.verdict),
        explanation=result.explanation,
        margin=margin_to_message(result.margin),
    )
    message.header.stamp = stamp
    if result.decided_at is not None:
        message.decided_at = nanoseconds_to_time(result.decided_at)
    if result.error is not None:
        fill_exit_status(message.exit_status, result.error)
    return message


def progress_to_message(
    group: FormulaGroup, formula_id: int, latest: int | None
) -> FormulaProgress:
    """Return a report on an undecided formula, without the numbers of its group and its states.

    Args:
        group: the group of the formula.
        formula_id: the id of the formula.
        latest: the valid time of its latest state in nanoseconds; None before the first.
    """
    return FormulaProgress(
        formula_id=formula_id,
        latest_valid_time=nanoseconds_to_time(latest or 0),
        residual_formula=group.residual(formula_id),
        presumably_false=group.presumably_false(formula_id),
        margin=margin_to_message(group.margin(formula_id)),
    )


def summary_to_message(summary: EpisodeSummary) -> FormulaEpisodes:
    """Return the message of the verdicts on a formula, without the formula."""
    counts = summary.counts
    return FormulaEpisodes(
        holds=counts.holds,
        fails=counts.fails,
        undecided=counts.undecided,
        unknown=counts.unknown,
        is_violated=summary.is_violated,
        episode_count=summary.episode_count,
        latest_episodes=[_episode_to_message(each) for each in summary.latest_episodes],
    )


def _episode_to_message(episode: FailureEpisode) -> Episode:
    return Episode(
        begin=nanoseconds_to_time(episode.begin),
        end=nanoseconds_to_time(episode.end),
        decided_at=nanoseconds_to_time(episode.decided_at),
        states=episode.states,
        has_ended=episode.has_ended,
        explanation=episode.explanation,
        worst=margin_to_message(episode.worst),
    )

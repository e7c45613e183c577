"""Results of a check as JSON; docs/recordings.schema.json describes the keys."""

from __future__ import annotations

from typing import Any

from dyknow_common import DyKnowError
from dyknow_recordings.evaluation.results import Episode, FormulaReport, RecordingReport
from dyknow_recordings.health import BrokenExpectation
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_stream_processing import Violation


def recording_document(report: RecordingReport, judgement: Judgement) -> dict[str, Any]:
    """Return the results of one recording."""
    return {
        'recording': report.recording,
        'start_ns': report.start_time,
        'end_ns': report.end_time,
        'formulas': [_formula(each, judgement) for each in report.formulas],
        'broken_expectations': [_broken(each) for each in report.broken],
        'notes': list(report.notes),
        'error': None,
    }


def failure_document(recording: str | None, error: DyKnowError) -> dict[str, Any]:
    """Return the document of a recording, or of a configuration, that cannot be read."""
    return {'recording': recording, 'error': _error(error)}


def topics_document(recording: RecordingReader) -> dict[str, Any]:
    """Return the topics of a recording, and its faults."""
    return {
        'recording': str(recording.path),
        'topics': [
            {
                'name': name,
                'message_type': each.message_type,
                'messages': each.count,
                'has_stamp': each.has_stamp,
                'has_sent_times': each.has_sent_times,
                'fields': None if each.fields is None else dict(each.fields),
            }
            for name, each in recording.contents.items()
        ],
        'notes': list(map(str, recording.faults)),
        'error': None,
    }


def _formula(report: FormulaReport, judgement: Judgement) -> dict[str, Any]:
    return {
        'name': report.name,
        'formula': report.formula,
        'outcome': report.outcome,
        'passed': judgement.passes(report),
        'states': report.states,
        'episodes': [_episode(each) for each in report.episodes],
        'groundings': [
            {
                'symbol': each.symbol,
                'grounding': each.grounding.name.lower(),
                'stream': each.stream,
                'stand_ins': list(each.stand_ins),
            }
            for each in report.groundings
        ],
        'violations': [_violation(each) for each in report.violations],
        'gaps': [{'after_ns': each.after, 'before_ns': each.before} for each in report.gaps],
        'events': list(report.events),
        'waits_for': report.waits_for,
        'probability': report.probability and report.probability.document,
        'probability_so_far': report.probability_so_far and report.probability_so_far.document,
        'error': _error(report.error),
    }


def _broken(each: BrokenExpectation) -> dict[str, Any]:
    return {
        'topic': each.topic,
        'rule': each.rule,
        'message': each.message,
        'begin_ns': each.begin,
        'end_ns': each.end,
    }


def _episode(episode: Episode) -> dict[str, Any]:
    return {
        'begin_ns': episode.begin,
        'verdict': episode.verdict.name.lower(),
        'decided_at_ns': episode.decided_at,
        'explanation': episode.explanation,
        'residual_formula': episode.residual_formula,
        'presumably_false': episode.presumably_false,
        'margin': episode.margin and episode.margin.document,
        'error': _error(episode.error),
    }


def _violation(violation: Violation) -> dict[str, Any]:
    return {
        'stream': violation.stream_name,
        'constraint': str(violation.constraint),
        'valid_time_ns': violation.valid_time,
        'available_time_ns': violation.available_time,
        'observed_ns': violation.observed,
        'allowed_ns': violation.allowed,
        'message': violation.message,
    }


def _error(error: DyKnowError | None) -> dict[str, str] | None:
    return None if error is None else {'code': error.code.name, 'message': error.message}

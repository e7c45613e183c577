"""Outputs of a check: each gets the results of the recordings as they come.

docs/recordings.schema.json describes the keys of the JSON.
"""

from __future__ import annotations

import json
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

from dyknow_common import DyKnowError, ExitCode, replace_file, with_readable_times
from dyknow_common.executables import ERROR, SUCCESS
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import Episode, FormulaReport, RecordingReport
from dyknow_recordings.health import BrokenExpectation
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.pictures.timeline import extent
from dyknow_stream_processing import Violation


class CheckOutput(ABC):
    """A place for results. They come in the order of the recordings on the command line."""

    @abstractmethod
    def add(self, report: RecordingReport) -> None:
        """Add the results of a recording."""

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:  # noqa: B027
        """Add a recording that could not be checked; None if the configuration is wrong."""

    def close(self, unchecked: Sequence[str]) -> None:  # noqa: B027 - most need not end anything
        """End the output.

        Args:
            unchecked: the recordings that were not checked because of an interruption.
        """


class AllOutputs(CheckOutput):
    """Several outputs as one."""

    def __init__(self, outputs: Iterable[CheckOutput]) -> None:
        self._outputs = tuple(outputs)

    def add(self, report: RecordingReport) -> None:
        """Add the results of a recording to each."""
        for each in self._outputs:
            each.add(report)

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:
        """Add a recording that could not be checked to each."""
        for each in self._outputs:
            each.add_failure(recording, error)

    def close(self, unchecked: Sequence[str]) -> None:
        """End each, in their order, also if one of them fails."""
        with ExitStack() as stack:
            for each in reversed(self._outputs):
                stack.callback(each.close, unchecked)


class JsonLines(CheckOutput):
    """A line of JSON for each recording, on the standard output."""

    def __init__(self, judgement: Judgement) -> None:
        self._judgement = judgement

    def add(self, report: RecordingReport) -> None:
        """Print the line of a recording."""
        print_document(recording_document(report, self._judgement))

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:
        """Print the line of a recording that could not be checked."""
        print_document(failure_document(recording, error))


class Messages(CheckOutput):
    """Errors of recordings and faults that are no errors, on the standard error output.

    Args:
        with_notes: True to print faults that are no errors.
    """

    def __init__(self, *, with_notes: bool) -> None:
        self._with_notes = with_notes

    def add(self, report: RecordingReport) -> None:
        """Print the notes of a recording."""
        if self._with_notes:
            start = extent(report).origin
            notes = (with_readable_times(str(each), start) for each in report.notes)
            print_notes(report.recording, notes)

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:  # noqa: ARG002
        """Print an error, which names the recording."""
        sys.stderr.write(f'dyknow check: {error.message}\n')

    def close(self, unchecked: Sequence[str]) -> None:
        """Say what an interruption has left out."""
        if unchecked:
            sys.stderr.write(f'dyknow check: interrupted; not checked: {len(unchecked)}\n')


class ExitStatus(CheckOutput):
    """The exit code of the command, from its worst recording.

    Args:
        judgement: the judgement of undecided formulas.
        is_strict: True if each note is an error.
    """

    def __init__(self, judgement: Judgement, *, is_strict: bool) -> None:
        self._judgement = judgement
        self._is_strict = is_strict
        self.code = SUCCESS

    def add(self, report: RecordingReport) -> None:
        """Regard the results of a recording."""
        is_error = self._is_strict and report.notes
        self.code = max(self.code, ERROR if is_error else self._judgement.exit_code((report,)))

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:  # noqa: ARG002
        """Regard a recording that could not be checked."""
        self.code = ERROR


def print_notes(recording: str, notes: Iterable[object]) -> None:
    """Print faults of a recording and of the configuration; the latter's name its file already."""
    for note in map(str, notes):
        sys.stderr.write(f'{note if note.startswith(recording) else f"{recording}: {note}"}\n')


def print_document(document: dict[str, Any]) -> None:
    """Print a line of JSON."""
    sys.stdout.write(f'{json.dumps(document, ensure_ascii=False)}\n')
    sys.stdout.flush()


def check_place(option: str, path: Path) -> None:
    """Check that a file can have a path, before the recordings are read.

    Raises:
        RecordingError: naming the option and the mend.
    """
    if path.is_dir():
        raise RecordingError(f'{option} {path}: is a folder; give the name of a file')
    if not path.parent.is_dir():
        text = f'{option} {path}: there is no folder {path.parent}; make it'
        raise RecordingError(text, ExitCode.NOT_FOUND)


def write_report(path: Path, content: bytes) -> None:
    """Replace a file; an interruption leaves the old one.

    Raises:
        RecordingError: if it cannot be written.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be written: {error.strerror}') from None


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
        'attempts': [
            {
                'begin_ns': each.begin,
                'failed_at_ns': each.failed_at,
                'states': each.report.states,
                'episodes': len(each.report.episodes),
                'outcome': each.report.outcome,
                'reason': each.report.reason,
            }
            for each in report.attempts
        ],
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


def optional_library(module: str, option: str, package: str = '') -> Any:
    """Return a module of a library that only an option needs, installed by the name of a package.

    Raises:
        RecordingError: naming the mend, if the library is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = package or module.partition('.')[0]
        raise RecordingError(
            f'{option} needs {library}: {error}; run: pip install {library}', ExitCode.UNAVAILABLE
        ) from None

"""Results as a report of JUnit, which systems for continuous integration show.

All times are from the recordings, so the same recordings have the same report.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Final

from junitparser import Error, Failure, JUnitXml, TestCase, TestSuite

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, with_readable_times
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport
from dyknow_recordings.health import BrokenExpectation
from dyknow_recordings.reporting.judgement import Judgement, reasons
from dyknow_recordings.reporting.outputs import CheckOutput, check_place, write_report
from dyknow_recordings.reporting.pictures.panels import formula_text
from dyknow_recordings.reporting.pictures.timeline import extent

_INVALID: Final = re.compile('[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]')
"""The characters that XML cannot contain."""

_CONFIGURATION: Final = 'configuration'


class JUnitSuites(CheckOutput):
    """A test suite for each recording, and in it a test case for each formula.

    Args:
        judgement: the judgement of undecided formulas.
    """

    def __init__(self, judgement: Judgement) -> None:
        self._judgement = judgement
        self._suites: list[TestSuite] = []

    def add(self, report: RecordingReport) -> None:
        """Add the suite of a recording."""
        cases = [self._case(each, report) for each in report.formulas]
        cases += [_broken_case(each, report) for each in report.broken]
        suite = _suite(report.recording, cases)
        for number, note in enumerate(report.notes, start=1):
            suite.add_property(f'note {number}', _valid(note))
        for formula in report.formulas:
            if formula.margin is not None:
                # The schema has properties of suites, and none of test cases.
                for name, value in asdict(formula.margin).items():
                    suite.add_property(
                        _valid(f'margin_{name} of {formula.name}'), _valid(str(value))
                    )
        suite.time = _seconds(report.end_time - report.start_time)
        start = datetime.fromtimestamp(report.start_time // SECOND_NS, UTC)
        suite.timestamp = f'{start:%Y-%m-%dT%H:%M:%S}'
        self._suites.append(suite)

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:
        """Add the suite of a recording that could not be checked: a test case with the error."""
        name = _CONFIGURATION if recording is None else recording
        case = TestCase(_valid(name), _class_name(name))
        case.result = _result(Error, error.code.name, error.message)
        self._suites.append(_suite(name, [case]))

    def document(self, name: str) -> bytes:
        """Return all suites as XML, given the name of the command."""
        document = JUnitXml(name)
        for suite in self._suites:
            document.append(suite)
        document.tests = sum(each.tests for each in self._suites)
        document.failures = sum(each.failures for each in self._suites)
        document.errors = sum(each.errors for each in self._suites)
        document.time = round(sum(each.time for each in self._suites), 3)
        return b'<?xml version="1.0" encoding="utf-8"?>\n%b\n' % document.tostring()

    def _case(self, formula: FormulaReport, recording: RecordingReport) -> TestCase:
        decisive = formula.decisive
        at = None if decisive is None else decisive.decided_at
        end = recording.end_time if at is None else at
        case = TestCase(
            _valid(formula.name),
            _class_name(recording.recording),
            _seconds(end - recording.start_time),
        )
        text = with_readable_times('\n'.join(reasons(formula)), extent(recording).origin)
        lines = text, f'formula: {formula_text(formula.formula)}'
        if formula.outcome is Outcome.ERROR:
            error = formula.first_error
            kind = error.code.name if error else ''
            case.result = _result(Error, kind, *lines)
        elif not self._judgement.passes(formula):
            case.result = _result(Failure, formula.outcome, *lines)
        return case


class JUnitReport(JUnitSuites):
    """A file of these suites, which is written at the end.

    Args:
        path: the path of the file.
        judgement: the judgement of undecided formulas.

    Raises:
        RecordingError: if it cannot have this path.
    """

    def __init__(self, path: Path, judgement: Judgement) -> None:
        check_place('--junit', path)
        super().__init__(judgement)
        self._path = path

    def close(self, unchecked: Sequence[str]) -> None:
        """Write the file. What was not checked is an error: else all would seem to be well."""
        for recording in unchecked:
            error = RecordingError('not checked: the command was interrupted', ExitCode.CANCELLED)
            self.add_failure(recording, error)
        write_report(self._path, self.document('dyknow check'))


def _broken_case(broken: BrokenExpectation, report: RecordingReport) -> TestCase:
    name = f'{broken.topic} {broken.rule}'
    end = report.end_time if broken.end is None else broken.end
    time = _seconds(end - report.start_time)
    case = TestCase(_valid(name), _class_name(report.recording), time)
    case.result = _result(Failure, Outcome.FALSE, broken.message)
    return case


def _suite(name: str, cases: Sequence[TestCase]) -> TestSuite:
    suite = TestSuite(_valid(name))
    numbers: Counter[str] = Counter()
    for case in cases:
        numbers[case.name] += 1
        # Tools merge test cases of one name, such as of the places at which a topic is too slow.
        case.name += f' ({numbers[case.name]})' * (numbers[case.name] > 1)
        suite.append(case)
    suite.update_statistics()
    return suite


def _result(kind: type[Error | Failure], name: str, message: str, *more: str) -> Error | Failure:
    result = kind(_valid(message), name)
    result.text = _valid('\n'.join([message, *more]))
    return result


def _class_name(recording: str) -> str:
    """Return the name of a recording as a class name, whose packages are the folders.

    Jenkins takes what stands before the last dot for the package.
    """
    path = PurePath(recording)
    folders = path.relative_to(path.anchor).parts
    return _valid('.'.join(each.replace('.', '_') for each in folders))


def _valid(text: str) -> str:
    return _INVALID.sub('\ufffd', text)


def _seconds(duration: int) -> float:
    return round(max(duration, 0) / SECOND_NS, 3)

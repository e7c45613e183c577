"""The command `dyknow cut`: parts of a recording around failures, without ROS.

Formulas fail in the parts as in the whole recording. A state has the latest value of each topic. So
a span contains, for each topic, the message that was the latest at the first state that the failure
depends on, and all messages after the earliest of these messages. The span ends after the messages
that complete the deciding state:

    always (A -> eventually[0 s, 2 s] B), false at 50 s     depends on states from 48 s on
    /a, each second; /b, last at 47.2 s, then at 51.5 s     47.2 s to 51.5 s, and what was asked for
    /mode without stamps, once at 3 s                       its message comes again at the begin
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import (
    SECOND_NS,
    DyKnowError,
    ExitCode,
    Verdict,
    duration_option,
    format_time,
    round_time,
    with_readable_times,
)
from dyknow_common.executables import ERROR, FALSE, SUCCESS, describe
from dyknow_configuration import RequestedFormula, TopicTimes
from dyknow_reasoning import parse_formula
from dyknow_recordings.black_boxes import horizon, is_bounded, lacking_states
from dyknow_recordings.check_inputs import add_input_options, given_robot, read_configuration
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.health import MAX_MEASURED, observed_topics
from dyknow_recordings.jobs import RecordingJob
from dyknow_recordings.reading.bags.bag import Bag
from dyknow_recordings.reading.opening import message_types, open_recording
from dyknow_recordings.reading.recording import RecordingReader, RecordingSpan, messages_text
from dyknow_recordings.reporting.outputs import print_notes
from dyknow_recordings.reporting.pictures.timeline import extent

MAX_REACH_NS: Final = 60 * SECOND_NS
"""From this age on, a value without a stamp is repeated at the begin of a span."""

CLOCK_NS: Final = SECOND_NS
"""The time after which the clock makes a state certain without a later message of a topic."""

_START: Final = -(1 << 62)
"""A time before all states, in nanoseconds."""

MAX_PARTS: Final = 100
"""The number of parts of a recording."""

_FAILURES: Final = 'failures'

_SHOWN_REASONS: Final = 3


@dataclass(frozen=True, slots=True)
class RecordedFailure:
    """A failure of a formula; the valid times of states are in nanoseconds.

    Args:
        reason: for people.
        first: the first state that the failure depends on.
        last: the deciding state; None if `log_time` says when the failure was known.
        log_time: when the failure was known.
    """

    reason: str
    first: int
    last: int | None = None
    log_time: int | None = None

    @property
    def key(self) -> tuple[str, int | None]:
        """The same for this failure in a part of the recording."""
        return self.reason, self.last


def failures_of(
    report: RecordingReport, requested: Sequence[RequestedFormula]
) -> Iterator[RecordedFailure]:
    """Yield the failures of formulas: false episodes, unmet obligations, violations."""
    has_one_clock = extent(report).origin == report.start_time
    for formula, asked in zip(report.formulas, requested, strict=True):
        if not (formula.episodes or formula.violations):
            continue  # Perhaps the text is no formula.
        parsed, is_standing = parse_formula(formula.formula), asked.every_state
        is_local = not lacking_states(parsed, every_state=is_standing) and (
            is_standing or is_bounded(parsed)
        )
        reach = horizon(formula.formula) if is_local else 0
        for each in formula.episodes:
            last, first = each.decided_at, each.begin
            is_false = each.verdict is Verdict.FALSE and last is not None
            if not is_false and not each.presumably_false:
                continue
            if not is_local or first is None:
                first = _START
            elif not is_standing and (last is not None or has_one_clock):
                first = max(first, (report.end_time if last is None else last) - reach)
            if last is None:
                yield RecordedFailure(
                    f"'{formula.name}' is not met", first, log_time=report.end_time
                )
            else:
                text = f"'{formula.name}' is false at {format_time(last)}"
                yield RecordedFailure(text, first, last)
        for violation in formula.violations:
            first = min(violation.valid_time, violation.available_time)
            yield RecordedFailure(violation.message, first, log_time=violation.available_time)


class _TopicOrder:
    """The messages of a topic in the order of their valid times."""

    def __init__(self, times: TopicTimes) -> None:
        order = np.argsort(times.valid_times, kind='stable')
        self.valid: NDArray[np.int64] = times.valid_times[order]
        self._receipts = times.receipt_times[order]
        # The receipt of the first message that is valid at a time or later.
        self._completions = np.minimum.accumulate(self._receipts[::-1])[::-1]

    def latest(self, time: int) -> int | None:
        """Return when the message was received whose value a state has."""
        row = int(np.searchsorted(self.valid, time, 'right')) - 1
        return int(self._receipts[row]) if row >= 0 else None

    def completion(self, time: int) -> int | None:
        """Return when a message was received that is valid at a time or later."""
        row = int(np.searchsorted(self.valid, time))
        return int(self._completions[row]) if row < len(self.valid) else None

    def valid_before(self, time: int) -> int:
        """Return the latest valid time before another one, or that one."""
        row = int(np.searchsorted(self.valid, time)) - 1
        return int(self.valid[row]) if row >= 0 else time


class SpanFinder:
    """Finds the spans of failures.

    Args:
        times: the times of the topics that formulas read.
        unstamped: the topics in `times` whose messages have no stamp.
        limits: the start and end of the recording, in nanoseconds.
        before: the time before each failure that is wanted, ...
        after: ... and the time after it.
    """

    def __init__(
        self,
        times: Mapping[str, TopicTimes],
        unstamped: Iterable[str],
        limits: tuple[int, int],
        before: int,
        after: int,
    ) -> None:
        self._topics = {name: _TopicOrder(each) for name, each in times.items()}
        self._unstamped = frozenset(unstamped)
        self._start, self._end = limits
        self._before, self._after = before, after

    def around(self, time: int) -> RecordingSpan:
        """Return the span around a log time."""
        return RecordingSpan(*self._limited(time, time), reasons=('the time that was asked for',))

    def span(self, failure: RecordedFailure) -> RecordingSpan:
        """Return the span of a failure."""
        first, known = failure.first, failure.log_time
        if failure.last is not None:
            # A window may have ended after the state before the deciding one.
            ticks = (each.valid_before(failure.last) for each in self._topics.values())
            earlier = max(ticks, default=failure.last)
            first -= max(0, failure.last - earlier)
            found = [each.completion(failure.last) for each in self._topics.values()]
            known = max((each for each in found if each is not None), default=self._end)
            known += CLOCK_NS if None in found else 0
        ages = ((name, each.latest(first)) for name, each in self._topics.items())
        latest = {name: time for name, time in ages if time is not None}
        newest = max(latest.values(), default=self._start)
        repeated = {
            name: each
            for name, each in latest.items()
            if name in self._unstamped and newest - each > MAX_REACH_NS
        }
        begin = min((each for name, each in latest.items() if name not in repeated), default=newest)
        span = RecordingSpan(
            *self._limited(begin, self._end if known is None else known), (failure.reason,)
        )
        return replace(span, repeated=_before(repeated, span.begin))

    def _limited(self, begin: int, end: int) -> tuple[int, int]:
        return max(self._start, begin - self._before), min(self._end, end + self._after)


def joined_spans(spans: Iterable[RecordingSpan]) -> Sequence[RecordingSpan]:
    """Return spans in their order; overlapping spans are joined."""
    found: list[RecordingSpan] = []
    for each in sorted(spans, key=lambda span: (span.begin, span.end)):
        if not found or each.begin > found[-1].end:
            found.append(each)
            continue
        last = found[-1]
        reasons = tuple(dict.fromkeys((*last.reasons, *each.reasons)))
        repeated = {**_before(each.repeated, last.begin), **last.repeated}
        found[-1] = RecordingSpan(last.begin, max(last.end, each.end), reasons, repeated)
    return found


def _before(repeated: Mapping[str, int], begin: int) -> Mapping[str, int]:
    return {name: time for name, time in repeated.items() if time < begin}


def add_cut_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=cut_recording)
    describe(
        parser,
        'Write the parts of a recording around the failures of formulas: false episodes, unmet '
        'obligations and violations of streams. Each part is a recording of its own, in which '
        'the formulas fail as in all of it. Bags become bags in MCAP, traces become traces.',
        (
            'dyknow cut flight.mcap --config robot.yaml',
            'dyknow cut flight.mcap --around 62.5 --before 5 --after 5 -o landing',
        ),
        '0 if the parts are written, 1 if there is no failure, 2 for an error, or if a part does '
        'not show a failure',
    )
    parser.add_argument(
        '--around',
        type=_place,
        default=_FAILURES,
        metavar='failures|TIME',
        help='what the parts are around: failures, or a time after the start of the recording '
        '(default: failures)',
    )
    for name, default in (('before', '10 s'), ('after', '5 s')):
        parser.add_argument(
            f'--{name}',
            type=duration_option,
            default=default,
            metavar='TIME',
            help=f'how much to write {name} each (default: {default})',
        )
    parser.add_argument(
        '-o', '--output', type=Path, metavar='FOLDER', help='a new folder (default: NAME_cut)'
    )
    add_input_options(parser, several=False)


def cut_recording(options: argparse.Namespace) -> int:
    """Write the parts of a recording, and print what they show; return the exit code."""
    path: Path = options.recording
    folder = options.output or Path(f'{path.stem}_cut')
    if folder.exists():
        text = f'{folder} exists; choose another folder by --output'
        raise RecordingError(text, ExitCode.ALREADY_EXISTS)
    if options.around != _FAILURES:
        _cut(options, folder)
        return SUCCESS
    job = _job(options)
    report = _checked(job)
    origin = extent(report).origin
    errors = [each for each in report.formulas if each.error and not each.violations]
    notes = (f"'{each.name}' has an error: {each.error}" for each in errors)
    print_notes(str(path), (with_readable_times(each, origin) for each in notes))
    failures = list(failures_of(report, job.formulas))
    if not failures:
        sys.stdout.write(f'{path}: no formula fails, so nothing is cut\n')
        return ERROR if errors else FALSE
    paths = _cut(options, folder, failures, report.topics, origin)
    return SUCCESS if _shows(job, paths, failures, origin) else ERROR


def _cut(
    options: argparse.Namespace,
    folder: Path,
    failures: Sequence[RecordedFailure] = (),
    topics: Sequence[str] = (),
    origin: int | None = None,
) -> Sequence[Path]:
    """Write the parts around failures of formulas that read some topics; return their paths.

    Times of states are shown since the origin, as by a check.
    """
    with open_recording(options.recording, message_types(options)) as recording:
        spans = _spans(recording, failures, topics, options)
        paths = _write(recording, spans, folder, topics, origin)
        notes = map(str, (*recording.faults, *_type_notes(recording)))
        readable = (with_readable_times(each, recording.start_time) for each in notes)
        print_notes(str(recording.path), readable)
    return paths


def _job(options: argparse.Namespace) -> RecordingJob:
    files, formulas = read_configuration(options, given_robot(options))
    path: Path = options.recording
    return RecordingJob(str(path), path, formulas, files, types=message_types(options))


def _checked(job: RecordingJob) -> RecordingReport:
    found = job.run()
    if isinstance(found, DyKnowError):
        raise found
    return found


def _spans(
    recording: RecordingReader,
    failures: Sequence[RecordedFailure],
    topics: Sequence[str],
    options: argparse.Namespace,
) -> Sequence[RecordingSpan]:
    observed = observed_topics(recording, lambda *_: (), topics, MAX_MEASURED) if topics else ()
    limits = recording.start_time, recording.end_time
    finder = SpanFinder(
        {each.name: each.times for each in observed if each.count},
        [each for each in topics if not recording.contents[each].has_stamp],
        limits,
        options.before,
        options.after,
    )
    if not failures:
        time = limits[0] + options.around
        if time > limits[1]:
            end = round_time(limits[1] - limits[0])
            raise RecordingError(f'{recording.path}: it ends at {end}; give an earlier time')
        return [finder.around(time)]
    spans = joined_spans(map(finder.span, failures))
    if len(spans) > MAX_PARTS:
        raise RecordingError(
            f'{recording.path}: {len(failures)} failures make {len(spans)} parts, more than '
            f'{MAX_PARTS}; join them by a longer --before or --after, or check fewer formulas'
        )
    return spans


def _write(
    recording: RecordingReader,
    spans: Sequence[RecordingSpan],
    folder: Path,
    topics: Sequence[str],
    origin: int | None,
) -> Sequence[Path]:
    start, paths = recording.start_time, []
    try:
        folder.mkdir(parents=True)
        written = recording.cut(spans, folder, topics)
        for span, (path, count) in zip(spans, written, strict=True):
            paths.append(path)
            times = f'{round_time(span.begin - start)} to {round_time(span.end - start)}'
            reasons = with_readable_times('; '.join(_reasons(span)), origin)
            sys.stdout.write(f'{path}: {times}, {messages_text(count)}: {reasons}\n')
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise RecordingError(f'cannot write to {folder}: {error.strerror}') from None
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return paths


def _type_notes(recording: RecordingReader) -> Iterator[str]:
    if isinstance(recording, Bag) and any(not each.definition.text for each in recording.channels):
        yield (
            'it does not define all of its message types; check the parts with --distro '
            f'{recording.distro}, and the same --messages'
        )


def _reasons(span: RecordingSpan) -> Iterator[str]:
    yield from span.reasons[:_SHOWN_REASONS]
    if (more := len(span.reasons) - _SHOWN_REASONS) > 0:
        yield f'and {more} more'


def _shows(
    job: RecordingJob, paths: Sequence[Path], failures: Sequence[RecordedFailure], start: int
) -> bool:
    """Check the parts; return False, with a note, if they do not show all failures."""
    reports = [_checked(replace(job, name=str(path), path=path)) for path in paths]
    found = {each.key for report in reports for each in failures_of(report, job.formulas)}
    lacking = [each for each in failures if each.key not in found]
    if lacking:
        first = lacking[0].reason
        errors = (
            f'in a part, {formula.error}'
            for report in reports
            for formula in report.formulas
            if formula.error and first.startswith(f"'{formula.name}'")
        )
        why = next(errors, 'streams with a memory or a sample_period depend on more')
        text = f'{len(lacking)} of {len(failures)} failures, first: {first}; {why}'
        sys.stderr.write(
            f'dyknow cut: the parts do not show {with_readable_times(text, start)}; give a longer '
            '--before\n'
        )
    return not lacking


def _place(text: str) -> int | str:
    return text if text == _FAILURES else duration_option(text)

"""The command `dyknow cut`: parts of a recording around failures, without ROS."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from dyknow_common import (
    DyKnowError,
    ExitCode,
    duration_option,
    round_time,
    with_readable_times,
)
from dyknow_common.executables import ERROR, FALSE, SUCCESS, describe
from dyknow_recordings.check_inputs import add_input_options, given_robot, read_configuration
from dyknow_recordings.cutting import (
    RecordedFailure,
    SpanFinder,
    failures_of,
    joined_spans,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.health import MAX_MEASURED, observed_topics
from dyknow_recordings.jobs import RecordingJob
from dyknow_recordings.reading.bags.bag import Bag
from dyknow_recordings.reading.opening import message_types, open_recording
from dyknow_recordings.reading.recording import RecordingReader, RecordingSpan
from dyknow_recordings.reporting.outputs import print_notes

MAX_PARTS: Final = 100
"""The number of parts of a recording."""

_FAILURES: Final = 'failures'
_SHOWN_REASONS: Final = 3


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
    errors = [each for each in report.formulas if each.error and not each.violations]
    print_notes(str(path), (f"'{each.name}' has an error: {each.error}" for each in errors))
    failures = list(failures_of(report, job.formulas))
    if not failures:
        sys.stdout.write(f'{path}: no formula fails, so nothing is cut\n')
        return ERROR if errors else FALSE
    paths = _cut(options, folder, failures, report.topics)
    return SUCCESS if _shows(job, paths, failures) else ERROR


def _cut(
    options: argparse.Namespace,
    folder: Path,
    failures: Sequence[RecordedFailure] = (),
    topics: Sequence[str] = (),
) -> Sequence[Path]:
    """Write the parts around failures of formulas that read some topics; return their paths."""
    with open_recording(options.recording, message_types(options)) as recording:
        spans = _spans(recording, failures, topics, options)
        paths = _write(recording, spans, folder, topics)
        print_notes(str(recording.path), (*recording.faults, *_type_notes(recording)))
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
) -> Sequence[Path]:
    start, paths = recording.start_time, []
    try:
        folder.mkdir(parents=True)
        written = recording.cut(spans, folder, topics)
        for span, (path, count) in zip(spans, written, strict=True):
            paths.append(path)
            times = f'{round_time(span.begin - start)} to {round_time(span.end - start)}'
            text = f'{path}: {times}, {count} messages: {"; ".join(_reasons(span))}'
            sys.stdout.write(f'{with_readable_times(text, start)}\n')
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


def _shows(job: RecordingJob, paths: Sequence[Path], failures: Sequence[RecordedFailure]) -> bool:
    """Check the parts; return False, with a note, if they do not show all failures."""
    found = {
        each.key
        for path in paths
        for each in failures_of(_checked(replace(job, name=str(path), path=path)), job.formulas)
    }
    lacking = [each for each in failures if each.key not in found]
    if lacking:
        sys.stderr.write(
            f'dyknow cut: the parts do not show {len(lacking)} of {len(failures)} failures, first: '
            f'{lacking[0].reason}; streams with a memory or a sample_period depend on more: give a '
            'longer --before\n'
        )
    return not lacking


def _place(text: str) -> int | str:
    return text if text == _FAILURES else duration_option(text)

"""The command `dyknow check`: formulas over recordings, without ROS."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from pathlib import Path
from typing import Final

from dyknow_common import DyKnowError, add_utc_option, duration_option, with_readable_times
from dyknow_common.executables import (
    ERROR,
    FALSE,
    SUCCESS,
    Interruption,
    describe,
    interruptible,
    run_main,
)
from dyknow_configuration import NO_MAP, TopicExpectation
from dyknow_reasoning import read_domains
from dyknow_recordings.black_boxes import BlackBoxContent, read_black_box
from dyknow_recordings.check_inputs import add_input_options, given_robot, read_configuration
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.episodes import Every
from dyknow_recordings.health import health_of
from dyknow_recordings.jobs import (
    JobResult,
    ProgressBar,
    RecordingJob,
    run_here,
    run_in_processes,
    run_on_cluster,
)
from dyknow_recordings.reading.opening import message_types, open_recording
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.outputs import (
    AllOutputs,
    CheckOutput,
    ExitStatus,
    JsonLines,
    Messages,
    failure_document,
    print_document,
    print_notes,
    topics_document,
)
from dyknow_recordings.reporting.pictures.files import PictureFiles

_CONFIGURATION: Final = (
    'config', 'ontology', 'annotations', 'streams', 'bridges', 'formulas', 'formula',
)  # fmt: skip
"""The options in whose place a black box has its own."""


def add_check_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=check)
    describe(
        parser,
        'Check formulas over recordings, with the verdicts of the running system. Formulas name '
        'topics and fields of the recording, or features of an ontology that annotations connect '
        'to topics.',
        (
            'dyknow check flight.mcap --topics',
            'dyknow check flight.mcap --health',
            """dyknow check flight.mcap --formula 'always "/uav1/battery".voltage > 10'""",
            'dyknow check flight1 flight2 --config robot.yaml --json',
        ),
        '0 if all is well, 1 if a formula is false, or undecided and that is a failure, or if a '
        'topic is not as expected, 2 for an error',
    )
    add_input_options(parser)
    _add_descriptions(parser)
    _add_times(parser)
    _add_measures(parser)
    parser.add_argument(
        '--retry',
        action='store_true',
        help='evaluate a formula again after an error, such as a stream that broke its '
        'constraints, as "dyknow up" does',
    )
    parser.add_argument(
        '--undecided',
        type=Judgement,
        choices=list(Judgement),
        default=Judgement.AUTO,
        help='whether formulas pass that are undecided at the end (default: invariants that were '
        'not broken pass, obligations that were not met fail)',
    )
    _add_outputs(parser)
    _add_executors(parser)


def _add_descriptions(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--topics', action='store_true', help='list the topics of the recordings, and end'
    )
    parser.add_argument(
        '--health',
        action='store_true',
        help='measure the topics of the recordings, compare them with the key topics of a '
        'robot.yaml, and end',
    )


def _add_times(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--begin',
        type=duration_option,
        metavar='TIME',
        help="evaluate from this time after the start of the recording on, such as '12 s'",
    )
    parser.add_argument(
        '--every',
        default=Every.FIRST.value,
        metavar='state|FORMULA',
        help='evaluate from every state on, or from every state at which a formula begins to hold '
        '(default: from the first state on)',
    )


def _add_measures(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--margins',
        action='store_true',
        help='also compute how far each formula is from the change of its verdict',
    )
    parser.add_argument(
        '--probability',
        action='store_true',
        help='also compute bounds of the probability of each formula with uncertain features, from '
        'the first state on',
    )


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--strict',
        action='store_true',
        help='end with exit code 2 if there is a note: damage, faults of the recording or of the '
        'configuration',
    )
    parser.add_argument(
        '--json', action='store_true', help='print a line of JSON for each recording'
    )
    add_utc_option(parser)
    for name, written in (
        ('junit', 'a report of JUnit: a test suite for each recording'),
        ('html', 'an interactive page about all recordings'),
        ('png', 'an image of all recordings, for documents'),
        ('geojson', 'regions with their verdicts, and tracks'),
    ):
        parser.add_argument(f'--{name}', type=Path, metavar='FILE', help=f'write {written}')
    parser.add_argument(
        '--verdicts',
        type=Path,
        metavar='FILE.mcap',
        help='write verdicts, diagnostics and markers as messages at their times; with several '
        'recordings, give a folder',
    )


def _add_executors(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        '--jobs',
        type=_number,
        default=1,
        metavar='N',
        help='check N recordings at a time, each in a process of its own (default: 1)',
    )
    where.add_argument(
        '--cluster',
        metavar='ADDRESS',
        help='check the recordings on a Dask cluster, such as tcp://scheduler:8786, whose workers '
        'have this package, and the files under the same paths',
    )


def check(options: argparse.Namespace) -> int:
    """Check formulas over recordings, and print the results; return the exit code."""
    if options.topics or options.health:
        if _draws(options):
            name = '--topics' if options.topics else '--health'
            raise RecordingError(f'{name} draws nothing; leave out --html, --png and --geojson')
        return _describe(options)
    status = ExitStatus(options.undecided, is_strict=options.strict)
    with interruptible() as interruption:
        try:
            outputs = AllOutputs([*_outputs(options), status])
        except DyKnowError as error:
            if options.json:
                print_document(failure_document(None, error))
            raise
        _check(options, outputs, interruption)
    return status.code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command by itself."""
    parser = argparse.ArgumentParser(prog='dyknow check')
    add_check_options(parser)
    return run_main('dyknow check', lambda: check(parser.parse_args(arguments)))


def _outputs(options: argparse.Namespace) -> Iterator[CheckOutput]:
    """Yield the outputs that were asked for."""
    # Few checks need these libraries, so they are imported on demand.
    if options.json:
        yield JsonLines(options.undecided)
    else:
        from dyknow_recordings.reporting.table import Tables  # noqa: PLC0415

        may_retry = not (options.retry or options.probability)
        yield Tables(options.undecided, may_retry=may_retry)
    yield Messages(with_notes=not options.json)
    if options.junit is not None:
        from dyknow_recordings.reporting.junit import JUnitReport  # noqa: PLC0415

        yield JUnitReport(options.junit, options.undecided)
    if _draws(options):
        yield PictureFiles(options.html, options.png, options.undecided, options.geojson)
    if options.verdicts is not None:
        from dyknow_recordings.reporting.verdict_recording import (  # noqa: PLC0415
            VerdictRecordings,
        )

        yield VerdictRecordings(options.verdicts, len(options.recording))


def _draws(options: argparse.Namespace) -> bool:
    return any(each is not None for each in (options.html, options.png, options.geojson))


def _jobs(options: argparse.Namespace) -> tuple[RecordingJob, ...]:
    if not any(getattr(options, name) for name in _CONFIGURATION):
        boxes = {path: box for path in options.recording if (box := read_black_box(path))}
        if len(boxes) == len(set(options.recording)):
            return tuple(_box_job(options, path, boxes[path]) for path in options.recording)
    excluded = {'--every': options.every != Every.FIRST, '--retry': options.retry}
    for option, is_given in excluded.items():
        if options.probability and is_given:
            raise RecordingError(
                f'--probability is about the first state on; leave it out, or leave out {option}'
            )
    robot = given_robot(options)
    files, formulas = read_configuration(options, robot)
    types = message_types(options)
    return tuple(
        RecordingJob(
            str(path),
            path,
            formulas,
            files,
            options.begin,
            options.every,
            keep_signals=_draws(options),
            margins=options.margins,
            probabilities=options.probability,
            retries=options.retry,
            types=types,
            expectations=robot.topics,
            map=robot.map if _draws(options) or options.verdicts is not None else NO_MAP,
        )
        for path in options.recording
    )


def _box_job(options: argparse.Namespace, path: Path, box: BlackBoxContent) -> RecordingJob:
    """Return the check of a black box by itself."""
    if options.begin is not None or options.every != Every.FIRST:
        raise RecordingError(
            f'{path}: the black box says from which states its formula is evaluated; leave out '
            '--begin and --every, or name the formula'
        )
    files = box.files
    return RecordingJob(
        str(path),
        path,
        (box.requested,),
        replace(files, domains={**files.domains, **read_domains(options.domain)}),
        keep_signals=_draws(options),
        margins=options.margins or box.margin,
        retries=options.retry,
        black_box=box,
        types=message_types(options),
    )


def _results(
    jobs: Sequence[RecordingJob], options: argparse.Namespace
) -> AbstractContextManager[Iterator[tuple[int, JobResult]]]:
    """Return the indices and results of jobs, as they come; no job runs after the block."""
    if options.cluster is not None:
        return closing(run_on_cluster(jobs, options.cluster))
    if min(options.jobs, len(jobs)) > 1:
        return run_in_processes(jobs, options.jobs)
    return closing(run_here(jobs))


def _check(options: argparse.Namespace, outputs: CheckOutput, interruption: Interruption) -> None:
    """Add the results to the outputs in the order of the recordings, each as soon as it can be."""
    waiting = dict(enumerate(map(str, options.recording)))
    early: dict[int, JobResult] = {}
    try:
        try:
            jobs = _jobs(options)
            running = _results(jobs, options)
        except DyKnowError as error:
            waiting.clear()
            outputs.add_failure(None, error)
            return
        with running as results, ProgressBar(len(jobs)) as progress:
            for index, result in results:
                progress.advance()
                early[index] = result
                while (first := next(iter(waiting), -1)) in early:
                    with progress.hidden(), interruption.deferred():
                        _add(outputs, waiting.pop(first), early.pop(first))
    finally:
        # After an interruption, later ones may have been finished before the first that was not.
        for index in sorted(early):
            _add(outputs, waiting.pop(index), early.pop(index))
        outputs.close(list(waiting.values()))


def _add(outputs: CheckOutput, recording: str, result: JobResult) -> None:
    if isinstance(result, DyKnowError):
        outputs.add_failure(recording, result)
    else:
        outputs.add(result)


def _describe(options: argparse.Namespace) -> int:
    """Print the topics of each recording, or their health; return the exit code."""
    code = SUCCESS
    expected = given_robot(options).topics if options.health else ()
    for path in options.recording:
        try:
            with open_recording(path, message_types(options)) as recording:
                if options.health:
                    code = max(code, _print_health(recording, expected, options))
                else:
                    code = max(code, _print_topics(recording, options))
        except DyKnowError as error:
            code = ERROR
            if options.json:
                print_document(failure_document(str(path), error))
            sys.stderr.write(f'dyknow check: {error.message}\n')
    return code


def _print_topics(recording: RecordingReader, options: argparse.Namespace) -> int:
    if options.json:
        print_document(topics_document(recording))
    else:
        from dyknow_recordings.reporting.table import print_topics  # noqa: PLC0415

        print_topics(recording)
        print_notes(str(recording.path), recording.faults)
    return ERROR if options.strict and recording.faults else SUCCESS


def _print_health(
    recording: RecordingReader,
    expected: Sequence[TopicExpectation],
    options: argparse.Namespace,
) -> int:
    from dyknow_recordings.reporting.table import health_document, print_health  # noqa: PLC0415

    health = health_of(recording, expected)
    if options.json:
        print_document(health_document(health))
    else:
        print_health(health)
        readable = (with_readable_times(each, health.start) for each in health.notes)
        print_notes(health.recording, readable)
    if options.strict and health.notes:
        return ERROR
    return FALSE if health.broken_expectations else SUCCESS


def _number(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number")
    return int(text)

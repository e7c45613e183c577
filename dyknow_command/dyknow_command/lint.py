"""The verb `lint`: check files by themselves, and against a robot or a recording."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from dyknow_command.linting.findings import (
    Finding,
    FindingLevel,
    error_at,
    in_order,
    robot_error,
    warning_at,
)
from dyknow_command.linting.inputs import YAML_ENDINGS, LintInputs, read_inputs
from dyknow_command.observing import absolute_topic, add_duration_option, observe
from dyknow_common import DyKnowError, ValueType, listed_as, round_duration
from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import FRAME, ObservedTopic, add_quotes
from dyknow_reasoning import notes_on
from dyknow_recordings import add_reading_options, message_types, observe_recording

FINDINGS = 1
"""The exit code if something was found."""


def lint(options: argparse.Namespace) -> int:
    """Check files, print the findings, and return the exit code."""
    for each in options.file if options.fix else ():
        if each.suffix.lower() in YAML_ENDINGS and add_quotes(each):
            sys.stderr.write(f'dyknow lint: {each}: put texts with a colon in quotes\n')
    inputs = read_inputs(options.file)
    topics = _observed(options, inputs) if inputs.is_complete else None
    findings = in_order(
        [
            *inputs.findings,
            *_notes(inputs),
            *_trigger_findings(inputs, is_live=options.live),
            *_guard_findings(inputs),
            *_findings(inputs, topics, _where(options)),
        ]
    )
    for each in findings:
        print(json.dumps(each.document) if options.json else each)  # noqa: T201 - a command
    if not inputs.is_complete:
        sys.stderr.write('dyknow lint: names and topics are checked when these are mended\n')
    elif not findings and not options.json:
        print(_success(options.file, inputs))  # noqa: T201
    return FINDINGS if findings else SUCCESS


def add_lint_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=lint)
    describe(
        parser,
        'Check files: a robot.yaml, or ontologies (.owl, .ttl), annotations (.ssl), streams '
        '(.streams), bridges (.bridges) and formulas (.yaml, or one a line) that belong together. '
        'Shows all errors, names that mean nothing, and what is not used. With --live or '
        '--recording, also the fields, types, publishers and timing of topics.',
        (
            'dyknow lint robot.yaml',
            'dyknow lint robot.yaml --fix',
            'dyknow lint robot.yaml --live --duration 10',
            'dyknow lint robot.yaml --recording flight.mcap',
            'dyknow lint rover.owl rover.ssl rover.streams',
        ),
        '0 if nothing was found, 1 if something was, 2 if a file cannot be checked',
    )
    parser.add_argument('file', nargs='+', type=Path, help='files that are used together')
    parser.add_argument(
        '--fix',
        action='store_true',
        help='first, put the texts of YAML files in quotes that contain a colon and lack them',
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        '--live', action='store_true', help='check the topics of the running robot, too'
    )
    source.add_argument(
        '--recording', type=Path, metavar='FILE', help='check the topics of a recording, too'
    )
    add_duration_option(parser)
    add_reading_options(parser)
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each finding')


def _findings(
    inputs: LintInputs, topics: tuple[ObservedTopic, ...] | None, where: str
) -> Iterator[Finding]:
    if not inputs.is_complete:
        return
    # The libraries for ontologies take a second to load.
    from dyknow_command.linting.frame_checks import frame_findings  # noqa: PLC0415
    from dyknow_command.linting.topic_checks import (  # noqa: PLC0415
        contents_of,
        element_findings,
        name_findings,
        stream_name_findings,
        topic_findings,
    )
    from dyknow_command.linting.vocabulary_checks import VocabularyChecks  # noqa: PLC0415

    observed = {each.name: each for each in topics or ()}
    yield from VocabularyChecks(inputs, contents_of(observed)).findings()
    yield from name_findings(inputs, observed)
    yield from stream_name_findings(inputs)
    yield from element_findings(inputs)
    if topics is not None:
        yield from topic_findings(inputs, observed, where)
        yield from frame_findings(inputs, observed)


def _notes(inputs: LintInputs) -> Iterator[Finding]:
    """Yield what is correct in formulas, but may mean something else than their authors think."""
    guarding = [each for guard in inputs.guards for each in guard.formulas]
    for formula in inputs.formulas:
        text = formula.requested.text
        is_standing = formula.requested.every_state or formula.requested in guarding
        for note in notes_on(text, every_state=is_standing):
            before = text.splitlines(keepends=True)[: note.position.line - 1]
            index = sum(map(len, before)) + note.position.column - 1
            yield warning_at(formula.place(index), note.message)


def _trigger_findings(inputs: LintInputs, *, is_live: bool) -> Iterator[Finding]:
    """Yield the faults of triggers that are known where ROS is: types, their fields, targets."""
    formulas = [each.requested for each in inputs.formulas if each.requested.on]
    for each in inputs.triggers:
        text = "no formula names it, so it never runs; name it under 'on' of one, or remove it"
        yield replace(_finding_of(each.error(text)), level=FindingLevel.WARNING)
    if not formulas and not inputs.triggers:
        return
    try:
        from dyknow_reactions.ros.triggers import (  # noqa: PLC0415
            check_triggers,
            observe_target_faults,
        )
    except ImportError as lack:
        _warn_of_types('triggers', lack)
        return
    errors = check_triggers(formulas, inputs.triggers)
    for error in errors:
        yield _finding_of(error)
    if is_live and formulas and not errors:
        for fault in observe_target_faults(formulas):
            found = _finding_of(fault.error)
            level = FindingLevel.WARNING if fault.is_missing else FindingLevel.ERROR
            yield replace(found, level=level)


def _guard_findings(inputs: LintInputs) -> Iterator[Finding]:
    """Yield the faults of guards; of their types and fields, where ROS is."""
    for guard in inputs.guards:
        for _, stream in guard.other_names_of_input(absolute_topic):
            text = f"a formula names the input as '{stream}'; write '{guard.input}'"
            yield warning_at(inputs.placed(guard.place), f"the guard '{guard.name}': {text}")
    guards = [each for each in inputs.guards if each.message_type]
    if not guards:
        return
    try:
        from dyknow_reactions.ros.guard.passage import message_fault  # noqa: PLC0415
    except ImportError as error:
        _warn_of_types('guards', error)
        return
    for each in guards:
        if fault := message_fault(each):
            yield error_at(inputs.placed(each.place), f"the guard '{each.name}': {fault}")


def _warn_of_types(users: str, error: ImportError) -> None:
    sys.stderr.write(f'dyknow lint: types of {users} are not checked without ROS: {error}\n')


def _finding_of(error: DyKnowError) -> Finding:
    return robot_error(error, str(getattr(error, 'path', '')))


def _success(files: Iterable[Path], inputs: LintInputs) -> str:
    """Return what was checked, without a finding."""
    from dyknow_command.linting.topic_checks import topic_uses  # noqa: PLC0415 - as above

    topics = {each.topic for each in topic_uses(inputs)}
    counts = {'formula': len(inputs.formulas), 'topic': len(topics)}
    checked = [f'{count} {what}{"s" * (count > 1)}' for what, count in counts.items() if count]
    return f'{", ".join(map(str, files))}: {", ".join([*checked, "nothing to mend"])}'


def _observed(options: argparse.Namespace, inputs: LintInputs) -> tuple[ObservedTopic, ...] | None:
    if options.recording is None and not options.live:
        return None
    from dyknow_command.linting.topic_checks import (  # noqa: PLC0415 - as above
        named_fields,
        topic_uses,
    )

    named = named_fields(inputs) | {FRAME}

    def named_in(_: str, fields: Mapping[str, ValueType] | None) -> list[str]:
        return [each for each in named if listed_as(fields or (), each)]

    if options.recording is not None:
        return observe_recording(options.recording, message_types(options), named_in)
    topics = {each.topic for each in topic_uses(inputs)}
    return observe(options.duration, named_in, named=topics)


def _where(options: argparse.Namespace) -> str:
    if options.recording is not None:
        return f'in {options.recording}'
    return f'within {round_duration(options.duration)}'

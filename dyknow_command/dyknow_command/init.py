"""The verb `init`: propose a robot.yaml, or write the files that one is made of."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dyknow_command.observing import add_duration_option, observe
from dyknow_common import DyKnowError, ExitCode, replace_text, round_duration
from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import (
    ObservedTopic,
    export,
    fields_of_interest,
    robot_text,
    write_errors,
    write_new,
)
from dyknow_recordings import add_reading_options, message_types, observe_recording

_MEND = 'choose another name by --output, or replace it by --force'


def init(options: argparse.Namespace) -> int:
    """Propose a robot.yaml, or export the files of one; return the exit code."""
    if options.export is not None:
        return _export(options)
    if options.output.exists() and not options.force:
        # It is said before the topics are observed, which takes some time.
        raise DyKnowError(f'{options.output} exists; {_MEND}', ExitCode.ALREADY_EXISTS)
    topics, origin = _observed(options)
    if not topics:
        raise DyKnowError(
            f'no topic was seen in {origin}; start the robot first, in this ROS domain, or give a '
            'recording',
            ExitCode.UNAVAILABLE,
        )
    names = ' '.join(map(str, options.file))
    name = options.output
    text = robot_text(topics, origin, name, names)
    if options.force:
        with write_errors(name):
            replace_text(name, text)
    else:
        write_new(name, text, _MEND)
    count = f'{len(topics)} topic{"s" * (len(topics) != 1)}'
    print(f'{name}: proposed from {count}; next: dyknow lint {name}')  # noqa: T201
    return SUCCESS


def add_init_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=init)
    describe(
        parser,
        'Write a robot.yaml for a running robot or for recordings: features of the topics whose '
        'types are known, the timing that they keep, and formulas. Or, with --export, write what '
        'is made of a robot.yaml: the ontology in OWL, the annotations in SSL and the streams, and '
        'a YAML file of the same name that names them.',
        (
            'dyknow init',
            'dyknow init --duration 20 --output rover.yaml',
            'dyknow init flight.mcap',
            'dyknow init --export files robot.yaml',
        ),
        '0 if all is written, 2 for an error',
    )
    parser.add_argument(
        'file', nargs='*', type=Path, help='recordings; none to listen to the running robot'
    )
    parser.add_argument(
        '--output',
        type=Path,
        default=Path('robot.yaml'),
        metavar='FILE',
        help='the file to write (default: robot.yaml)',
    )
    parser.add_argument('--force', action='store_true', help='replace the file if it exists')
    add_duration_option(parser)
    add_reading_options(parser)
    parser.add_argument(
        '--export', type=Path, metavar='FOLDER', help='write the files of a robot.yaml to a folder'
    )


def _export(options: argparse.Namespace) -> int:
    if len(options.file) != 1:
        raise DyKnowError('--export needs one robot.yaml')
    (robot,) = options.file
    print(f'{export(robot, options.export)} names the files beside it')  # noqa: T201 - this is a command
    return SUCCESS


def _observed(options: argparse.Namespace) -> tuple[tuple[ObservedTopic, ...], str]:
    """Return the topics and where they were observed."""
    if not options.file:
        sys.stderr.write(f'listening for {round_duration(options.duration)}...\n')
        origin = f'{round_duration(options.duration)} of a running robot'
        return observe(options.duration, fields_of_interest), origin
    types = message_types(options)
    found = (
        each for path in options.file for each in observe_recording(path, types, fields_of_interest)
    )
    return tuple(found), ', '.join(map(str, options.file))

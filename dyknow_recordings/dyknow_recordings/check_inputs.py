"""Inputs of the commands that check recordings: options, and the configuration in them."""

from __future__ import annotations

import argparse
from pathlib import Path

from dyknow_common import SECOND_NS
from dyknow_configuration import (
    RequestedFormula,
    RobotConfiguration,
    read_formulas,
    read_robot,
    warn_of_notes,
)
from dyknow_coordinator import SILENCE_LIMIT_NS, SILENCE_LIMITS_S
from dyknow_reasoning import add_domain_option, read_domains
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles
from dyknow_recordings.reading.opening import ENDINGS, ENDINGS_TEXT, add_reading_options


def add_input_options(parser: argparse.ArgumentParser, *, several: bool = True) -> None:
    """Add the options of recordings and formulas, and related options.

    Args:
        parser: the parser of a command.
        several: True if there may be several recordings.
    """
    parser.add_argument(
        'recording',
        nargs='+' if several else None,
        type=Path,
        help=f'a rosbag2 folder, or a {ENDINGS_TEXT} file',
    )
    parser.add_argument(
        '--config', type=Path, metavar='FILE', help='robot.yaml, which describes the robot'
    )
    for name, description in (
        ('ontology', 'OWL files'),
        ('annotations', 'files in SSL'),
        ('streams', 'files in the stream language'),
        ('bridges', 'files of bridge rules between the ontologies'),
        ('formulas', 'files with formulas: YAML, or one a line'),
    ):
        parser.add_argument(
            f'--{name}',
            nargs='+',
            action='extend',
            type=_file,
            default=[],
            metavar='FILE',
            help=description,
        )
    parser.add_argument(
        '--formula', action='append', default=[], metavar='TEXT', help='a formula; repeatable'
    )
    add_domain_option(parser)
    _add_missing_option(parser)
    add_reading_options(parser)


def _add_missing_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--missing',
        choices=('error', 'unknown'),
        default='error',
        help='what NaN, an empty cell or an absent field is: an error, or an unknown value, on '
        'which no verdict depends (default: error)',
    )


def given_robot(options: argparse.Namespace) -> RobotConfiguration:
    """Return the description of the robot, which is empty without --config.

    Raises:
        ConfigurationError: for a file that cannot be read.
    """
    return RobotConfiguration() if options.config is None else read_robot(options.config)


def read_configuration(
    options: argparse.Namespace, robot: RobotConfiguration
) -> tuple[MonitoringFiles, tuple[RequestedFormula, ...]]:
    """Return the configuration of a check, given the description of the robot.

    Raises:
        DyKnowError: for a file that cannot be read, or if there is nothing to check.
    """
    files = MonitoringFiles(
        ontologies=(*robot.ontologies, *options.ontology),
        annotations=(*robot.annotations, *options.annotations),
        streams=(*robot.streams, *options.streams),
        bridges=(*robot.bridges, *options.bridges),
        domains={**robot.domains, **read_domains(options.domain)},
        missing_is_unknown=options.missing == 'unknown',
        silence_limit=_silence_limit(robot),
    )
    read = (formula for path in options.formulas for formula in read_formulas(path))
    formulas = (*robot.formulas, *read, *map(RequestedFormula, options.formula))
    if not (formulas or robot.topics):
        if options.config is not None:
            raise RecordingError(f'{options.config} has no formulas; add one, or give --formula')
        raise RecordingError('there is no formula to check; give --formula, --formulas or --config')
    warn_of_notes(each.text for each in formulas)
    return files, formulas


def _silence_limit(robot: RobotConfiguration) -> int:
    """Return the limit that the coordinator would have, in nanoseconds."""
    node, name = 'stream_reasoning_coordinator', 'silence_limit'
    limit = robot.parameters.get(node, {}).get(name, SILENCE_LIMIT_NS / SECOND_NS)
    lowest, highest = SILENCE_LIMITS_S
    if isinstance(limit, bool | str | list) or not lowest <= limit <= highest:
        text = f'{limit!r} is no number of seconds from {lowest:g} to {highest:.0f}'
        raise RecordingError(f'nodes: {node}: {name}: {text}')
    return round(limit * SECOND_NS)


def _file(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() in ENDINGS or path.is_dir():
        raise argparse.ArgumentTypeError(
            f"'{text}' is a recording; give recordings before the options, or after --"
        )
    return path

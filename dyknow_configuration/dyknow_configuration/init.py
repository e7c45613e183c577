"""The verb `init`: writes the files of a robot."""

from __future__ import annotations

import argparse
from pathlib import Path

from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration.reading import read_robot
from dyknow_configuration.writing import export


def init(options: argparse.Namespace) -> int:
    """Write the ontology, the annotations and the streams of a robot.yaml; return the exit code."""
    path = export(read_robot(options.robot), options.export, options.robot.stem)
    print(f'{path} names the files beside it')  # noqa: T201 - this is a command
    return SUCCESS


def add_init_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=init)
    describe(
        parser,
        'Write what is made of a robot.yaml: the ontology in OWL, the annotations in SSL and the '
        'streams, and a YAML file of the same name that names them. Nothing has to run.',
        ('dyknow init --export files robot.yaml',),
        '0 if all is written, 2 for an error',
    )
    parser.add_argument('robot', type=Path, help='the robot.yaml')
    parser.add_argument(
        '--export', type=Path, required=True, metavar='FOLDER', help='the folder of the files'
    )

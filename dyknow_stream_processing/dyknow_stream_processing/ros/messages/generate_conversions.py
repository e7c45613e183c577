"""The command that writes conversions between messages and samples (paper, section VI)."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.messages.conversion_code import module_text
from dyknow_stream_processing.ros.messages.message_types import message_class

_COMMAND = 'generate_conversions'

_DESCRIPTION = """\
Writes a Python module with two functions for each message type, such as odometry_to_fields and
odometry_from_fields for nav_msgs/msg/Odometry: from a message to the fields of a sample, and back.

Fields are the single values in a message, by path: pose.pose.position.z, of arrays by index,
pose.covariance[35], points[2].x. Without --fields there is a field for each, and for each element
that an array has. Fields that are not given keep their defaults on the way back, and arrays grow to
the highest index that is given."""

_EXAMPLES = """\
examples:
  generate_conversions nav_msgs/msg/Odometry sensor_msgs/msg/BatteryState --output conversions.py
  generate_conversions sensor_msgs/msg/LaserScan --fields 'ranges[0]' 'ranges[359]' header.frame_id

exit codes: 0 written, 2 a type or a field that there is not, or a file that cannot be written"""


def main() -> None:
    """Writes the module; exits with 2 if that cannot be done."""
    try:
        _generate(sys.argv[1:])
    except (StreamError, OSError) as error:
        print(f'{_COMMAND}: {error}', file=sys.stderr)  # noqa: T201
        sys.exit(2)


def _generate(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(
        prog=_COMMAND,
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('types', nargs='+', metavar='TYPE', help='package/msg/Type')
    parser.add_argument(
        '--fields', nargs='+', metavar='PATH', help='convert these fields only, of a single type'
    )
    parser.add_argument(
        '--output', type=Path, metavar='FILE', help='is written; else the standard output'
    )
    given = parser.parse_args(arguments)
    types = sorted(set(given.types))
    _check(types, given.fields)
    fields = None if given.fields is None else sorted(set(given.fields))
    command = shlex.join([_COMMAND, *types, *(['--fields', *fields] if fields else [])])
    text = module_text(map(message_class, types), fields, command)
    if given.output is None:
        sys.stdout.write(text)
    else:
        given.output.write_text(text, encoding='utf-8')


def _check(types: Sequence[str], fields: Sequence[str] | None) -> None:
    if fields is not None and len(types) > 1:
        raise StreamError('--fields is for a single message type; write a module for each')
    names = [each.rpartition('/')[2] for each in types]
    for name in names:
        if names.count(name) > 1:
            raise StreamError(f"several message types are called '{name}'; write a module for each")


if __name__ == '__main__':
    main()

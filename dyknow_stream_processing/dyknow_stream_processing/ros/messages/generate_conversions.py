"""The command that writes conversions between messages and samples (paper, section VI)."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections import Counter
from pathlib import Path

from dyknow_common.executables import SUCCESS, run_main
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.ros.messages.conversions import module_text
from dyknow_stream_processing.ros.messages.message_types import message_class

_COMMAND = 'generate_conversions'

_DESCRIPTION = """\
Writes a Python module with two functions for each message type, such as odometry_to_fields and
odometry_from_fields for nav_msgs/msg/Odometry: from a message to the fields of a sample, and back.

Fields are the single values in a message, named by their paths: pose.pose.position.z, and with an
index in an array pose.covariance[35], points[2].x. Without --fields there is a field for each value
and each element of an array. Fields that are not given keep their defaults on the way back, and
arrays grow to the highest index that is given."""

_EXAMPLES = """\
examples:
  generate_conversions nav_msgs/msg/Odometry sensor_msgs/msg/BatteryState --output conversions.py
  generate_conversions sensor_msgs/msg/LaserScan --fields 'ranges[0]' 'ranges[359]' header.frame_id

exit codes: 0 written, 2 unknown type or field, or the file cannot be written"""


def main() -> int:
    """Write the module and return the exit code."""
    return run_main(_COMMAND, _generate)


def _generate() -> int:
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
        '--output',
        type=Path,
        metavar='FILE',
        help='file to write; default: standard output',
    )
    given = parser.parse_args(sys.argv[1:])
    types = sorted(set(given.types))
    fields = None if given.fields is None else sorted(set(given.fields))
    if fields is not None and len(types) > 1:
        raise StreamError('--fields is for a single message type; write a module for each')
    for name, count in Counter(each.rpartition('/')[2] for each in types).items():
        if count > 1:
            raise StreamError(f"several message types are called '{name}'; write a module for each")
    command = shlex.join([_COMMAND, *types, *(['--fields', *fields] if fields else [])])
    text = module_text(map(message_class, types), fields, command)
    if given.output is None:
        sys.stdout.write(text)
    else:
        given.output.write_text(text, encoding='utf-8')
    return SUCCESS

"""Names of topics in requests and parameters."""

from __future__ import annotations

from typing import Final

from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_topic_name import validate_topic_name

from dyknow_common.errors import DyKnowError, shortened
from dyknow_common.limits import MAX_TOPIC_LENGTH

RCLError: Final = rclpy_implementation.RCLError
"""An error of the middleware: also what its security plugins do not permit."""

_TOO_LONG: Final = 'topic length'
"""The beginning of the errors of ROS about a name that is too long."""


def absolute_topic(node: Node, name: str, role: str, suffix: str = '') -> str:
    """Return the absolute name of a topic.

    Args:
        node: in whose namespace a relative name is.
        name: as it was written.
        role: what it names, for the message of the error.
        suffix: the suffix of the longest name of a topic that belongs to it.

    Raises:
        DyKnowError: INVALID_ARGUMENT, if ROS cannot have such a topic.
    """
    if fault := topic_fault(node, name, suffix):
        raise DyKnowError(f"{role} '{shortened(name)}' cannot be the name of a topic: {fault}")
    return str(node.resolve_topic_name(name))


def topic_fault(node: Node, name: str, suffix: str = '') -> str:
    """Return why ROS cannot have a topic of a name; empty if it can."""
    try:
        validate_topic_name(name)
        absolute = node.resolve_topic_name(name)
        validate_full_topic_name(absolute)
    except InvalidTopicNameException as error:
        fault = str(error).removeprefix('Invalid topic name: ').partition(':\n')[0]
    except (ValueError, RCLError) as error:
        fault = str(error).removeprefix('failed to resolve name: ').partition(', at ')[0]
    else:
        fault = '' if len(absolute) + len(suffix) <= MAX_TOPIC_LENGTH else _TOO_LONG
    if not fault.startswith(_TOO_LONG):
        return fault
    whole = f'its absolute name with {suffix}' if suffix else 'its absolute name'
    return f'{whole} has more than {MAX_TOPIC_LENGTH} characters, the limit of DDS'

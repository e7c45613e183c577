"""Messages that are filled from a report: checked at the start, written at each event."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from dyknow_common import ExitCode, ValueType
from dyknow_common.ros import nanoseconds_to_time
from dyknow_configuration import PLACEHOLDERS, Trigger, filled, single_placeholder
from dyknow_reactions.triggers import TriggerReport
from dyknow_stream_processing import StreamError
from dyknow_stream_processing.ros import FieldError, MessageWriter, interface_class

_TIME: Final = 'builtin_interfaces/msg/Time'
_CONTENT: Final = 'content'


def template_of(trigger: Trigger) -> tuple[Any, MessageTemplate]:
    """Return the class that a trigger names, and the message that it sends.

    Raises:
        ConfigurationError: NOT_FOUND, if the type is not installed, with its place in the file;
            as `MessageTemplate`.
    """
    try:
        class_ = interface_class(trigger.type_name)
    except StreamError as error:
        found = trigger.error(error.message, ('type',))
        found.code = error.code
        raise found from None
    part = {'srv': 'Request', 'action': 'Goal'}.get(trigger.type_name.split('/')[1])
    return class_, MessageTemplate(trigger, getattr(class_, part) if part else class_)


class MessageTemplate:
    """A message whose fields have placeholders.

    Args:
        trigger: has the values of the fields.
        class_: the class of the message.

    Raises:
        ConfigurationError: for a field that the message does not have, or a value that it cannot
            have, with the place in the file.
    """

    def __init__(self, trigger: Trigger, class_: Any) -> None:
        self._trigger = trigger
        self._writer = MessageWriter(class_)
        self.fill()

    def fill(self, report: TriggerReport | None = None) -> Any:
        """Return the message for a report; without one, with examples for the placeholders.

        Raises:
            ConfigurationError: if a value does not fit, such as a text that is too long.
        """
        content: Any = self._trigger.content
        try:
            return self._writer.tree(content, partial(_replaced, report))
        except FieldError as error:
            # The name of an unknown field is at fault, not its value.
            end = (None,) if error.code is ExitCode.NOT_FOUND else ()
            path = (_CONTENT, *error.path, *end)
            raise self._trigger.error(error.message, path) from None


def _replaced(report: TriggerReport | None, type_name: str, value: Any) -> Any:
    """Return a value with a report in the place of its placeholders; without one, an example."""
    if not isinstance(value, str):
        return value
    if 'string' in type_name:
        return filled(value, report.texts if report else dict.fromkeys(PLACEHOLDERS, ''))
    name = single_placeholder(value)
    if name == 'time' and type_name == _TIME:
        time = nanoseconds_to_time(report.time if report else 0)
        return {'sec': time.sec, 'nanosec': time.nanosec}
    if name is None or PLACEHOLDERS[name] is ValueType.STRING:
        return value
    example = 0.0 if PLACEHOLDERS[name] is ValueType.FLOAT else 0
    return report.numbers[name] if report else example

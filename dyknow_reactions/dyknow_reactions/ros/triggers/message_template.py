"""Messages that are filled from a report: checked at the start, written at each event."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, Final

from rclpy.type_support import check_for_type_support
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    AbstractType,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

from dyknow_common import ExitCode, Value, ValueType, absence
from dyknow_common.ros import nanoseconds_to_time
from dyknow_configuration import (
    PLACEHOLDERS,
    Trigger,
    TriggerKind,
    filled,
    single_placeholder,
)
from dyknow_reactions.triggers import TriggerReport

_FLOATS: Final = ('float', 'double', 'long double')
_CHARACTERS: Final = ('char', 'wchar')
_BYTES: Final = ('octet',)
_TIME: Final = ('builtin_interfaces', 'msg', 'Time')
_CONTENT: Final = 'content'


def interface_class(trigger: Trigger) -> Any:
    """Return the class of the message, service or action that a trigger names.

    Raises:
        ConfigurationError: NOT_FOUND, if it is not installed; with its place in the file.
    """
    package, folder, name = trigger.type_name.split('/')
    try:
        class_ = getattr(import_module(f'{package}.{folder}'), name)
        if folder == 'msg':
            check_for_type_support(class_)
    except (ImportError, AttributeError) as error:
        is_there = isinstance(error, AttributeError)
        mend = f'install the package {package}, or source its workspace'
        mend = f'{package} has no such type' if is_there else mend
        text = f"the type '{trigger.type_name}' is not installed: {mend}"
        found = trigger.error(text, ('type',))
        found.code = ExitCode.NOT_FOUND
        raise found from None
    return class_


def template_of(trigger: Trigger) -> tuple[Any, MessageTemplate]:
    """Return the class that a trigger names, and the message that it sends.

    Raises:
        ConfigurationError: as for both.
    """
    class_ = interface_class(trigger)
    part = {TriggerKind.CALL: 'Request', TriggerKind.SEND_GOAL: 'Goal'}.get(trigger.kind)
    return class_, MessageTemplate(trigger, getattr(class_, part) if part else class_)


class MessageTemplate:
    """A message whose fields have placeholders.

    Args:
        trigger: has the values of the fields.
        class_: of the message.

    Raises:
        ConfigurationError: for a field that the message does not have, or a value that it cannot
            have, with the place in the file.
    """

    def __init__(self, trigger: Trigger, class_: Any) -> None:
        self._trigger = trigger
        self._class = class_
        self._report: TriggerReport | None = None
        self._message(class_, trigger.content, (_CONTENT,))

    def fill(self, report: TriggerReport) -> Any:
        """Return the message for a report.

        Raises:
            ConfigurationError: if a value does not fit, such as a text that is too long.
        """
        self._report = report
        return self._message(self._class, self._trigger.content, (_CONTENT,))

    def _message(self, class_: Any, content: Any, path: tuple[Any, ...]) -> Any:
        """Return a message; before the first report, with examples for the placeholders."""
        if not isinstance(content, Mapping):
            raise self._trigger.error(f'{_name(class_)} is a mapping from fields to values', path)
        types = dict(zip(class_.get_fields_and_field_types(), class_.SLOT_TYPES, strict=True))
        message = class_(check_fields=True)
        for name, value in content.items():
            if name not in types:
                lack = absence(_name(class_), types, name)
                raise self._trigger.error(lack, (*path, name, None))
            found = self._value(types[name], value, (*path, name))
            try:
                setattr(message, name, found)
            except (AssertionError, TypeError, ValueError, OverflowError) as error:
                raise self._misfit(name, str(error) or 'it does not fit', (*path, name)) from None
        return message

    def _value(self, kind: AbstractType, value: Any, path: tuple[Any, ...]) -> Any:
        if isinstance(kind, AbstractNestedType):
            return self._elements(kind, value, path)
        if isinstance(kind, NamespacedType):
            if tuple(kind.namespaced_name()) == _TIME and value == '{time}':
                return nanoseconds_to_time(self._report.time if self._report else 0)
            package, folder, name = kind.namespaced_name()
            return self._message(getattr(import_module(f'{package}.{folder}'), name), value, path)
        if isinstance(kind, AbstractString | AbstractWString):
            return self._text(value, path)
        assert isinstance(kind, BasicType)  # noqa: S101 - there is no other type
        return self._number(kind.typename, value, path)

    def _elements(self, kind: Any, value: Any, path: tuple[Any, ...]) -> Any:
        if not isinstance(value, list):
            raise self._misfit(path[-1], 'it is a list', path)
        size = kind.size if isinstance(kind, Array) else None
        most = kind.maximum_size if isinstance(kind, BoundedSequence) else size
        if (size is not None and len(value) != size) or (most is not None and len(value) > most):
            wanted = f'{size} elements' if size is not None else f'at most {most} elements'
            raise self._misfit(path[-1], f'it has {wanted}, not {len(value)}', path)
        return [self._value(kind.value_type, each, (*path, n)) for n, each in enumerate(value)]

    def _text(self, value: Any, path: tuple[Any, ...]) -> str:
        if not isinstance(value, str):
            raise self._misfit(path[-1], f"it is a text; quote '{value}'", path)
        if self._report is None:
            return filled(value, dict.fromkeys(PLACEHOLDERS, ''))
        return filled(value, self._report.texts)

    def _number(self, kind: str, value: Any, path: tuple[Any, ...]) -> Any:
        name = single_placeholder(value) if isinstance(value, str) else None
        if name is not None:
            value = self._placeholder(name, path)
        if kind in _CHARACTERS and isinstance(value, str) and len(value) == 1:
            return value
        wanted = ValueType.FLOAT if kind in _FLOATS else ValueType.INT
        wanted = ValueType.BOOLEAN if kind == 'boolean' else wanted
        if isinstance(value, str) or not wanted.accepts(ValueType.of(value)):
            shown = f'{{{name}}}' if name else value
            raise self._misfit(path[-1], f"it is of the type {wanted}, unlike '{shown}'", path)
        if kind in _BYTES:
            if not 0 <= value <= 255:  # noqa: PLR2004
                raise self._misfit(path[-1], f'it is a byte, unlike {value}', path)
            return bytes([value])
        return float(value) if wanted is ValueType.FLOAT else value

    def _placeholder(self, name: str, path: tuple[Any, ...]) -> Value:
        if PLACEHOLDERS[name] is ValueType.STRING:
            raise self._misfit(path[-1], f"it is a number, and '{{{name}}}' a text", path)
        if self._report is None:
            return 0.0 if PLACEHOLDERS[name] is ValueType.FLOAT else 0
        return self._report.numbers[name]

    def _misfit(self, field: Any, reason: str, path: tuple[Any, ...]) -> Exception:
        what = f'element {field}' if isinstance(field, int) else f"field '{field}'"
        return self._trigger.error(f'{what}: {reason}', path)


def _name(class_: Any) -> str:
    return f'{class_.__module__.replace(".", "/").rpartition("/_")[0]}/{class_.__name__}'

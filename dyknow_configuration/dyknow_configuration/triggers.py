"""Triggers: an action with its limits, and the events of a formula that it follows.

They are the key `triggers` of a robot.yaml, and `on` of its formulas:

    triggers:
      report: {publish: {topic: /faults, type: std_msgs/msg/String, message: {data: '{name}'}}}
    formulas:
      - name: slow
        formula: always a.b < 1
        on: {false: [report, {run: [beep, '3']}], clear: report}

A text may have placeholders for the values of a result:

    'formula {name} is {verdict}'    the parts 'formula ', {name}, ' is ', {verdict}
    'a brace is written {{'          a brace
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from dyknow_common import (
    SECOND_NS,
    TextPosition,
    Value,
    ValueType,
    round_duration,
    unknown,
)
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.yaml_values import YamlDocument, YamlValue

DEFAULT_TIMEOUT: Final = 5 * SECOND_NS
"""The time limit of an attempt, in nanoseconds."""

MAX_TIMEOUT: Final = 600 * SECOND_NS
"""The longest one."""

MAX_RETRIES: Final = 10
"""The greatest number of attempts after the first one."""


class TriggerEvent(StrEnum):
    """A change of the verdict on a formula."""

    FALSE = 'false'
    TRUE = 'true'
    VIOLATION = 'violation'
    CLEAR = 'clear'


class TriggerKind(StrEnum):
    """The kind of an action."""

    PUBLISH = 'publish'
    CALL = 'call'
    SEND_GOAL = 'send_goal'
    CANCEL_GOAL = 'cancel_goal'
    RUN = 'run'


Path = tuple[str | int | None, ...]
"""Leads from a trigger to a value in it: ('content', 'values', 0, 'key').

None at its end stands for the name of the field instead of its value.
"""


@dataclass(frozen=True, slots=True)
class TriggerPlaces:
    """The places of a trigger and its values in a file.

    Args:
        document: the file.
        positions: the positions of the values.
    """

    document: YamlDocument
    positions: Mapping[Path, TextPosition]

    def error(self, message: str, path: Path = ()) -> ConfigurationError:
        """Return an error at a value of the trigger, or at the value that should contain it."""
        while path not in self.positions:
            path = path[:-1]
        return self.document.error(message, self.positions[path])

    def __str__(self) -> str:
        return f'{self.document.path}:{self.positions[()]}'


@dataclass(frozen=True, slots=True)
class Trigger:
    """An action with its limits.

    Args:
        name: the name for people: from its file, or else what it does.
        kind: the kind of the action.
        target: the topic, the service, the action, or the command that is run.
        type_name: the type name of the message, the service or the action; empty if none is needed.
        content: the fields of the message, the request or the goal, or the arguments of the
            command; texts may have placeholders.
        min_interval: after an event, further ones are ignored for this time, in nanoseconds.
        retries: the number of attempts after a failed one.
        timeout: the time limit of each attempt, in nanoseconds.
        placeholders: the placeholders in the content.
        places: where the trigger is written.
    """

    name: str
    kind: TriggerKind
    target: str
    type_name: str = ''
    content: Mapping[str, Any] | Sequence[str] = field(default_factory=dict, hash=False)
    min_interval: int = 0
    retries: int = 0
    timeout: int = DEFAULT_TIMEOUT
    placeholders: frozenset[str] = frozenset()
    places: TriggerPlaces | None = field(default=None, compare=False, repr=False)

    def error(self, message: str, path: Path = ()) -> ConfigurationError:
        """Return an error about this trigger, or a value in it, at its place."""
        text = f"trigger '{self.name}': {message}"
        return ConfigurationError(text) if self.places is None else self.places.error(text, path)


FormulaTriggers = tuple[tuple[TriggerEvent, Trigger], ...]
"""The triggers of a formula with their events, in their order."""


Triggers = Mapping[str, Trigger]
"""Triggers by their names."""

NO_TRIGGERS: Final[Triggers] = {}

LIMIT_KEYS: Final = ('min_interval', 'retries', 'timeout')
TRIGGER_KEYS: Final = (*TriggerKind, *LIMIT_KEYS)
ACTION_KEYS: Final[Mapping[TriggerKind, tuple[str, ...]]] = {
    TriggerKind.PUBLISH: ('topic', 'type', 'message'),
    TriggerKind.CALL: ('service', 'type', 'request'),
    TriggerKind.SEND_GOAL: ('action', 'type', 'goal'),
    TriggerKind.CANCEL_GOAL: ('action',),
}
"""The keys of each kind with a target in the running system: the target, the type, the content.

A target without a type may be written without its key. Kinds that are not here run a command.
"""

MAX_TRIGGERS: Final = 20
"""The number of triggers of one event."""

MAX_VALUES: Final = 1000
"""The number of values in a message, a request or a goal, and of arguments of a command."""

MAX_DEPTH: Final = 20
"""The levels to which these values nest."""

_INTERFACES: Final = {'topic': 'msg', 'service': 'srv', 'action': 'action'}
"""The folders of the types of targets."""

_TARGET: Final = re.compile(r'(~?/)?[A-Za-z_{][A-Za-z0-9_{}]*(/[A-Za-z_{][A-Za-z0-9_{}]*)*')
"""The names that targets may have; nodes know what ~ and {node} stand for."""

_NAME: Final = r'[A-Za-z][A-Za-z0-9_]*'

PLACEHOLDERS: Final[Mapping[str, ValueType]] = {
    'name': ValueType.STRING,
    'formula': ValueType.STRING,
    'event': ValueType.STRING,
    'explanation': ValueType.STRING,
    'verdict': ValueType.INT,
    'severity': ValueType.INT,
    'time': ValueType.FLOAT,
    'margin': ValueType.FLOAT,
}
"""The placeholders, with the types of their values in fields of numbers."""

_PART: Final = re.compile(r'\{\{|\}\}|\{([^{}]*)\}|[{}]')


def read_triggers(value: YamlValue) -> dict[str, Trigger]:
    """Return the named triggers of a file.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    entries = value.entries('a mapping from names to triggers')
    return {key.text().strip(): _trigger(each, key.text().strip()) for key, each in entries}


def read_events(value: YamlValue, named: Triggers) -> FormulaTriggers:
    """Return the triggers that `on` of a formula names or contains.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found: list[tuple[TriggerEvent, Trigger]] = []
    for event, each in value.mapping([*TriggerEvent]).items():
        wanted = each.one_or_more()
        if len(wanted) > MAX_TRIGGERS:
            raise wanted[MAX_TRIGGERS].error(f'an event has at most {MAX_TRIGGERS} triggers')
        found += [(TriggerEvent(event), _named_or_own(one, named)) for one in wanted]
    return tuple(found)


def _named_or_own(value: YamlValue, named: Triggers) -> Trigger:
    if value.is_mapping:
        return _trigger(value)
    name = value.text('the name of a trigger, or a mapping such as {run: [beep]},').strip()
    if name not in named:
        hint = '' if named else " (add it under the key 'triggers' of the file)"
        raise value.error(unknown('trigger', name, named) + hint)
    return named[name]


def _trigger(value: YamlValue, name: str = '') -> Trigger:
    stated = value.mapping(TRIGGER_KEYS)
    kinds = [kind for kind in TriggerKind if kind in stated]
    if len(kinds) != 1:
        one = f'add one of the keys {", ".join(TriggerKind)}'
        raise value.error(f"keep one of '{kinds[0]}' and '{kinds[1]}'" if kinds else one)
    (kind,) = kinds
    content = _Content(value)
    target, type_name = _action(kind, stated[kind], content)
    return Trigger(
        name or f'{kind} {target}',
        kind,
        target,
        type_name,
        content.content,
        _limit(stated, 'min_interval', 0),
        _retries(stated),
        _limit(stated, 'timeout', DEFAULT_TIMEOUT),
        content.placeholders,
        TriggerPlaces(value.document, content.positions),
    )


class _Content:
    """The message of an action, with the places of its values."""

    def __init__(self, value: YamlValue) -> None:
        self.content: Any = {}
        self.placeholders: frozenset[str] = frozenset()
        self.positions: dict[Path, TextPosition] = {(): value.position(0)}
        self._count = 0

    def place(self, path: Path, value: YamlValue) -> None:
        self.positions[path] = value.position(0)
        self._count += 1
        if self._count > MAX_VALUES:
            raise value.error(f'a trigger has at most {MAX_VALUES} values; remove some')
        if len(path) > MAX_DEPTH:
            raise value.error(f'values of a trigger nest at most {MAX_DEPTH} levels')

    def read(self, value: YamlValue, path: Path) -> Any:
        """Return a value, whose texts may have placeholders."""
        self.place(path, value)
        if value.is_mapping:
            entries = value.entries('a mapping from fields to values')
            for key, _ in entries:
                self.positions[*path, key.word(), None] = key.position(0)
            return {key.word(): self.read(each, (*path, key.word())) for key, each in entries}
        if value.is_list:
            return [self.read(each, (*path, n)) for n, each in enumerate(value.items())]
        if value.is_text and value.node.value.strip():
            self.placeholders |= check_placeholders(value)
        found = value.plain()
        if not isinstance(found, bool | int | float | str):
            raise value.expected('a number, a boolean, a text, a list or a mapping')
        return found


def _action(kind: TriggerKind, value: YamlValue, content: _Content) -> tuple[str, str]:
    """Return the target and the type of an action, and read its content."""
    content.place((kind,), value)
    if kind not in ACTION_KEYS:
        words = value.items('a command and its arguments, such as [beep, -f, "440"],')
        if not words:
            raise value.expected('a command and its arguments, such as [beep, -f, "440"],')
        texts = list(_words(words, content))
        content.content = texts[1:]
        return texts[0], ''
    target, *rest = ACTION_KEYS[kind]
    if not rest and value.is_text:
        content.place((target,), value)
        return _target(value, target), ''
    stated = value.mapping(ACTION_KEYS[kind], (target, *rest[:1]))
    for key, each in stated.items():
        content.place((key,), each)
    if rest and rest[1] in stated:
        content.content = content.read(stated[rest[1]], ('content',))
        if not isinstance(content.content, dict):
            raise stated[rest[1]].expected('a mapping from fields to values')
    type_name = _type_name(stated['type'], kind) if rest else ''
    return _target(stated[target], target), type_name


def _target(value: YamlValue, kind: str) -> str:
    return value.matched(_TARGET, f'the name of {"an" if kind == "action" else "a"} {kind}')


def _words(values: list[YamlValue], content: _Content) -> Iterator[str]:
    for number, each in enumerate(values):
        if not each.is_text:
            raise each.expected('a text', '; quotes make it a text')
        content.place(('run', number), each)
        used = check_placeholders(each)
        if used and not number:
            raise each.error('a command has no placeholders; only its arguments have')
        content.placeholders |= used
        yield each.text()


def _type_name(value: YamlValue, kind: TriggerKind) -> str:
    text, folder = value.text('the name of a type').strip(), _INTERFACES[ACTION_KEYS[kind][0]]
    if not re.fullmatch(f'{_NAME}/{folder}/{_NAME}', text):
        raise value.error(f"'{text}' is no type for {kind}; write it as package/{folder}/Type")
    return text


def _limit(stated: Mapping[str, YamlValue], key: str, default: int) -> int:
    """Return a time in nanoseconds."""
    if key not in stated:
        return default
    found = stated[key].non_negative_duration()
    if key == 'timeout' and not 0 < found <= MAX_TIMEOUT:
        allowed = f'above 0 and at most {round_duration(MAX_TIMEOUT)}'
        raise stated[key].error(f'a timeout must be {allowed}')
    return found


def _retries(stated: Mapping[str, YamlValue]) -> int:
    if 'retries' not in stated:
        return 0
    found = stated['retries'].plain()
    if type(found) is not int or not 0 <= found <= MAX_RETRIES:
        raise stated['retries'].expected(f'a number from 0 to {MAX_RETRIES}')
    return found


def check_placeholders(value: YamlValue) -> frozenset[str]:
    """Return the placeholders in a text.

    Raises:
        ConfigurationError: at an unknown placeholder, or a single brace.
    """
    text, used = value.text(), set[str]()
    for found in _PART.finditer(text):
        name = found[1]
        if name is not None and name not in PLACEHOLDERS:
            raise value.error(unknown('placeholder', name, PLACEHOLDERS), found.start())
        if found[0] in {'{', '}'}:
            raise value.error(f"write {found[0] * 2} for the character '{found[0]}'", found.start())
        used |= {name} if name is not None else set()
    return frozenset(used)


def single_placeholder(text: str) -> str | None:
    """Return the name of the placeholder that a text consists of; None if it is another text."""
    found = _PART.fullmatch(text.strip())
    return found[1] if found else None


def filled(text: str, values: Mapping[str, Value]) -> str:
    """Return a text with values in the place of its placeholders."""
    return _PART.sub(lambda found: found[0][0] if found[1] is None else str(values[found[1]]), text)

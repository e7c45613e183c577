"""Triggers: an action with its limits, and the events that it follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from dyknow_common import SECOND_NS, TextPosition
from dyknow_configuration.documents.yaml_values import YamlDocument
from dyknow_configuration.errors import ConfigurationError

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
        positions: of the values.
    """

    document: YamlDocument
    positions: Mapping[Path, TextPosition]

    def error(self, message: str, path: Path = ()) -> ConfigurationError:
        """Return an error at a value of the trigger, or at the one that it would be in."""
        while path not in self.positions:
            path = path[:-1]
        return self.document.error(message, self.positions[path])

    def __str__(self) -> str:
        return f'{self.document.path}:{self.positions[()]}'


@dataclass(frozen=True, slots=True)
class Trigger:
    """An action with its limits.

    Args:
        name: for people.
        kind: of the action.
        target: the topic, the service, the action, or the command that is run.
        type_name: of the message, the service or the action; empty if none is needed.
        content: the fields of the message, the request or the goal, or the arguments of the
            command; texts may have placeholders.
        min_interval: after an event, further ones are ignored for this time, in nanoseconds.
        retries: the number of attempts after a failed one.
        timeout: the time limit of each attempt, in nanoseconds.
        placeholders: those in the content.
        places: where it is written.
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

    @property
    def is_named(self) -> bool:
        """True if a file names it, so several formulas may refer to it."""
        return self.name != default_name(self.kind, self.target)

    def error(self, message: str, path: Path = ()) -> ConfigurationError:
        """Return an error about this trigger, or a value in it, at its place."""
        text = f"trigger '{self.name}': {message}"
        return ConfigurationError(text) if self.places is None else self.places.error(text, path)


def default_name(kind: TriggerKind, target: str) -> str:
    """Return the name of a trigger that has none in its file: what it does."""
    return f'{kind} {target}'


FormulaTriggers = tuple[tuple[TriggerEvent, Trigger], ...]
"""The triggers of a formula with their events, in their order."""

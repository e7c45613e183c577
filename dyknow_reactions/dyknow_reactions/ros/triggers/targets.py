"""Targets of triggers in the running system: do topics, services and actions have their types?

Other nodes are discovered one after the other, so a fault counts if it lasts for DISCOVERY_S:

    0.0 s  the trigger calls /alarm as std_srvs/srv/SetBool; no node is known to offer it
    0.1 s  a node is discovered that offers /alarm as std_srvs/srv/Trigger
    5.0 s  it is an error: the service exists with another type

If no node offered /alarm after 5.0 s, that would be a warning, as such a node may start later.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final

from rclpy.action import get_action_server_names_and_types_by_node
from rclpy.node import Node

from dyknow_common import DyKnowError, listed
from dyknow_common.ros import RCLError, absolute_topic, ros_errors, run_with_node
from dyknow_configuration import ACTION_KEYS, ConfigurationError, RequestedFormula, Trigger

DISCOVERY_S: Final = 5.0
"""The time in which targets are looked for: Fast DDS repeats a lost announcement after 3 s."""

_PERIOD_S: Final = 0.05

_KEYS: Final = {kind: keys[0] for kind, keys in ACTION_KEYS.items()}
"""The kinds of triggers with a target in the running system, and what it is."""


@dataclass(frozen=True, slots=True)
class TargetFault:
    """A target that a trigger cannot use now.

    Args:
        trigger: the trigger.
        text: the fault, for people.
        is_missing: True if nobody offers the target, so it may come later; False if it has
            another type.
    """

    trigger: Trigger
    text: str
    is_missing: bool

    @property
    def error(self) -> ConfigurationError:
        """The fault with its place in the file."""
        place = _KEYS[self.trigger.kind] if self.is_missing else 'type'
        return self.trigger.error(self.text, (place,))

    @property
    def warning(self) -> str:
        """The fault with its place in one line."""
        error = self.error
        return f'{error.path}:{error.position}: {error.reason}' if error.path else error.reason


def target_of(node: Node, trigger: Trigger) -> str:
    """Return the absolute name of the topic, service or action of a trigger; or its command.

    Raises:
        ConfigurationError: if ROS cannot have it.
    """
    key = _KEYS.get(trigger.kind)
    if key is None:
        return trigger.target
    try:
        return absolute_topic(node, trigger.target, f'the {key}')
    except DyKnowError as error:
        raise trigger.error(error.message, (key,)) from None


def type_conflicts(
    triggers: Iterable[Trigger], name_of: Callable[[Trigger], str]
) -> Iterator[ConfigurationError]:
    """Yield an error for each trigger that uses the target of another one with another type.

    Args:
        triggers: the triggers.
        name_of: returns the name of the target of a trigger.
    """
    types: dict[tuple[str, str], str] = {}
    for each in triggers:
        if each.type_name:
            key = _KEYS[each.kind]
            name = name_of(each)
            known = types.setdefault((key, name), each.type_name)
            if known != each.type_name:
                text = f'another trigger uses the {key} {name} with the type {known}'
                yield each.error(text, ('type',))


def target_fault(node: Node, trigger: Trigger) -> TargetFault | None:
    """Return why a trigger cannot use its target in the running system now.

    None if it can, or after the shutdown of ROS.

    Raises:
        ConfigurationError: as for `target_of`.
    """
    if trigger.kind not in _KEYS or not node.context.ok():
        return None
    key, name = _KEYS[trigger.kind], target_of(node, trigger)
    types = _types(node, trigger, name)
    if not types:
        does = 'subscribe to' if key == 'topic' else f'offer the {key}'
        return TargetFault(trigger, f'no node is known to {does} {name}', is_missing=True)
    if not trigger.type_name or trigger.type_name in types:
        return None
    text = f'the {key} {name} has the type {listed(sorted(types))}, not {trigger.type_name}'
    return TargetFault(trigger, text, is_missing=False)


def present_target_faults(node: Node, triggers: Iterable[Trigger]) -> list[TargetFault]:
    """Return the targets that triggers cannot use now.

    Raises:
        ConfigurationError: as for `target_of`.
    """
    found = (target_fault(node, each) for each in triggers)
    return [each for each in found if each is not None]


def find_target_faults(node: Node, formulas: Iterable[RequestedFormula]) -> list[TargetFault]:
    """Return the targets that triggers of formulas cannot use, after DISCOVERY_S at most.

    Raises:
        ConfigurationError: as for `target_of`.
    """
    triggers, end = triggers_of(formulas), time.monotonic() + DISCOVERY_S
    while True:
        faults = present_target_faults(node, triggers)
        if not faults or time.monotonic() > end:
            return faults
        time.sleep(_PERIOD_S)


def observe_target_faults(formulas: Iterable[RequestedFormula]) -> list[TargetFault]:
    """Return the same with a node of its own, for a command that has none.

    Raises:
        ConfigurationError: as for `target_of`.
    """
    found: list[TargetFault] = []
    with ros_errors():
        run_with_node('check', lambda own: found.extend(find_target_faults(own.node, formulas)))
    return found


def triggers_of(formulas: Iterable[RequestedFormula]) -> Sequence[Trigger]:
    """Return the triggers of formulas, each once."""
    return list({id(each): each for formula in formulas for _, each in formula.on}.values())


def _types(node: Node, trigger: Trigger, name: str) -> set[str]:
    """Return the types of a target in the running system; empty if nobody offers it."""
    if _KEYS[trigger.kind] == 'service':
        return _server_types(node, name, node.get_service_names_and_types_by_node)
    if _KEYS[trigger.kind] == 'action':
        of_node = partial(get_action_server_names_and_types_by_node, node)
        return _server_types(node, name, of_node)
    subscribed = {each.topic_type for each in node.get_subscriptions_info_by_topic(trigger.target)}
    published = {each.topic_type for each in node.get_publishers_info_by_topic(trigger.target)}
    return subscribed or (set() if trigger.type_name in published else published)


def _server_types(
    node: Node, name: str, of_node: Callable[[str, str], list[tuple[str, list[str]]]]
) -> set[str]:
    """Return the types with which nodes offer a service or an action."""
    found: set[str] = set()
    for each, namespace in set(node.get_node_names_and_namespaces()):
        # The node may have gone meanwhile, or discovery may not know its services yet.
        with suppress(RCLError):
            offered = of_node(each, namespace)
            found.update(*(types for offered_name, types in offered if offered_name == name))
    return found

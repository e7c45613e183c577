"""Expectations of a robot.yaml about topics: what a recording of the robot must contain.

topics:
  /rover1/scan: {type: sensor_msgs/msg/LaserScan, min_rate: 9 Hz, max_gap: 500 ms}
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from dyknow_common import NO_CONSTRAINTS, DyKnowError, StreamConstraints
from dyknow_configuration.composed_text import constraint_value
from dyknow_configuration.yaml_values import YamlValue

TIMING_KEYS: Final = ('max_gap', 'max_delay', 'max_lead')

EXPECTATION_KEYS: Final = ('type', 'min_rate', 'max_rate', *TIMING_KEYS, 'stamped')

_RATE: Final = re.compile(r'\s*([0-9]+(?:\.[0-9]+)?)\s*Hz\s*', re.ASCII)
_TYPE: Final = re.compile(r'[A-Za-z]\w*(/[A-Za-z]\w*)+', re.ASCII)
_TYPE_TEXT: Final = 'a message type, such as sensor_msgs/msg/LaserScan'


@dataclass(frozen=True, slots=True)
class TopicExpectation:
    """Expectations about a topic, which must have messages.

    Args:
        topic: its absolute name.
        message_type: such as `sensor_msgs/msg/LaserScan`; empty for any.
        min_rate: the least number of messages in a second; None for any.
        max_rate: the greatest.
        constraints: `max_gap`, `max_delay` and `max_lead` of its messages.
        stamped: True if each message has a stamp.
        place: the place of the topic in the file.
    """

    topic: str
    message_type: str = ''
    min_rate: float | None = None
    max_rate: float | None = None
    constraints: StreamConstraints = NO_CONSTRAINTS
    stamped: bool = False
    place: str = ''


def read_expectations(value: YamlValue) -> tuple[TopicExpectation, ...]:
    """Return what a mapping from topics expects of them.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found: list[TopicExpectation] = []
    for key, given in value.entries('a mapping from topics to what is expected of them'):
        topic = key.text('a topic').strip()
        if not topic.startswith('/'):
            raise key.error(f"'{topic}' is no absolute name of a topic; write '/{topic}'")
        if '{' in topic:
            raise key.error('a topic cannot have a variable here; write the topic of each object')
        stated = given.mapping(EXPECTATION_KEYS)
        rates = {each: _rate(stated[each]) for each in ('min_rate', 'max_rate') if each in stated}
        if len(rates) > 1 and rates['min_rate'] > rates['max_rate']:
            raise stated['min_rate'].error('min_rate is more than max_rate; exchange them')
        found.append(
            TopicExpectation(
                topic,
                stated['type'].matched(_TYPE, _TYPE_TEXT) if 'type' in stated else '',
                **rates,
                constraints=_constraints(stated),
                stamped='stamped' in stated and stated['stamped'].truth(),
                place=key.place,
            )
        )
    return tuple(found)


def _rate(value: YamlValue) -> float:
    found = _RATE.fullmatch(value.text()) if value.is_text else None
    if found is None or not float(found[1]):
        raise value.expected('a rate, such as 9.5 Hz,')
    return float(found[1])


def _constraints(stated: Mapping[str, YamlValue]) -> StreamConstraints:
    given: dict[str, Any] = {
        key: constraint_value(key, stated[key]) for key in TIMING_KEYS if key in stated
    }
    constraints = StreamConstraints(**given)
    try:
        constraints.validate()
    except DyKnowError as error:
        raise stated[next(iter(given))].error(error.message) from None
    return constraints

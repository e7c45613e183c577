"""Robots whose topics have their names: `/uav1/odom` and `/uav2/odom` are of uav1 and uav2."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from dyknow_configuration.proposals.message_types import camel_case, proposals_of
from dyknow_configuration.proposals.observations import ObservedTopic
from dyknow_configuration.vocabulary import is_free_name

_NUMBERED: Final = re.compile(r'.*[0-9]')


@dataclass(frozen=True, slots=True)
class RobotNames:
    """The robots whose names begin the names of topics.

    Args:
        sort: of the robots.
        objects: their names; none if there is a single robot whose topics do not have its name.
    """

    sort: str = 'Robot'
    objects: tuple[str, ...] = ()

    @property
    def variable(self) -> str:
        """The variable for a robot in formulas and topics."""
        return self.sort[0].lower()

    def robot_of(self, topic: str) -> str:
        """Return the robot of a topic; empty if it has none."""
        first, _, rest = topic.lstrip('/').partition('/')
        return first if rest and first in self.objects else ''


def robots_of(topics: Iterable[ObservedTopic]) -> RobotNames:
    """Return the robots whose topics carry features.

    The first part of a topic is a robot if it ends with a number, or if another first part has a
    topic of the same name and type.
    """
    known: dict[str, set[tuple[str, str]]] = defaultdict(set)
    for topic in topics:
        first, _, rest = topic.name.lstrip('/').partition('/')
        if rest and is_free_name(first) and any(proposals_of(topic.message_type, topic.fields)):
            known[first].add((rest, topic.message_type))
    owners: dict[tuple[str, str], list[str]] = defaultdict(list)
    for first, found in known.items():
        for each in found:
            owners[each].append(first)
    shared = {first for each in owners.values() if len(each) > 1 for first in each}
    robots = sorted(each for each in known if each in shared or _NUMBERED.fullmatch(each))
    stems = {camel_case(each.rstrip('0123456789')) for each in robots}
    stem = stems.pop() if len(stems) == 1 else ''
    is_sort = is_free_name(stem) and stem not in robots
    return RobotNames(stem if is_sort else 'Robot', tuple(robots))

"""Shared parts of the coordinator, and its limits."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Final

from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import String

from dyknow_common import SECOND_NS, ExitCode, Symbol
from dyknow_common.ros import Background, DyKnowNode, ParameterLimits
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import FOLLOWED
from dyknow_coordinator.grounding.candidate_search import feature_symbols
from dyknow_coordinator.grounding.known_streams import stream_topic
from dyknow_coordinator.reporting.peer_reasons import PEER_WAITS, with_waits_of_peers
from dyknow_coordinator.ros.cleanup import Cleanup
from dyknow_coordinator.ros.results import Results
from dyknow_coordinator.ros.service_clients import ServiceClients
from dyknow_coordinator.ros.streams_mirror import StreamsMirror

LIMITS: Final = {
    'evaluation_limit': (500, 'Formulas that are evaluated at once, for all clients together.'),
    'plan_limit': (50, 'Plans that are monitored at once.'),
    'plan_part_limit': (1000, 'Actions and formulas of a plan.'),
    'object_limit': (10_000, 'Sorts and objects for which a formula is evaluated.'),
    'feature_limit': (10_000, 'Ground features of a formula, which are the fields of its states.'),
    'ended_limit': (200, 'Formulas that are reported to operators after their end.'),
    'verdict_topic_limit': (200, 'Topics with the verdicts of formulas that have names.'),
}


@dataclass(frozen=True, slots=True)
class CoordinatorContext:
    """Parts of the coordinator that every evaluation uses.

    Args:
        clients: clients of the services that it calls.
        streams: all streams of the system.
        explained_wait: returns why no state comes, with the reasons of peers.
        results: the results of the reasoning engine.
        cleanup: destroys unused streams and formula groups.
        background: runs long computations.
        limits: the limits of all evaluations, and of each one.
        names: makes names of formula groups and state streams, unique in the system.
    """

    node: DyKnowNode
    clients: ServiceClients
    streams: StreamsMirror
    explained_wait: Callable[[str], str]
    results: Results
    cleanup: Cleanup
    background: Background
    limits: ParameterLimits
    names: Iterator[str]

    def outcome_logger(self, *, is_followed: bool) -> RcutilsLogger:
        """Return the logger of what becomes of formulas.

        Args:
            is_followed: True if their clients report it, too: the name of the logger says so.
        """
        logger: RcutilsLogger = self.node.get_logger()
        if is_followed:
            logger = logger.get_child(FOLLOWED)
        return logger

    def wall_time(self) -> int:
        """Return the time of a clock that does not depend on simulated time, in nanoseconds."""
        return int(self.node.wall_clock.now().nanoseconds)

    def wall_time_s(self) -> float:
        """Return the same time in seconds."""
        return self.wall_time() / SECOND_NS

    def fault(self, error: Exception) -> CoordinationError:
        """Return the error of formulas for an unexpected one."""
        if not self.node.context.ok():  # Nothing can be requested any more.
            return CoordinationError('the coordinator is stopped', ExitCode.UNAVAILABLE)
        return CoordinationError(f'fault in DyKnow: {error!r}', ExitCode.INTERNAL_ERROR)

    def state_topic(self, name: str) -> str:
        """Return the topic of a state stream, if an engine in the coordinator's namespace has it.

        So the reasoning engine can subscribe before the stream exists.
        """
        return self.node.resolve_topic_name(stream_topic(name))


def explained_waits(node: DyKnowNode, federation: str) -> Callable[[str], str]:
    """Return what adds the reasons of peers to the text why no state comes.

    Args:
        node: the coordinator.
        federation: the name of the federation node, which reports the reasons.
    """
    waits: dict[str, str] = {}

    def take(message: Any) -> None:
        nonlocal waits
        waits = json.loads(message.data)

    topic = f'{federation}/{PEER_WAITS}'
    node.create_report_subscription(String, topic, take, callback_group=node.reentrant)
    return lambda waits_for: with_waits_of_peers(waits_for, waits)


def check_domains(
    limits: ParameterLimits, symbols: Sequence[Symbol], domains: Mapping[str, Sequence[str]]
) -> None:
    """Check the objects of a formula, and the number of its ground features.

    Args:
        limits: the limits of the coordinator.
        symbols: the symbols of the formula.
        domains: the objects of each of its sorts.

    Raises:
        CoordinationError: if there are too many.
    """
    objects = len(domains) + sum(map(len, domains.values()))
    limits.check('object_limit', objects, 'sorts and objects', ExitCode.INVALID_ARGUMENT)
    counts = {sort: len(found) for sort, found in domains.items()}
    features = sum(
        prod(counts.get(argument, 1) for argument in symbol.arguments)
        for symbol in feature_symbols(symbols)
    )
    what = 'features of objects in the formula'
    limits.check('feature_limit', features, what, ExitCode.INVALID_ARGUMENT)

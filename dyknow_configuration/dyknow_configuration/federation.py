"""The federation of a robot.yaml: what this host shares with others, and how it reaches them.

federation:
  name: carrier1
  connect: [tcp/basestation:7447]
  share: [Position, {feature: Charge, every: 1 s, deadband: 0.01}]
  compared: {Speed: [0, 1.5]}
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Final

from dyknow_common import NANOSECONDS
from dyknow_configuration.yaml_values import YamlValue, texts

FEDERATION_KEYS: Final = (
    'name',
    'connect',
    'listen',
    'share',
    'same',
    'compared',
    'peer_timeout',
    'history',
    'max_uncertainty',
    'zenoh',
)
SHARE_KEYS: Final = ('feature', 'every', 'deadband')

MAX_COMPARED: Final = 20
"""The numbers that one feature may be compared with."""

MAX_COMPARED_NUMBER: Final = 2**53
"""They are below it, where each integer is a float."""

_NAME: Final = re.compile('[A-Za-z_][A-Za-z0-9_]{0,63}')
_ENDPOINT: Final = re.compile(r'[a-z][a-z0-9_-]*/\S+')
_SHORTEST_NS: Final = NANOSECONDS['s']
_LONGEST_NS: Final = NANOSECONDS['h']


@dataclass(frozen=True, slots=True)
class RequestedShare:
    """A feature that other hosts may ask for.

    Args:
        name: the name of the feature.
        every: the least time between two samples that leave, in nanoseconds; 0: all samples leave.
        deadband: a sample leaves only if it differs by more than this from the last one, in the
            unit of the feature; None: all samples leave.
    """

    name: str
    every: int = 0
    deadband: float | None = None


@dataclass(frozen=True, slots=True)
class RequestedFederation:
    """The role of a host in a federation.

    Args:
        name: the name of this host among its peers.
        connect: endpoints of zenoh to connect to, such as `tcp/basestation:7447`.
        listen: endpoints of zenoh that others connect to.
        share: the features that others may ask for; nothing else leaves.
        same: objects that are the same thing wherever a peer names them.
        compared: features of peers, each with the numbers, in ascending order, with which formulas
            here compare it, in the unit of the peer; they do nothing else with it.
        peer_timeout: the time after which an unreachable peer counts as gone, in nanoseconds.
        history: how long samples are kept for peers that were unreachable, in nanoseconds.
        max_uncertainty: the largest uncertainty of a peer's valid times, in nanoseconds; a sample
            with a larger one is a violation.
        zenoh: a file of zenoh's own configuration; None: its defaults.
    """

    name: str
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    share: tuple[RequestedShare, ...] = ()
    same: tuple[str, ...] = ()
    compared: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    peer_timeout: int = 10 * NANOSECONDS['s']
    history: int = NANOSECONDS['min']
    max_uncertainty: int = 100 * NANOSECONDS['ms']
    zenoh: Path | None = None


def read_federation(value: YamlValue) -> RequestedFederation:
    """Return the federation that a mapping describes.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    stated = value.mapping(FEDERATION_KEYS, ('name',))
    default = RequestedFederation('')
    return RequestedFederation(
        stated['name'].matched(_NAME, 'a name of at most 64 letters, digits and _'),
        _endpoints(stated, 'connect'),
        _endpoints(stated, 'listen'),
        share=_shares(stated['share']) if 'share' in stated else (),
        same=tuple(each.line() for each in texts(stated, 'same')),
        compared=_compared(stated['compared']) if 'compared' in stated else {},
        peer_timeout=_limit(stated, 'peer_timeout', default.peer_timeout),
        history=_limit(stated, 'history', default.history),
        max_uncertainty=(
            stated['max_uncertainty'].non_negative_duration()
            if 'max_uncertainty' in stated
            else default.max_uncertainty
        ),
        zenoh=stated['zenoh'].existing_file() if 'zenoh' in stated else None,
    )


def _shares(value: YamlValue) -> tuple[RequestedShare, ...]:
    found: dict[str, RequestedShare] = {}
    for each in value.one_or_more():
        stated = each.mapping(SHARE_KEYS, ('feature',)) if each.is_mapping else {'feature': each}
        name = stated['feature'].text('the name of a feature').strip()
        if name in found:
            raise each.error(f"'{name}' is shared twice; keep one")
        every = stated['every'].non_negative_duration() if 'every' in stated else 0
        deadband = _deadband(stated['deadband']) if 'deadband' in stated else None
        found[name] = RequestedShare(name, every, deadband)
    return tuple(found.values())


def _deadband(value: YamlValue) -> float:
    if not 0 <= (found := value.number()) < inf:
        raise value.error('write a number from 0 on, in the unit of the feature')
    return found


def _compared(value: YamlValue) -> dict[str, tuple[float, ...]]:
    found: dict[str, tuple[float, ...]] = {}
    for feature, given in value.entries('a mapping of features to numbers'):
        numbers = sorted({each.number() for each in given.one_or_more()})
        if not 0 < len(numbers) <= MAX_COMPARED:
            raise feature.error(f'write 1 to {MAX_COMPARED} numbers')
        if not all(abs(each) < MAX_COMPARED_NUMBER for each in numbers):
            raise feature.error('write numbers of less than 2**53')
        found[feature.word()] = tuple(numbers)
    return found


def _endpoints(stated: Mapping[str, YamlValue], key: str) -> tuple[str, ...]:
    description = 'an endpoint such as tcp/basestation:7447'
    return tuple(each.matched(_ENDPOINT, description) for each in texts(stated, key))


def _limit(stated: Mapping[str, YamlValue], key: str, default: int) -> int:
    found = stated[key].duration() if key in stated else default
    if not _SHORTEST_NS <= found <= _LONGEST_NS:
        raise stated[key].error('write a duration from 1 s to 1 h')
    return found

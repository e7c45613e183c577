"""The metadata of a bag: its files, and the numbers of its messages."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, Final

import yaml

from dyknow_recordings.reading.lost_messages import LostMessages
from dyknow_recordings.reading.recording import FaultCounter

METADATA: Final = 'metadata.yaml'

CUT: Final = 'dyknow_cut'
"""The key in the custom data of a bag that is cut from a recording: what that lacks."""

_DAMAGE: Final = (
    yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError
)  # fmt: skip
"""Raised where the metadata is damaged."""

_LOADER: Final = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


@dataclass(frozen=True, slots=True)
class BagMetadata:
    """The metadata of a bag; empty if there is none.

    Args:
        files: the names of its files, each once.
        counts: the number of messages by topic.
        distro: the distribution of ROS 2 of its recorder, such as `humble`; empty if unknown.
        losses: the messages that the recording lacks which the bag is cut from.
        is_suffix: True if that recording has messages from before the bag.
    """

    files: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    distro: str = ''
    losses: tuple[LostMessages, ...] = ()
    is_suffix: bool = False


def read_metadata(folder: Path, faults: FaultCounter) -> BagMetadata:
    """Return the metadata in the folder of a bag; what is wrong with it is a fault."""
    try:
        information = _information(folder)
        # Early versions give the path from the folder above.
        files = [PurePath(path).name for path in information['relative_file_paths']]
    except OSError:
        reason = f'{METADATA} is missing'
    except _DAMAGE:
        reason = f'{METADATA} is damaged'
    else:
        names = tuple(dict.fromkeys(files))
        if len(names) < len(files):
            faults.add(str(folder), f'{METADATA} names a file again', len(files) - len(names))
        cut = _cut(information, str(folder), faults)
        return BagMetadata(names, _counts(information), _distro(information), *cut)
    faults.add(str(folder), f'{reason}: the bag is read without it')
    return BagMetadata()


def cut_data(losses: Iterable[LostMessages], *, is_suffix: bool) -> str:
    """Return a text for the custom data of a bag that is cut from a recording; see BagMetadata."""
    stated = [
        [None if each.topics is None else sorted(each.topics), each.first, each.last, each.reason]
        for each in losses
    ]
    # The library that writes YAML folds long texts with backslashes incorrectly.
    return b64encode(json.dumps([stated, is_suffix]).encode()).decode()


def _cut(
    information: Mapping[str, Any], place: str, faults: FaultCounter
) -> tuple[tuple[LostMessages, ...], bool]:
    data = information.get('custom_data') or {}
    if CUT not in data:
        return (), False
    try:
        losses, is_suffix = json.loads(b64decode(data[CUT], validate=True))
        return tuple(
            LostMessages(None if topics is None else frozenset(topics), first, last, str(reason))
            for topics, first, last, reason in losses
        ), bool(is_suffix)
    except _DAMAGE:
        faults.lose(place, f'what {METADATA} says of the recording that it is cut from is damaged')
        return (), True


def distro_beside(path: Path) -> str:
    """Return the distribution that the metadata beside a file of a bag names, or an empty text."""
    try:
        found = _information(path.parent)
        names = [PurePath(each).name for each in found['relative_file_paths']]
    except (OSError, *_DAMAGE):
        return ''
    return _distro(found) if path.name in names else ''


def _information(folder: Path) -> Any:
    text = (folder / METADATA).read_text(encoding='utf-8')
    # The safe loaders of PyYAML; the one in C takes a tenth of the time.
    return yaml.load(text, _LOADER)['rosbag2_bagfile_information']  # noqa: S506


def _counts(information: Mapping[str, Any]) -> Mapping[str, int]:
    counts: Counter[str] = Counter()
    try:
        for each in information['topics_with_message_count']:
            counts[str(each['topic_metadata']['name'])] += int(each['message_count'])
    except (LookupError, TypeError, ValueError):
        return {}
    return counts


def _distro(information: Mapping[str, Any]) -> str:
    return str(information.get('ros_distro') or '')

"""The folder of black boxes: bags of rosbag2, which appear when they are complete."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import WriterError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, numbered_names, sourced_prefixes
from dyknow_reactions.black_box.message_ring import SerialisedMessage
from dyknow_recordings import BLACK_BOX, BlackBoxContent, bag_writer, offered_profile

_MAX_NAME: Final = 60
_OVERHEAD: Final = 100_000
"""The bytes of a bag beside its messages, about: definitions, content and metadata."""


@dataclass(frozen=True, slots=True)
class TopicOffer:
    """A topic, as its publishers offer it.

    Args:
        message_type: such as `nav_msgs/msg/Odometry`.
        offers: for each publisher, whether it is reliable, whether it keeps messages for later
            subscribers, and how many it keeps.
    """

    message_type: str
    offers: tuple[tuple[bool, bool, int], ...]


class BoxFolder:
    """A folder with black boxes. The oldest are removed where new ones need their place.

    Args:
        folder: made with the first box.
        owner: a name that no other process that writes to the folder has.
        max_bytes: the most bytes of all boxes.
        max_boxes: their number.
    """

    def __init__(self, folder: Path, owner: str, max_bytes: int, max_boxes: int) -> None:
        self._folder = folder
        self._drafts = folder / f'.writing_{_word(owner)}'
        self._max_bytes = max_bytes
        self._max_boxes = max_boxes
        self.removed = 0
        """The number of boxes that were removed for new ones."""

    @property
    def fault(self) -> str:
        """Why no box can be written, as far as that is known before; empty if one can be."""
        above = (self._folder, *self._folder.parents)
        found = next((each for each in above if os.access(each, os.F_OK)), self._folder)
        if found.is_dir() and os.access(found, os.W_OK | os.X_OK):
            return ''
        return f'no black box can be written: {found} is no writable folder'

    def write(
        self,
        content: BlackBoxContent,
        time: int,
        messages: Sequence[SerialisedMessage],
        topics: Mapping[str, TopicOffer],
    ) -> Path:
        """Write a box; return its path.

        Args:
            content: what the box knows beside its messages.
            time: the time of the failure, nanoseconds since the epoch.
            messages: in the order of their times.
            topics: the topics of all messages.

        Raises:
            DyKnowError: UNAVAILABLE, if it cannot be written.
        """
        size = sum(len(each.data) for each in messages) + len(content.text) + _OVERHEAD
        if size > self._max_bytes:
            raise DyKnowError(
                f'the black box of up to {size} bytes does not fit in {self._folder}, which may '
                f"have {self._max_bytes} (the limit 'folder_bytes'); raise it, or record less",
                ExitCode.UNAVAILABLE,
            )
        try:
            self._prepare(size)
            path = None
            while path is None:
                path = self._write(content, time, messages, topics)
        except (OSError, WriterError) as error:
            reason = getattr(error, 'strerror', None) or error
            text = f'cannot write to {self._folder}: {reason}'
            raise DyKnowError(text, ExitCode.UNAVAILABLE) from None
        finally:
            shutil.rmtree(self._drafts, ignore_errors=True)
        return path

    def _write(
        self,
        content: BlackBoxContent,
        time: int,
        messages: Sequence[SerialisedMessage],
        topics: Mapping[str, TopicOffer],
    ) -> Path | None:
        """Write a box; return its path, or None if another recorder used it meanwhile."""
        path = self._path(content.name, time)
        draft = self._drafts / path.name
        _write_bag(draft, content, messages, topics)
        try:
            draft.rename(path)
        except OSError as error:
            if error.errno not in {errno.EEXIST, errno.ENOTEMPTY}:
                raise
            shutil.rmtree(draft)
            return None
        return path

    def _prepare(self, size: int) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        # What another run has left unfinished.
        shutil.rmtree(self._drafts, ignore_errors=True)
        self._make_room(size)

    def _make_room(self, size: int) -> None:
        """Remove the oldest boxes until there is room for another one."""
        boxes = sorted(self._boxes().items(), key=lambda each: each[1])
        total = sum(size for _, (_, size) in boxes)
        while boxes and (total + size > self._max_bytes or len(boxes) >= self._max_boxes):
            oldest, (_, freed) = boxes.pop(0)
            total -= freed
            with suppress(FileNotFoundError):
                shutil.rmtree(oldest)
                self.removed += 1

    def has_box(self, name: str, since: int) -> bool:
        """Return True if a box of a formula was written at a time or later, nanoseconds."""
        try:
            boxes = self._boxes().items()
        except OSError:
            return False
        stem = re.compile(rf'{_word(name)}(_\d+)?')
        return any(
            time >= since and stem.fullmatch(path.name.partition('_')[2])
            for path, (time, _) in boxes
        )

    def _boxes(self) -> dict[Path, tuple[int, int]]:
        """Return the time and the size of each black box; nothing else in the folder is one."""
        found = {}
        for each in self._folder.iterdir():
            # Another recorder may remove a box meanwhile.
            with suppress(FileNotFoundError, NotADirectoryError):
                metadata = each / 'metadata.yaml'
                is_bag = (each / f'{each.name}.mcap').is_file() and metadata.is_file()
                if is_bag and BLACK_BOX in metadata.read_text(encoding='utf-8', errors='replace'):
                    found[each] = each.stat().st_mtime_ns, _size(each)
        return found

    def _path(self, name: str, time: int) -> Path:
        moment = datetime.fromtimestamp(max(time, 0) // SECOND_NS, UTC)
        stem = f'{moment:%Y-%m-%dT%H-%M-%S}_{_word(name)}'
        paths = (self._folder / each for each in numbered_names(stem))
        return next(each for each in paths if not each.exists())


def _write_bag(
    path: Path,
    content: BlackBoxContent,
    messages: Sequence[SerialisedMessage],
    topics: Mapping[str, TopicOffer],
) -> None:
    path.parent.mkdir(exist_ok=True)
    writer = bag_writer(path)
    for key, text in content.custom_data.items():
        writer.set_custom_data(key, text)
    with writer:
        connections = {
            topic: writer.add_connection(
                topic,
                offer.message_type,
                typestore=typestore_of(offer.message_type),
                offered_qos_profiles=[offered_profile(*each) for each in offer.offers],
            )
            for topic, offer in topics.items()
        }
        for each in messages:
            writer.write(connections[each.topic], each.time, each.data)


def _size(folder: Path) -> int:
    return sum(each.stat().st_size for each in folder.iterdir() if each.is_file())


def _word(name: str) -> str:
    return re.sub(r'[^A-Za-z0-9]+', '_', name).strip('_')[:_MAX_NAME] or 'formula'


_JAZZY: Final = get_typestore(Stores.ROS2_JAZZY)
_INSTALLED: Final = get_typestore(Stores.EMPTY)


@cache
def typestore_of(message_type: str) -> Typestore:
    """Return types among which is a type, with all that it is made of.

    Raises:
        DyKnowError: NOT_FOUND, if it is not defined.
    """
    pending = [message_type]
    while pending:
        name = pending.pop()
        if name in _INSTALLED.fielddefs:
            continue
        path = _installed_file(name)
        if path is None and name in _JAZZY.fielddefs:
            _INSTALLED.register({name: _JAZZY.fielddefs[name]})
        elif path is None:
            raise DyKnowError(
                f'the message type {name} is not defined; install its package', ExitCode.NOT_FOUND
            )
        else:
            _INSTALLED.register(get_types_from_msg(path.read_text(encoding='utf-8'), name))
        pending += [used for _, each in _INSTALLED.fielddefs[name][1] if (used := _named(each))]
    return _INSTALLED


def _named(description: Any) -> str:
    """Return the message type that the description of a field names; empty for other fields."""
    kind, detail = description
    if kind == Nodetype.NAME:
        return str(detail)
    return '' if kind == Nodetype.BASE else _named(detail[0])


def _installed_file(name: str) -> Path | None:
    package, _, message = name.partition('/msg/')
    prefixes = sourced_prefixes()
    paths = (Path(each, 'share', package, 'msg', f'{message}.msg') for each in prefixes)
    return next((path for path in paths if path.is_file()), None)

"""Operators of frames: the tree of all transforms, and the transform between two of them.

Example: `tf("map", "base")` with the links odom -> map and base -> odom. Transforms arrive with
these valid times (in milliseconds):

    message             samples
    base -> odom at 10  - (the transform of odom in map is not known)
    odom -> map at 15   - (base is known until 10, before the first transform of odom)
    base -> odom at 20  15 (base is interpolated)
    base -> odom at 30  -
    odom -> map at 30   20, 30 (at 20, odom is interpolated)
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Any, Final, cast

from dyknow_common import (
    SECOND_NS,
    Value,
    format_duration,
    format_time,
    round_duration,
    round_time,
)
from dyknow_stream_processing.dataflow.built_in.transform_tree import (
    MAX_AGE_NS,
    MAX_TRANSFORMS,
    SUPERSEDED,
    Chain,
    Link,
    RefusedTransformError,
    StampedTransform,
    TransformTree,
)
from dyknow_stream_processing.dataflow.built_in.transforms import Transform, checked_transform
from dyknow_stream_processing.dataflow.constraint_checks import too_late
from dyknow_stream_processing.dataflow.operators import (
    NO_PROMISE,
    OTHER_CLOCK_NS,
    Operator,
    Wiring,
)
from dyknow_stream_processing.dataflow.scheduler import BEGINNING, END
from dyknow_stream_processing.sample import WholeMessage
from dyknow_stream_processing.violation import Fault, ViolationKind

_STATIC_PORT: Final = 1


@dataclass(slots=True)
class Changes:
    """Changes by a message, by child frame.

    Args:
        added: the valid times of its transforms.
        forgotten: the valid times of earlier transforms that are not kept any longer.
        refused: why a transform was refused.
    """

    added: defaultdict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    forgotten: dict[str, list[int]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)

    @property
    def children(self) -> AbstractSet[str]:
        """The child frames."""
        return self.added.keys() | self.refused.keys()


class TransformTreeOperator(Operator):
    """The transforms of /tf (the first input) and /tf_static, for all streams of frames."""

    _sorts = False

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        self.timed = False
        self.tree = TransformTree()
        self.changes = Changes()
        """The changes by the latest message."""

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Add the transforms of a message, and tell the streams of frames."""
        del watermark
        self.changes = Changes()
        try:
            for each in _transforms(fields):
                self._add(each, now, is_static=port == _STATIC_PORT)
        except (AttributeError, TypeError):
            message = f'a message of {self.inputs[port].label} is no tf2_msgs/msg/TFMessage'
            self._reject(Fault(ViolationKind.FIELDS, valid_time, message))
        self._emit(now, {}, NO_PROMISE, now)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Promise nothing: the times of receipt say nothing about the stamps of transforms."""

    def become_timed(self) -> None:
        """Ignore that the clock makes times of receipt certain."""

    def awaited(self) -> Iterable[Operator]:
        """Return the source of /tf; static transforms come once, or never."""
        return self.inputs[:1]

    def _add(self, message: Any, now: int, *, is_static: bool) -> None:
        child = str(message.child_frame_id).removeprefix('/')
        changes, version = self.changes, self.tree.version
        try:
            stamped = _stamped(message, child, now, is_static=is_static)
            forgotten = self.tree.add(stamped, is_static=is_static)
        except RefusedTransformError as error:
            self._drop(error.reason)
            if error.reason != SUPERSEDED:
                changes.refused[child] = str(error)
            return
        changes.added[child].append(stamped.valid_time)
        if self.tree.version == version:
            changes.forgotten.setdefault(child, []).extend(forgotten)
        else:
            for observer in self.observers if forgotten else ():
                observer.count_drops('parent_changed', len(forgotten))


class FramesOperator(Operator):
    """The transform of a frame in another one, at each valid time of a dynamic link between them.

    Between static links, the transform is valid when it is received. While links between the frames
    are missing, the transforms of the others are kept: they are not late when the last link comes.

    Args:
        target: the frame in which the other one is described.
        source: the other frame.
        max_delay: the delay from which a sample is too late, in nanoseconds; `None` for no limit.
    """

    _sorts = True

    def __init__(self, wiring: Wiring, target: str, source: str, max_delay: int | None) -> None:
        super().__init__(wiring)
        self._max_delay = END if max_delay is None else max_delay
        self._origin = cast('TransformTreeOperator', self.inputs[0])
        self._target = target
        self._source = source
        self._version = -1
        self._used: AbstractSet[str] = frozenset()
        """The children whose transforms concern this stream."""
        self._chain: Chain | None = None
        self._static: Transform | None = None
        """The latest sample, if all links are static."""
        self._refusals: dict[str, str] = {}
        self._find_chain()
        self._done = self._horizon()
        """The valid time up to which all samples have been made."""
        if self._origin.tree:
            # The transforms may be known already; no message need come for them.
            self._scheduler.wake_at(self, self._scheduler.now)

    def receive(
        self, port: int, valid_time: int, fields: Mapping[str, Value], watermark: int, now: int
    ) -> None:
        """Make the samples that the latest message has made possible."""
        del port, valid_time, fields, watermark
        changes = self._origin.changes
        if self._version == self._origin.tree.version and self._used.isdisjoint(changes.children):
            return
        former = self._chain
        self._find_chain()
        self._report_refusals(changes, now)
        if former is not None:
            self._report_missed(changes, former.dynamic)
        self._make_samples(now, is_new=self._chain is not former)

    def wake(self, now: int) -> None:
        """Make the first sample."""
        self._make_samples(now, is_new=True)

    def promise(self, port: int, watermark: int, now: int) -> None:
        """Promise nothing beside the samples."""

    def certain_at(self, valid_time: int) -> int | None:
        """Return the next nanosecond for static links, whose samples are valid when received."""
        if valid_time <= self.watermark:
            return BEGINNING
        return valid_time + 1 if self._is_static else None

    def certain_until(self, now: int) -> int:
        """Return the latest time at which no more sample can be valid."""
        return max(self.watermark, now - 1) if self._is_static else self.watermark

    def awaited(self) -> Iterable[Operator]:
        """Return the tree of transforms, unless it lacks the needed transforms."""
        known = bool(self._origin.tree)
        return () if known and (self._chain is None or self._is_static) else self.inputs

    def obstacle(self, name: Callable[[Operator], str]) -> str:
        """Return which frame or transform is missing."""
        del name
        if self._chain is None:
            found = self._origin.tree.obstacle(self._target, self._source)
            refusals = [
                f"a transform of '{child}' is refused: {reason}"
                for child, reason in self._refusals.items()
                if child in {self._target, self._source}
            ]
            return '; '.join([found, *refusals])
        if self._is_static:
            return ''
        latest = min(self._chain.dynamic, key=lambda link: link.times[-1])
        return (
            f"no transform of '{latest.child}' in '{latest.parent}' comes after the one valid at "
            f'{round_time(latest.times[-1])}'
        )

    @property
    def _is_static(self) -> bool:
        return self._chain is not None and not self._chain.dynamic

    def _find_chain(self) -> None:
        tree = self._origin.tree
        if self._version != tree.version:
            self._version = tree.version
            self._chain = tree.chain(self._target, self._source)
            links = () if self._chain is None else self._chain.links
            self._used = {self._target, self._source, *(link.child for link in links)}

    def _horizon(self) -> int:
        """Return the valid time up to which all dynamic links are known."""
        return min((link.times[-1] for link in (self._chain or _NONE).dynamic), default=BEGINNING)

    def _make_samples(self, now: int, *, is_new: bool) -> None:
        if self._chain is None:
            return
        if self._is_static:
            transform = self._chain.at(now)
            if transform != self._static and now > self._done:
                self._static, self._done = transform, now
                self.become_timed()
                self._emit(now, transform.fields(), now, now)
            return
        self._static = None
        for valid_time in self._due_times(self._chain):
            self._done = valid_time
            delay = now - valid_time
            is_late = self._max_delay < delay <= OTHER_CLOCK_NS
            if is_late and not (is_new and self._was_kept(valid_time, self._chain)):
                self._reject(too_late(valid_time, delay, self._max_delay, 'after its stamp'))
                continue
            fields = self._chain.at(valid_time).fields()
            self._emit(valid_time, fields, valid_time, now)

    def _was_kept(self, valid_time: int, chain: Chain) -> bool:
        """Return True if no transform of the latest message is valid at a time."""
        added = self._origin.changes.added
        return not any(valid_time in added.get(link.child, ()) for link in chain.dynamic)

    def _due_times(self, chain: Chain) -> list[int]:
        links, until = chain.dynamic, self._horizon()
        if until <= self._done:
            return []
        since = max(self._done + 1, *(link.times[0] for link in links))
        times = {time for link in links for time in link.times_since(since)}
        return sorted(time for time in times if time <= until)

    def _report_refusals(self, changes: Changes, now: int) -> None:
        for child in self._used & changes.refused.keys():
            self._refusals[child] = changes.refused[child]
            message = f"a transform of '{child}' cannot be used: {changes.refused[child]}"
            self._violate(Fault(ViolationKind.MESSAGE, now, message))

    def _report_missed(self, changes: Changes, links: Sequence[Link]) -> None:
        """Report valid times of links at which there is no sample, or was one already."""
        for link in links:
            others = (other.times[0] for other in links if other is not link)
            since = max((self._done + 1, *others))
            for valid_time in changes.forgotten.get(link.child, ()):
                if valid_time >= since:
                    self._reject(_forgotten(link, valid_time))
            for valid_time in changes.added.get(link.child, ()):
                if valid_time <= self._done:
                    self._reject(_late(link, valid_time, self._done))


_NONE: Final = Chain((), ())


def _transforms(fields: Mapping[str, Value]) -> Iterator[Any]:
    if not isinstance(fields, WholeMessage):
        raise TypeError
    yield from fields.message.transforms


def _stamped(message: Any, child: str, now: int, *, is_static: bool) -> StampedTransform:
    """Return the transform in a message; a static one is valid when it is received."""
    stamp = message.header.stamp
    valid_time = now if is_static else stamp.sec * SECOND_NS + stamp.nanosec
    if not is_static and valid_time <= 0:
        raise RefusedTransformError('it has no stamp')
    # One wrong stamp must not make all transforms after it old. Simulated time begins at 0.
    if now and valid_time - now > MAX_AGE_NS:
        lead = round_duration(valid_time - now)
        raise RefusedTransformError(
            f'it is stamped {lead} ahead of the clock', ViolationKind.FUTURE
        )
    translation, rotation = message.transform.translation, message.transform.rotation
    try:
        transform = checked_transform(
            (translation.x, translation.y, translation.z),
            (rotation.x, rotation.y, rotation.z, rotation.w),
        )
    except ValueError as error:
        raise RefusedTransformError(str(error)) from None
    parent = str(message.header.frame_id).removeprefix('/')
    return StampedTransform(parent, child, valid_time, transform)


def _forgotten(link: Link, valid_time: int) -> Fault:
    message = (
        f"the transform of '{link.child}' in '{link.parent}' valid at {round_time(valid_time)} is "
        f'forgotten before the other transforms between the frames are known then: at most '
        f'{format_duration(MAX_AGE_NS)} and {MAX_TRANSFORMS} transforms are kept'
    )
    return Fault(ViolationKind.BUFFER, valid_time, message)


def _late(link: Link, valid_time: int, done: int) -> Fault:
    message = (
        f"the transform of '{link.child}' in '{link.parent}' valid at {format_time(valid_time)} "
        f'came after those up to {format_time(done)} were used'
    )
    return Fault(ViolationKind.VALID_TIME_ORDER, valid_time, message, done - valid_time)

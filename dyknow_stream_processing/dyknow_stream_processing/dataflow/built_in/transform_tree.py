"""The latest transforms between frames, and the chains that they form.

Each frame is linked to its parent by the transforms of its child frame id. A chain leads from two
frames up to their first common parent:

    odom -> map (link of odom), base -> odom (link of base), laser -> base (link of laser)
    chain of map and laser:  up from laser: laser, base, odom;  up from map: nothing
    chain of odom and laser: up from laser: laser, base;        up from odom: nothing

A static link holds at all times. A dynamic one holds from its first to its latest valid time; in
between, its transform is interpolated. Nothing is extrapolated.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import reduce
from typing import Final

from dyknow_common import SECOND_NS
from dyknow_stream_processing.dataflow.built_in.transforms import IDENTITY, Transform

MAX_AGE_NS: Final = 10 * SECOND_NS
"""The time for which transforms are kept, counted back from the latest one of their link."""

MAX_TRANSFORMS: Final = 10_000
"""The number of transforms of a link that are kept."""

MAX_FRAMES: Final = 10_000
"""The number of frames with a parent."""

SUPERSEDED: Final = 'superseded'
"""The reason for which a second transform of one valid time is dropped."""

_MAX_COMPARED: Final = 1000
"""The number of frames among which similar names are sought."""

_MAX_NAME: Final = 200
"""Longer names of frames are not compared: that takes quadratic time."""

_MAX_SHOWN: Final = 6
"""The number of frames of a chain that a message shows."""


@dataclass(frozen=True, slots=True)
class StampedTransform:
    """The transform `parent <- child` at a valid time in nanoseconds."""

    parent: str
    child: str
    valid_time: int
    transform: Transform


class RefusedTransformError(Exception):
    """A transform that cannot be used; `reason` is the word under which it is counted."""

    def __init__(self, message: str, reason: str = 'transform') -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(slots=True)
class Link:
    """The transforms of a frame in its parent, by valid time; a static one has one transform."""

    parent: str
    child: str
    is_static: bool
    times: list[int] = field(default_factory=list)
    transforms: list[Transform] = field(default_factory=list)

    def add(self, valid_time: int, transform: Transform) -> list[int]:
        """Add a transform; return the valid times that it displaces.

        Raises:
            RefusedTransformError: for a second transform with the same valid time.
        """
        if self.is_static:
            self.times[:], self.transforms[:] = [valid_time], [transform]
            return []
        index = bisect_left(self.times, valid_time)
        if index < len(self.times) and self.times[index] == valid_time:
            raise RefusedTransformError('there is one of that time', SUPERSEDED)
        self.times.insert(index, valid_time)
        self.transforms.insert(index, transform)
        oldest = self.times[-1] - MAX_AGE_NS
        surplus = max(bisect_left(self.times, oldest), len(self.times) - MAX_TRANSFORMS)
        forgotten = self.times[:surplus]
        del self.times[:surplus], self.transforms[:surplus]
        return forgotten

    def times_since(self, valid_time: int) -> list[int]:
        """Return the valid times from one on."""
        return self.times[bisect_left(self.times, valid_time) :]

    def at(self, valid_time: int) -> Transform:
        """Return the transform at a time at which the link holds."""
        if self.is_static:
            return self.transforms[0]
        index = bisect_left(self.times, valid_time)
        after = self.times[index]
        if after == valid_time:
            return self.transforms[index]
        before = self.times[index - 1]
        fraction = (valid_time - before) / (after - before)
        return self.transforms[index - 1].towards(self.transforms[index], fraction)


@dataclass(frozen=True, slots=True)
class Chain:
    """The links between two frames.

    Args:
        ascent: the links from the second frame up to the common parent.
        descent: the links from the first frame up to the common parent.
    """

    ascent: Sequence[Link]
    descent: Sequence[Link]

    @property
    def links(self) -> tuple[Link, ...]:
        """All links."""
        return (*self.ascent, *self.descent)

    @property
    def dynamic(self) -> tuple[Link, ...]:
        """The links that are not static."""
        return tuple(link for link in self.links if not link.is_static)

    def at(self, valid_time: int) -> Transform:
        """Return the transform of the second frame in the first, at a time at which all hold."""
        return _total(self.descent, valid_time).inverse().then(_total(self.ascent, valid_time))


class TransformTree:
    """Transforms of all frames, by child frame."""

    def __init__(self) -> None:
        self.version = 0
        """A number that changes with the links, but not with their transforms."""
        self._links: dict[str, Link] = {}

    def __bool__(self) -> bool:
        return bool(self._links)

    def add(self, stamped: StampedTransform, *, is_static: bool) -> list[int]:
        """Add a transform; return the valid times of its link that are forgotten for it.

        With another parent than before, the link begins again. So does one that becomes static or
        dynamic.

        Raises:
            RefusedTransformError: with the reason.
        """
        parent, child = stamped.parent, stamped.child
        link = self._links.get(child)
        forgotten: list[int] = []
        if link is None or (link.parent, link.is_static) != (parent, is_static):
            self._check_link(parent, child)
            forgotten = [] if link is None or link.is_static else link.times
            link = self._links[child] = Link(parent, child, is_static)
            self.version += 1
        return forgotten + link.add(stamped.valid_time, stamped.transform)

    def chain(self, target: str, source: str) -> Chain | None:
        """Return the chain between two frames; None if there is none."""
        descent, ascent = list(self._path(target)), list(self._path(source))
        heights = {frame: height for height, frame in enumerate(_frames(source, ascent))}
        for depth, frame in enumerate(_frames(target, descent)):
            if frame in heights:
                return Chain(ascent[: heights[frame]], descent[:depth])
        return None

    def obstacle(self, target: str, source: str) -> str:
        """Return why there is no chain between two frames."""
        known = {name for link in self._links.values() for name in (link.parent, link.child)}
        missing = [frame for frame in (target, source) if frame not in known]
        if missing:
            return '; '.join(
                f"no frame '{each}' in /tf or /tf_static{_hint(each, known)}" for each in missing
            )
        chains = ', '.join(map(self._chain_text, (target, source)))
        return f"the frames '{target}' and '{source}' have no common parent: {chains}"

    def _path(self, frame: str) -> Iterator[Link]:
        """Yield the links from a frame up."""
        while (link := self._links.get(frame)) is not None:
            yield link
            frame = link.parent

    def _check_link(self, parent: str, child: str) -> None:
        if not parent or not child:
            raise RefusedTransformError('it names no parent or no child frame')
        if child == parent or any(link.parent == child for link in self._path(parent)):
            raise RefusedTransformError('the frames would form a loop', 'loop')
        if child not in self._links and len(self._links) >= MAX_FRAMES:
            raise RefusedTransformError(f'there are more than {MAX_FRAMES} frames', 'buffer')

    def _chain_text(self, frame: str) -> str:
        frames = _frames(frame, self._path(frame))[::-1]
        if len(frames) > _MAX_SHOWN:
            frames[_MAX_SHOWN // 2 : 1 - _MAX_SHOWN // 2] = ['...']
        return ' <- '.join(frames)


def _frames(lowest: str, path: Iterable[Link]) -> list[str]:
    """Return the frames of a path, from the lowest up."""
    return [lowest, *(link.parent for link in path)]


def _total(links: Sequence[Link], valid_time: int) -> Transform:
    """Return the transform of the lowest frame in the highest."""
    return reduce(lambda inner, link: link.at(valid_time).then(inner), links, IDENTITY)


def _hint(frame: str, known: set[str]) -> str:
    names = sorted(each for each in known if len(each) <= _MAX_NAME)[:_MAX_COMPARED]
    near = get_close_matches(frame, names, n=1) if len(frame) <= _MAX_NAME else []
    return f"; did you mean '{near[0]}'?" if near else ''

"""Transforms between frames, compared with matrices: random trees, motions and orders."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from recorded_flow import Flow
from transform_messages import push_transforms, transform

pytestmark = pytest.mark.long

Matrix = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]
Pose = tuple[tuple[float, float, float], Quaternion]

FRAMES = ('a', 'b', 'c', 'd', 'e', 'f')


def rotation_matrix(quaternion: Sequence[float]) -> Matrix:
    x, y, z, w = quaternion
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    found: Matrix = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    return found


def matrix(translation: Sequence[float], rotation: Matrix) -> Matrix:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation, translation
    return found


def turned(start: Matrix, end: Matrix, fraction: float) -> Matrix:
    """Turn about the axis of the rotation between two rotations, by Rodrigues' formula."""
    between = start.T @ end
    angle = np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1))
    if angle < 1e-9:
        return start
    cross = (between - between.T) / (2 * np.sin(angle))
    part = angle * fraction
    found: Matrix = start @ (np.eye(3) + np.sin(part) * cross + (1 - np.cos(part)) * cross @ cross)
    return found


class ReferenceLink:
    """The poses of a frame in its parent by time; a static one has one pose, of any time."""

    def __init__(self, poses: dict[int, Pose], *, is_static: bool) -> None:
        self.poses = poses
        self.is_static = is_static

    def at(self, time: int) -> Matrix:
        times = sorted(self.poses)
        if self.is_static or time == times[0]:
            translation, rotation = self.poses[times[0]]
            return matrix(translation, rotation_matrix(rotation))
        after = next(each for each in times if each >= time)
        before = max(each for each in times if each < time)
        fraction = (time - before) / (after - before)
        (start, start_rotation), (end, end_rotation) = self.poses[before], self.poses[after]
        position = np.array(start) + (np.array(end) - np.array(start)) * fraction
        rotations = rotation_matrix(start_rotation), rotation_matrix(end_rotation)
        return matrix(position.tolist(), turned(*rotations, fraction))


def unit(parts: Sequence[float]) -> Quaternion:
    x, y, z, w = np.array(parts) / np.linalg.norm(parts)
    return float(x), float(y), float(z), float(w)


lengths = st.integers(-9, 9).map(float)
rotations = st.tuples(lengths, lengths, lengths, lengths).filter(any).map(unit)
poses = st.tuples(st.tuples(lengths, lengths, lengths), rotations)


def has_one_way(motion: dict[int, Pose]) -> bool:
    """Return False if a turn is by about 180 degrees: there are two ways then."""
    turns = [np.array(motion[time][1]) for time in sorted(motion)]
    return all(abs(a @ b) > 0.02 for a, b in pairwise(turns))


motions = st.dictionaries(st.integers(1, 40), poses, min_size=1, max_size=6).filter(has_one_way)


@st.composite
def trees(draw: st.DrawFn) -> dict[str, tuple[str, ReferenceLink]]:
    """The parent and the poses of each frame but the root, `a`."""
    tree = {}
    for number, child in enumerate(FRAMES[1:], 1):
        parent = FRAMES[draw(st.integers(0, number - 1))]
        found = draw(motions)
        is_static = draw(st.booleans())
        if is_static:
            found = dict([next(iter(found.items()))])
        tree[child] = parent, ReferenceLink(found, is_static=is_static)
    return tree


def ancestors(tree: dict[str, tuple[str, ReferenceLink]], frame: str) -> list[str]:
    return [frame, *ancestors(tree, tree[frame][0])] if frame in tree else [frame]


@given(trees(), st.permutations(FRAMES), st.randoms(use_true_random=False))
def test_every_sample_is_that_of_matrices(
    tree: dict[str, tuple[str, ReferenceLink]], frames: list[str], random: Random
) -> None:
    target, source = frames[:2]
    flow = Flow(max_lead=1000).create(f'tf("{target}", "{source}")')
    waiting = {child: sorted(link.poses) for child, (_, link) in tree.items() if not link.is_static}
    for child, (parent, link) in tree.items():
        if link.is_static:
            ((time, pose),) = link.poses.items()
            push_transforms(flow, 0, transform(parent, child, time, *pose), static=True)
    while any(waiting.values()):
        child = random.choice([each for each, times in waiting.items() if times])
        time = waiting[child].pop(0)
        parent, link = tree[child]
        push_transforms(flow, 1, transform(parent, child, time, *link.poses[time]))
    # The chain: the links below the lowest frame that both have above them.
    up, down = ancestors(tree, source), ancestors(tree, target)
    used = [child for child in {*up, *down} if (child in up) != (child in down)]
    dynamic = [tree[child][1] for child in used if not tree[child][1].is_static]
    samples = flow.take()
    if not dynamic:
        assert [time for time, _ in samples] == [0]
    else:
        first = max(min(link.poses) for link in dynamic)
        last = min(max(link.poses) for link in dynamic)
        times = {time for link in dynamic for time in link.poses if first <= time <= last}
        assert [time for time, _ in samples] == sorted(times)
    assert flow.drops == {}

    def in_root(frame: str, time: int) -> Matrix:
        if frame not in tree:
            return np.eye(4)
        parent, link = tree[frame]
        if frame not in used:  # It is above both frames, and need not be known.
            return np.eye(4)
        found: Matrix = in_root(parent, time) @ link.at(time)
        return found

    for time, fields in samples:
        expected = np.linalg.inv(in_root(target, int(time))) @ in_root(source, int(time))
        values = {name: float(value) for name, value in fields.items()}
        position = [values[f'translation.{axis}'] for axis in 'xyz']
        turn = rotation_matrix([values[f'rotation.{part}'] for part in 'xyzw'])
        assert position == pytest.approx(expected[:3, 3].tolist(), abs=1e-6)
        assert turn == pytest.approx(expected[:3, :3], abs=1e-6)
        assert values['distance'] == pytest.approx(np.linalg.norm(expected[:3, 3]), abs=1e-6)
        assert values['rotation.w'] >= 0
        if np.hypot(expected[0, 0], expected[1, 0]) > 1e-3:
            yaw = np.arctan2(expected[1, 0], expected[0, 0])
            assert np.cos(values['yaw'] - yaw) == pytest.approx(1)

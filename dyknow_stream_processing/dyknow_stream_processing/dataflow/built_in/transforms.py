"""Rigid transforms: composition, inversion and interpolation.

A transform of frame B in frame A, `A <- B`, gives the coordinates in A of a point that is known in
B: the point is rotated and then translated. `(A <- B).then(B <- C)` is `A <- C`.

Example: B is 1 m ahead of A and turned to the left by 90 degrees; C is 2 m ahead of B. So C is at
(1, 2, 0) in A, and has the same direction as B.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from dyknow_common import Value

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w; of length 1."""

NORM_TOLERANCE: Final = 1e-2
"""The deviation of the square of a quaternion's length from 1 that is accepted, as in tf2."""

_SMALL_ANGLE: Final = 1e-6
"""The angle, in rad, below which the sine is replaced by the angle."""


@dataclass(frozen=True, slots=True)
class Transform:
    """A rotation and then a translation in meters."""

    translation: Vector
    rotation: Quaternion

    def then(self, inner: Transform) -> Transform:
        """Return `A <- C`, given that this is `A <- B` and the inner one is `B <- C`."""
        x, y, z = self.translation
        dx, dy, dz = _rotated(self.rotation, inner.translation)
        rotation = _product(self.rotation, inner.rotation)
        return Transform((x + dx, y + dy, z + dz), rotation)

    def inverse(self) -> Transform:
        """Return `B <- A`, given that this is `A <- B`."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        dx, dy, dz = _rotated(back, self.translation)
        return Transform((-dx, -dy, -dz), back)

    def towards(self, other: Transform, fraction: float) -> Transform:
        """Return the transform between this (0) and another (1): linear, and slerp for rotations.

        It takes the shorter of the two ways from one rotation to the other.
        """
        start, end = self.translation, other.translation
        x, y, z = (a + (b - a) * fraction for a, b in zip(start, end, strict=True))
        return Transform((x, y, z), _slerp(self.rotation, other.rotation, fraction))

    def fields(self) -> Mapping[str, Value]:
        """Return the fields of a sample; of the two equal quaternions, the one with w >= 0."""
        (x, y, z), quaternion = self.translation, self.rotation
        qx, qy, qz, qw = quaternion if quaternion[3] >= 0 else (-part for part in quaternion)
        return {
            'translation.x': x,
            'translation.y': y,
            'translation.z': z,
            'rotation.x': qx,
            'rotation.y': qy,
            'rotation.z': qz,
            'rotation.w': qw,
            'yaw': math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)),
            'distance': math.hypot(x, y, z),
        }


IDENTITY: Final = Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def checked_transform(translation: Vector, rotation: Quaternion) -> Transform:
    """Return a transform as a message gives it, with its rotation normalised.

    Raises:
        ValueError: if a number is not finite, or the rotation far from normalised.
    """
    if not all(map(math.isfinite, (*translation, *rotation))):
        raise ValueError('it has a number that is not finite')
    square = sum(part * part for part in rotation)
    if abs(square - 1) > NORM_TOLERANCE:
        raise ValueError(f'its rotation is not normalised: its length is {math.sqrt(square):.3g}')
    length = math.sqrt(square)
    x, y, z, w = (part / length for part in rotation)
    return Transform(translation, (x, y, z, w))


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _rotated(rotation: Quaternion, vector: Vector) -> Vector:
    x, y, z, w = rotation
    vx, vy, vz = vector
    # v + 2w (q x v) + 2 q x (q x v), where q is the vector part of the quaternion.
    cx, cy, cz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (
        vx + w * cx + y * cz - z * cy,
        vy + w * cy + z * cx - x * cz,
        vz + w * cz + x * cy - y * cx,
    )


def _slerp(start: Quaternion, end: Quaternion, fraction: float) -> Quaternion:
    cosine = math.fsum(a * b for a, b in zip(start, end, strict=True))
    if cosine < 0:
        cosine, end = -cosine, (-end[0], -end[1], -end[2], -end[3])
    angle = math.acos(min(cosine, 1.0))
    before, after = 1 - fraction, fraction
    if angle > _SMALL_ANGLE:
        sine = math.sin(angle)
        before, after = math.sin(before * angle) / sine, math.sin(after * angle) / sine
    x, y, z, w = (before * a + after * b for a, b in zip(start, end, strict=True))
    length = math.hypot(x, y, z, w)
    return x / length, y / length, z / length, w / length

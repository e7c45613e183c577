"""Formulas in a three-dimensional view: fences, regions, lines between vehicles, and texts.

Fences are bounds on the positions of objects:
`always (East[u] > -30 and East[u] < 60)` bounds x, and leaves y and z open. A view draws an open
side at a multiple of `GRID` beyond all vehicles.
"""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import lru_cache
from itertools import combinations, product
from math import inf
from typing import Final

from dyknow_common import MIRRORED_COMPARISONS, ORDERS, SECOND_NS, ExitCode, LanguageError, Verdict
from dyknow_coordinator import (
    SILENCE_LIMIT_NS,
    EvaluationStatus,
    Level,
    SymbolGrounding,
    diagnose,
)
from dyknow_reasoning import (
    Always,
    And,
    Comparison,
    Feature,
    Forall,
    Formula,
    Number,
    parse_formula,
)
from dyknow_space import Region

Point = tuple[float, float, float]
"""Coordinates or lengths along x, y and z."""

Axes = tuple[str, str, str]
"""The features that are the x, y and z of a vehicle."""

DEFAULT_AXES: Final[Axes] = ('East', 'North', 'Altitude')

ODOMETRY: Final = '<vehicle>/odometry'
"""The topic with the positions of a vehicle."""

PERIOD_NS: Final = SECOND_NS // 5
"""Time between two sets of markers."""

LIFETIME_NS: Final = SECOND_NS
"""Viewers remove markers that are not published again within this time."""

GRID: Final = 10.0
"""In m; an open side stays at the same multiple while the vehicles move less."""


Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, from 0 to 1."""

COLOURS: Final[dict[Level, Colour]] = {
    Level.OK: (0.1, 0.8, 0.2, 1.0),
    Level.WARN: (1.0, 0.8, 0.0, 1.0),
    Level.ERROR: (1.0, 0.1, 0.1, 1.0),
}
NOT_RESPONSIBLE: Final[Colour] = (0.6, 0.6, 0.6, 0.5)
"""The colour of ground features that did not make a formula false."""

_PAIR = 2
_OPACITY = 0.1
_LINE = (0.2, 0.0, 0.0)
_EDGE = (0.1, 0.0, 0.0)
_TEXT_HEIGHT = 1.0
_TEXT_COLUMNS = 60
_ABOVE = 3.0
_LINE_SPACING = 1.3
_GROUND_FEATURE = re.compile(r"""[A-Za-z_]\w*'*\[([^\[\]"]+)\]""", re.ASCII)


class MarkerShape(IntEnum):
    """The shape of a marker; numbers as in visualization_msgs/msg/Marker."""

    BOX = 1
    LINES = 5
    TEXT = 9


@dataclass(frozen=True, slots=True)
class Marker:
    """A shape to draw; lengths are in m.

    Args:
        name: the name of the formula.
        number: unique among the markers with the same name.
        position: the position of the centre of a box or of a text.
        scale: the size of a box; the width of lines as x; the height of a text as z.
        points: the ends of lines, two for each line.
    """

    name: str
    shape: MarkerShape
    colour: Colour
    number: int = 0
    position: Point = (0.0, 0.0, 0.0)
    scale: Point = (0.0, 0.0, 0.0)
    points: tuple[Point, ...] = ()
    text: str = ''


def formula_markers(
    statuses: Iterable[EvaluationStatus],
    positions: Mapping[str, Point],
    axes: Axes,
    now: int,
    regions: Iterable[Region] = (),
    frame: str = '',
) -> tuple[Marker, ...]:
    """Return the markers of all formulas; a cancelled formula has none.

    Args:
        statuses: the statuses of the evaluations.
        positions: the positions of the vehicles, by their names.
        axes: the features that are the x, y and z of a vehicle.
        now: the time, nanoseconds.
        regions: to draw; regions of other frames are left out.
        frame: the frame of the positions.
    """
    drawable = {each.name: each for each in regions if each.frame == frame}
    numbers: Counter[str] = Counter()
    markers: list[Marker] = []
    lines_of_text = 0
    for status in statuses:
        if status.error is not None and status.error.code is ExitCode.CANCELLED:
            continue
        diagnosis = diagnose(status, now, SILENCE_LIMIT_NS)
        colour = COLOURS[diagnosis.level]
        text = _text(status, diagnosis.text)
        drawn = [
            *_fences(status, positions, axes, colour),
            *_regions(status, drawable, colour),
            *_pairs(status, positions, colour),
            *_label(status, positions, text, lines_of_text, colour),
        ]
        lines_of_text += text.count('\n') + 2
        for marker in drawn:
            markers.append(replace(marker, number=numbers[status.name]))
            numbers[status.name] += 1
    return tuple(markers)


def objects_of(groundings: Iterable[SymbolGrounding]) -> frozenset[str]:
    """Return the arguments of ground features: uav1 and uav2 for `XYDist[uav1, uav2]`."""
    return frozenset(name for each in groundings for name in _arguments(each.symbol))


def _arguments(symbol: str) -> tuple[str, ...]:
    match = _GROUND_FEATURE.fullmatch(symbol)
    return () if match is None else tuple(match[1].split(', '))


def _fences(
    status: EvaluationStatus, positions: Mapping[str, Point], axes: Axes, colour: Colour
) -> Iterator[Marker]:
    for fence in fences(status.formula, axes):
        box = closed(fence, positions.values())
        if box is not None:
            faint = (*colour[:3], _OPACITY)
            yield Marker(status.name, MarkerShape.BOX, faint, position=box.centre, scale=box.size)
            yield Marker(status.name, MarkerShape.LINES, colour, scale=_EDGE, points=box.edges)


def _regions(
    status: EvaluationStatus, regions: Mapping[str, Region], colour: Colour
) -> Iterator[Marker]:
    """Yield the edges of each region that the ground features are about."""
    responsible = {name for symbol in _responsible(status) for name in _arguments(symbol)}
    for name in sorted(objects_of(status.groundings) & regions.keys()):
        yield Marker(
            status.name,
            MarkerShape.LINES,
            colour if name in responsible else NOT_RESPONSIBLE,
            scale=_EDGE,
            points=tuple(regions[name].edges()),
        )


def _responsible(status: EvaluationStatus) -> list[str]:
    """Return the ground features that a false formula's explanation names; otherwise all."""
    symbols = [each.symbol for each in status.groundings]
    named = [symbol for symbol in symbols if _is_named(symbol, status.explanation)]
    return named if status.verdict is Verdict.FALSE and named else symbols


def _is_named(symbol: str, text: str) -> bool:
    """Return True if a text has a ground feature that is not a part of a longer name."""
    alone = rf"""(?<![\w:."]){re.escape(symbol)}(?![\w'\[]|\.\w)"""
    return re.search(alone, text, re.ASCII) is not None


def _pairs(
    status: EvaluationStatus, positions: Mapping[str, Point], colour: Colour
) -> Iterator[Marker]:
    """Yield a line for each ground feature of two vehicles."""
    responsible = _responsible(status)
    for symbol in (each.symbol for each in status.groundings):
        arguments = _arguments(symbol)
        ends = tuple(positions[name] for name in arguments if name in positions)
        if len(arguments) == len(ends) == _PAIR:
            line_colour = colour if symbol in responsible else NOT_RESPONSIBLE
            yield Marker(status.name, MarkerShape.LINES, line_colour, scale=_LINE, points=ends)


def _label(
    status: EvaluationStatus,
    positions: Mapping[str, Point],
    text: str,
    lines_below: int,
    colour: Colour,
) -> Iterator[Marker]:
    """Yield a text above all vehicles and above the texts of other formulas."""
    about = [positions[name] for name in objects_of(status.groundings) & positions.keys()]
    if not about:
        return
    x, y = (sum(position[axis] for position in about) / len(about) for axis in (0, 1))
    top = max(position[2] for position in positions.values()) + _ABOVE
    height = (lines_below + text.count('\n') / 2) * _TEXT_HEIGHT * _LINE_SPACING
    yield Marker(
        status.name,
        MarkerShape.TEXT,
        colour,
        position=(x, y, top + height),
        scale=(0.0, 0.0, _TEXT_HEIGHT),
        text=text,
    )


def _text(status: EvaluationStatus, diagnosis: str) -> str:
    """Return the name of a formula, its diagnosis, and its text if that is not its name."""
    lines = [f'{status.name}: {diagnosis}']
    if status.text != status.name:
        lines.append(status.text)
    return '\n'.join(textwrap.fill(line, _TEXT_COLUMNS) for line in lines)


@dataclass(frozen=True, slots=True)
class Fence:
    """A box that objects must not leave.

    Args:
        low: the smallest x, y and z, in m; infinite where it is open.
        high: the largest x, y and z, likewise.
    """

    low: Point
    high: Point

    @property
    def centre(self) -> Point:
        """The centre of the box."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        return (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2

    @property
    def size(self) -> Point:
        """The lengths of the box along the axes."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        return x1 - x0, y1 - y0, z1 - z0

    @property
    def edges(self) -> tuple[Point, ...]:
        """The ends of the edges of the box, two for each edge."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        corners = tuple(product((x0, x1), (y0, y1), (z0, z1)))
        return tuple(
            end
            for one, other in combinations(corners, 2)
            if sum(a != b for a, b in zip(one, other, strict=True)) == 1
            for end in (one, other)
        )


@lru_cache(maxsize=1024)
def fences(formula: str, axes: tuple[str, str, str]) -> tuple[Fence, ...]:
    """Return the fences of a formula: one for each variable or object with bounds on its position.

    Args:
        formula: its text; an invalid formula has no fences.
        axes: the features that are the x, y and z of an object.
    """
    try:
        parsed = parse_formula(formula)
    except LanguageError:
        return ()
    found: dict[str, tuple[list[float], list[float]]] = {}
    for feature, operator, value in _limits(parsed):
        if feature.name in axes and len(feature.arguments) == 1:
            low, high = found.setdefault(str(feature.arguments[0]), ([-inf] * 3, [inf] * 3))
            axis = axes.index(feature.name)
            if operator in {'<', '<='}:
                high[axis] = min(high[axis], value)
            else:
                low[axis] = max(low[axis], value)
    return tuple(Fence(_point(low), _point(high)) for low, high in found.values())


def closed(fence: Fence, positions: Collection[Point]) -> Fence | None:
    """Return a fence whose open sides are closed beyond all positions.

    Return None if it is open and there are no positions, or if nothing can be inside.
    """
    low, high = list(fence.low), list(fence.high)
    for axis in range(3):
        along = [position[axis] for position in positions]
        if along and low[axis] == -inf:
            low[axis] = (round(min(*along, high[axis]) / GRID) - 1) * GRID
        if along and high[axis] == inf:
            high[axis] = (round(max(*along, low[axis]) / GRID) + 1) * GRID
        if not -inf < low[axis] < high[axis] < inf:
            return None
    return Fence(_point(low), _point(high))


def _point(coordinates: list[float]) -> Point:
    x, y, z = coordinates
    return x, y, z


def _limits(formula: Formula) -> Iterator[tuple[Feature, str, float]]:
    """Yield the comparisons of features with numbers that must hold at every state."""
    match formula:
        case Forall() | Always():
            yield from _limits(formula.body)
        case And():
            yield from _limits(formula.left)
            yield from _limits(formula.right)
        case Comparison(operator, Feature() as feature, Number(value)) if operator in ORDERS:
            yield feature, operator, float(value)
        case Comparison(operator, Number(value), Feature() as feature) if operator in ORDERS:
            yield feature, MIRRORED_COMPARISONS[operator], float(value)

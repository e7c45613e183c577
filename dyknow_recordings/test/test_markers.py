"""Markers of formulas."""

from dataclasses import replace

import pytest

from dyknow_common import ExitCode, Verdict
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    Level,
    SymbolGrounding,
)
from dyknow_recordings.markers import (
    COLOURS,
    NOT_RESPONSIBLE,
    Marker,
    MarkerShape,
    formula_markers,
    objects_of,
)
from dyknow_space import Region, geometry_of

TRIANGLE = 'POLYGON ((0 0, 4 0, 4 3, 0 0))'
AXES = ('East', 'North', 'Altitude')
SECOND = 1_000_000_000
NOW = 100 * SECOND
POSITIONS = {'uav1': (0.0, 0.0, 10.0), 'uav2': (20.0, 0.0, 12.0), 'uav3': (40.0, 0.0, 5.0)}


def grounded(*symbols: str) -> tuple[SymbolGrounding, ...]:
    return tuple(SymbolGrounding(symbol, Grounding.SEMANTIC, 's') for symbol in symbols)


SEPARATION = EvaluationStatus(
    'separation',
    'forall x in UAV: ((x != uav1) -> (always (XYDist[x, uav1] > 10)))',
    EvaluationPhase.RUNNING,
    started=NOW - SECOND,
    latest_valid_time=NOW,
    groundings=grounded('XYDist[uav2, uav1]', 'XYDist[uav3, uav1]'),
)
CEILING = EvaluationStatus(
    'ceiling',
    'forall u in UAV: (always (Altitude[u] < 30))',
    EvaluationPhase.RUNNING,
    started=NOW - SECOND,
    latest_valid_time=NOW,
    groundings=grounded('Altitude[uav1]', 'Altitude[uav2]', 'Altitude[uav3]'),
)


def draw(*statuses: EvaluationStatus, shape: MarkerShape | None = None) -> list[Marker]:
    drawn = formula_markers(statuses, POSITIONS, AXES, NOW)
    return [marker for marker in drawn if shape in (None, marker.shape)]


def test_a_line_between_each_pair() -> None:
    lines = draw(SEPARATION, shape=MarkerShape.LINES)
    assert [line.points for line in lines] == [
        (POSITIONS['uav2'], POSITIONS['uav1']),
        (POSITIONS['uav3'], POSITIONS['uav1']),
    ]
    assert {line.colour for line in lines} == {COLOURS[Level.OK]}


@pytest.mark.parametrize(
    ('changes', 'level'),
    [
        ({'presumably_false': True}, Level.WARN),
        ({'phase': EvaluationPhase.INTERRUPTED}, Level.WARN),
        ({'latest_valid_time': NOW - 60 * SECOND}, Level.WARN),
        ({'latest_valid_time': None}, Level.WARN),
        ({'phase': EvaluationPhase.ENDED, 'verdict': Verdict.TRUE}, Level.OK),
        ({'phase': EvaluationPhase.ENDED, 'verdict': Verdict.FALSE}, Level.ERROR),
        (
            {
                'phase': EvaluationPhase.ENDED,
                'error': CoordinationError('gone', ExitCode.UNAVAILABLE),
            },
            Level.ERROR,
        ),
    ],
)
def test_colours_show_the_diagnosis(changes: dict[str, object], level: Level) -> None:
    lines = draw(replace(SEPARATION, **changes), shape=MarkerShape.LINES)  # type: ignore[arg-type]
    assert {line.colour for line in lines} == {COLOURS[level]}


def test_the_responsible_pair_has_its_own_colour() -> None:
    broken = replace(
        SEPARATION,
        phase=EvaluationPhase.ENDED,
        verdict=Verdict.FALSE,
        explanation='for x = uav3: XYDist[uav3, uav1] = 9.5 at 12.000 s is not > 10',
    )
    colours = [line.colour for line in draw(broken, shape=MarkerShape.LINES)]
    assert colours == [NOT_RESPONSIBLE, COLOURS[Level.ERROR]]


def colours_of_pairs(*symbols: str, explanation: str) -> list[object]:
    status = replace(
        SEPARATION,
        groundings=grounded(*symbols),
        phase=EvaluationPhase.ENDED,
        verdict=Verdict.FALSE,
        explanation=explanation,
    )
    return [line.colour for line in draw(status, shape=MarkerShape.LINES)]


@pytest.mark.parametrize('other', ['XYDist', 'robot2:Dist', 'a.Dist'])
def test_a_name_in_a_longer_one_is_not_responsible(other: str) -> None:
    third = 'XYDist[uav3, uav1]'
    explanation = f'{other}[uav2, uav1] = 9.5 at 12.000 s is not > 10; {third} = 1'
    found = colours_of_pairs('Dist[uav2, uav1]', third, explanation=explanation)
    assert found == [NOT_RESPONSIBLE, COLOURS[Level.ERROR]]


@pytest.mark.parametrize('form', ['{}', '({}) + 1', 'for x = uav1: {}.', '-{}', 'abs({}), 2'])
def test_a_name_in_an_expression_is_responsible(form: str) -> None:
    symbols = 'Dist[uav2, uav1]', "Dist'[uav2, uav1]"
    for number, each in enumerate(symbols):
        found = colours_of_pairs(*symbols, explanation=form.format(each))
        assert found[number] == COLOURS[Level.ERROR]
        assert found[1 - number] == NOT_RESPONSIBLE


def test_a_fence_is_a_box_with_edges() -> None:
    box, edges = draw(CEILING)[:2]
    assert (box.shape, edges.shape) == (MarkerShape.BOX, MarkerShape.LINES)
    assert box.colour[:3] == edges.colour[:3]
    assert box.colour[3] < edges.colour[3]
    assert box.position[2] + box.scale[2] / 2 == 30
    assert len(edges.points) == 24


def test_the_regions_of_a_formula_have_edges() -> None:
    zones = (
        Region('pit', (), 'map', geometry_of(TRIANGLE)),
        Region('hall', (), 'map', geometry_of(TRIANGLE), (0.0, 2.5)),
        Region('roof', (), 'map', geometry_of(TRIANGLE)),
    )
    inside = replace(
        CEILING,
        groundings=grounded('distance[uav1, pit]', 'distance[uav1, hall]'),
        phase=EvaluationPhase.ENDED,
        verdict=Verdict.FALSE,
        explanation='distance[uav1, hall] = 1 is not <= 0',
    )
    hall, pit = [
        each
        for each in formula_markers([inside], POSITIONS, ('E', 'N', 'A'), NOW, zones, 'map')
        if each.shape is MarkerShape.LINES
    ]
    assert (hall.colour, pit.colour) == (COLOURS[Level.ERROR], NOT_RESPONSIBLE)
    assert pit.points == (
        *((0, 0, 0), (4, 0, 0)), *((4, 0, 0), (4, 3, 0)), *((4, 3, 0), (0, 0, 0)),
    )  # fmt: skip
    assert len(hall.points) == 3 * len(pit.points)
    assert {z for _, _, z in hall.points} == {0.0, 2.5}


def test_texts_have_name_and_reason_and_do_not_overlap() -> None:
    broken = replace(
        CEILING, phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE, explanation='31 is not < 30'
    )
    low, high = draw(broken, SEPARATION, shape=MarkerShape.TEXT)
    assert low.text == 'ceiling: false: 31 is not < 30\n' + CEILING.formula
    assert low.position[:2] == (20.0, 0.0)
    assert max(position[2] for position in POSITIONS.values()) < low.position[2]
    assert low.position[2] + 2 < high.position[2]


def test_a_formula_without_a_name_is_written_once() -> None:
    (text,) = draw(replace(CEILING, name=CEILING.formula), shape=MarkerShape.TEXT)
    assert ''.join(text.text.split()).count('Altitude[u]<30') == 1


def test_markers_have_distinct_numbers() -> None:
    drawn = draw(SEPARATION, CEILING, CEILING)
    assert len({(marker.name, marker.number) for marker in drawn}) == len(drawn)


def test_formulas_without_positions_are_not_drawn() -> None:
    cancelled = CoordinationError('cancelled', ExitCode.CANCELLED)
    assert not draw(replace(CEILING, phase=EvaluationPhase.ENDED, error=cancelled))
    assert not formula_markers([SEPARATION, CEILING], {}, AXES, NOW)
    alone = formula_markers([SEPARATION], {'uav2': POSITIONS['uav2']}, AXES, NOW)
    assert [marker.shape for marker in alone] == [MarkerShape.TEXT]


def test_the_objects_of_ground_features() -> None:
    references = 'Wind', '"/a".ranges[0]', 'a.ranges[0]'
    found = objects_of(grounded('XYDist[uav2, uav1]', 'Z[robot2:scout]', *references))
    assert found == {'uav1', 'uav2', 'robot2:scout'}

"""The map of a running system: what it shows of each formula, and when it stays as it is."""

from __future__ import annotations

from dataclasses import replace

from served import drawn
from test_board import messages, opened

from dyknow_common import SECOND_NS, Verdict
from dyknow_configuration import RobotMap
from dyknow_coordinator import (
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    StandingVerdicts,
    SymbolGrounding,
    ViolationEpisode,
)
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.live_map import MAX_POSITIONS, MapSample
from dyknow_space import Region, geometry_of

DOCK = Region('dock', (), 'map', geometry_of('POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0))'))
POSITIONS = {name: f'stream position = select x, y from "/{name}/pose"' for name in ('r1', 'r2')}
KNOWN = RobotMap(
    'map', (DOCK,), POSITIONS, {'cell': 'stream outline = select outline from "/cell"'}
)
RUNNING = EvaluationStatus(
    'out',
    'forall r in Robot, z in KeepOut: always not inside(r, z)',
    EvaluationPhase.RUNNING,
    started=10 * SECOND_NS,
    groundings=(SymbolGrounding('distance[r1, dock]', Grounding.SEMANTIC, ''),),
    latest_valid_time=20 * SECOND_NS,
)
FALSE = replace(
    RUNNING,
    phase=EvaluationPhase.ENDED,
    verdict=Verdict.FALSE,
    decided_at=13 * SECOND_NS,
    explanation='for r = r1, z = dock: at 3.000 s, distance[r1, dock] = -1',
)


def place(name: str, time: int, x: float, y: float) -> MapSample:
    return name, time, {'x': x, 'y': y}


def board_of(status: EvaluationStatus = RUNNING) -> Board:
    """A board on whose map r1 drives one metre a second, from 10 s on."""
    board = Board(lambda: 0, known=KNOWN)
    board.report([status], 10 * SECOND_NS)
    board.map.add(place('r1', t * SECOND_NS, float(t), 1.0) for t in range(10, 21))
    return board


def shown(board: Board, status: EvaluationStatus) -> tuple[str | None, int, list[str]]:
    """The class of the region, the length of the track, and the places of failures."""
    (key,) = board.formulas.by_key()
    image = drawn(board.map.image(key, status))
    (region,) = image.findall('path')
    points = [len(each.get('points', '').split()) for each in image.findall('polyline')]
    failures = [each for each in image.findall('circle') if each.get('class') is None]
    titles = [f'{each.findtext("title")}, x = {each.get("cx")}' for each in failures]
    return region.get('class'), sum(points), titles


def test_positions_are_read_of_objects_that_running_formulas_are_about() -> None:
    board = board_of()
    assert board.map.streams == {'r1': POSITIONS['r1']}
    board.map.add([place('r2', 1, 0.0, 0.0), place('r1', 15 * SECOND_NS, 99.0, 99.0)])
    assert shown(board, RUNNING) == ('is-undecided', 11, [])
    board.map.add(place('r1', t * SECOND_NS, 1.0, 1.0) for t in range(30, 30 + MAX_POSITIONS))
    assert shown(board, RUNNING)[1] == MAX_POSITIONS
    board.report([FALSE], 30 * SECOND_NS)
    assert board.map.streams == {}


def test_the_map_of_an_ended_formula_is_that_of_its_end() -> None:
    board = board_of()
    board.report([FALSE], 21 * SECOND_NS)
    failed = 'is-false', 11, ['out: r1 at 3.000 s, x = 13']
    assert shown(board, FALSE) == failed
    other = replace(RUNNING, name='other')
    board.report([FALSE, other], 21 * SECOND_NS)
    board.map.add([place('r1', 22 * SECOND_NS, 50.0, 50.0)])
    first, _ = board.formulas.by_key()
    assert len(drawn(board.map.image(first, FALSE)).findall('polyline')) == 1
    late = Board(lambda: 0, known=KNOWN)
    late.report([FALSE], 21 * SECOND_NS)
    assert shown(late, FALSE) == ('is-false', 0, []), 'nobody has seen where it was'


def test_the_positions_at_the_end_of_a_formula_are_waited_for() -> None:
    """The verdict may come before the sample that decided it."""
    board = board_of()
    reason = 'for r = r1, z = dock: at 12.000 s, distance[r1, dock] = -1'
    ended = replace(FALSE, decided_at=22 * SECOND_NS, explanation=reason)
    board.report([ended], 22 * SECOND_NS)
    board.map.add([place('r1', 22 * SECOND_NS, 50.0, 1.0)])
    board.report([ended], 23 * SECOND_NS)
    board.map.add([place('r1', 23 * SECOND_NS, 70.0, 1.0)])
    assert shown(board, ended) == ('is-false', 12, ['out: r1 at 12.000 s, x = 50'])
    silent = board_of()
    silent.report([ended], 22 * SECOND_NS)
    assert silent.map.streams
    silent.report([ended], 26 * SECOND_NS)
    assert not silent.map.streams


def test_a_standing_formula_shows_failures_of_the_last_two_minutes() -> None:
    reason = 'for r = r1, z = dock: too near'
    seconds = (12 * SECOND_NS, 13 * SECOND_NS, 12 * SECOND_NS)
    episode = ViolationEpisode(*seconds, states=2, has_ended=True, explanation=reason)
    verdicts = StandingVerdicts(holds=3, fails=2, episode_count=1, latest_episodes=(episode,))
    again = replace(RUNNING, episodes=verdicts)
    assert shown(board_of(again), again) == ('is-false', 11, ['out: r1 at 2.000 s, x = 12'])
    later = replace(again, latest_valid_time=200 * SECOND_NS)
    assert shown(board_of(later), later) == ('is-true', 11, [])
    lasting = replace(
        later, episodes=replace(verdicts, latest_episodes=(replace(episode, has_ended=False),))
    )
    assert shown(board_of(lasting), lasting)[0] == 'is-false'


def test_a_page_gets_the_map_of_an_opened_formula_when_it_has_changed() -> None:
    board = board_of()
    page = opened(board)
    assert 'dock: undecided' in messages(board, page)['map']['image']
    board.report([RUNNING], 22 * SECOND_NS)
    assert 'map' not in messages(board, page)
    board.map.add([place('r1', 23 * SECOND_NS, 1.0, 1.0)])
    board.report([RUNNING], 23 * SECOND_NS)
    assert 'map' in messages(board, page)
    about_others = replace(RUNNING, groundings=())
    board.report([about_others], 24 * SECOND_NS)
    assert messages(board, page)['map']['image'] == ''


def test_a_region_that_moves_is_drawn_at_the_failure_and_lately() -> None:
    about = (*RUNNING.groundings, SymbolGrounding('distance[r1, cell]', Grounding.SEMANTIC, ''))
    running = replace(RUNNING, groundings=about)
    board = board_of(running)
    for second in range(10, 21):
        outline = f'POLYGON (({second} 5, {second + 1} 5, {second} 6, {second} 5))'
        board.map.add([('cell', second * SECOND_NS, {'outline': outline})])
    (key,) = board.formulas.by_key()
    titles = ['dock: undecided', 'cell at 10.000 s: undecided']
    assert titles_of(board.map.image(key, running)) == titles
    explanation = 'for r = r1, z = cell: at 3.000 s, distance[r1, cell] = -1'
    failed = replace(FALSE, groundings=about, explanation=explanation)
    titles = ['dock', 'cell at 3.000 s: false', 'cell at 10.000 s']
    assert titles_of(board.map.image(key, failed)) == titles


def test_an_outline_that_cannot_be_drawn_is_left_out() -> None:
    """Any program may publish it: drawing must end."""
    about = (*RUNNING.groundings, SymbolGrounding('distance[r1, cell]', Grounding.SEMANTIC, ''))
    running = replace(RUNNING, groundings=about)
    board = board_of(running)
    (key,) = board.formulas.by_key()
    wrong = (
        '',
        'POINT (1 1)',
        'POLYGON ((0 0, 2 2, 0 2, 2 0, 0 0))',
        'POLYGON ((0 0, nan 1, 1 1))',
    )
    huge = 'POLYGON ((0 0, 1e308 0, -1e308 5, 0 0))'
    for second, outline in enumerate((*wrong, huge), 20):
        board.map.add([('cell', second * SECOND_NS, {'outline': outline})])
        assert titles_of(board.map.image(key, running)) == ['dock: undecided']


def titles_of(image: str) -> list[str | None]:
    return [each.findtext('title') for each in drawn(image).findall('path')]


def test_without_a_robot_there_is_no_map() -> None:
    board = Board(lambda: 0)
    board.report([RUNNING], 10 * SECOND_NS)
    assert 'map' not in messages(board, opened(board))


def test_a_track_begins_anew_when_simulated_time_is_set_back() -> None:
    board = board_of(FALSE)
    assert shown(board, FALSE)[1] == 11
    again = replace(RUNNING, started=2 * SECOND_NS, latest_valid_time=3 * SECOND_NS)
    board.report([FALSE, again], 3 * SECOND_NS)
    board.map.add([place('r1', t * SECOND_NS, 1.0, 1.0) for t in (3, 4)])
    old, new = board.formulas.by_key().items()
    lengths = []
    for key, status in sorted([old, new], key=lambda each: each[1].started):
        tracks = drawn(board.map.image(key, status)).findall('polyline')
        lengths.append(sum(len(each.get('points', '').split()) for each in tracks))
    assert lengths == [2, 11]

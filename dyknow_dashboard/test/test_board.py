"""The contents of the page, and what each page lacks of them."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Margin, ProbabilityInterval, Verdict
from dyknow_coordinator import (
    EvaluationPhase,
    EvaluationStatus,
    Grounding,
    Level,
    StandingVerdicts,
    SymbolGrounding,
    ViolationEpisode,
)
from dyknow_coordinator.reporting.node_status import NodeState
from dyknow_dashboard.model.board import MAX_KEPT, MAX_KEPT_SIGNALS, Board, PageState
from dyknow_dashboard.model.formulas import MAX_ENDED, MAX_MARGINS, MAX_SHOWN
from dyknow_dashboard.model.health import STALE_NS, DiagnosedPart, HealthTable, NodeHealth
from dyknow_dashboard.model.metrics import metrics_of
from dyknow_dashboard.model.requests import Interest
from dyknow_dashboard.model.streams import MAX_NODES, graph, source_of
from dyknow_stream_processing.reporting.stream_report import (
    Flow,
    SourceReport,
    StreamReport,
    StreamState,
)

GRAFANA = Path(__file__).parents[2] / 'docs' / 'examples' / 'grafana.json'

GROUNDING = SymbolGrounding(
    'Power[uav1]',
    Grounding.SEMANTIC,
    'select power as "Power[uav1]" from uav1_power',
    ('select power as "Power[uav1]" from spare where id = "uav1"',),
)
POWER = EvaluationStatus(
    'power',
    'always (uav1_power.power < 5)',
    EvaluationPhase.RUNNING,
    started=10 * SECOND_NS,
    state_stream='/dyknow/streams/_states_1',
    groundings=(GROUNDING,),
    topics=('/uav1/battery',),
    states_progressed=5,
    latest_valid_time=20 * SECOND_NS,
)
BATTERY = SourceReport(
    '/uav1/battery', 80, 9, 3_000_000, rate=19.96, drops={'lost': 2, 'message': 1}
)
STREAMS = (
    StreamReport(
        '_states_1', StreamState.FLOWING, topic='/dyknow/streams/_states_1', specification='...'
    ),
    StreamReport('spare', StreamState.WAITING, 'nobody publishes /spare', topic='/spare_power'),
    StreamReport(
        'uav1_power',
        StreamState.FLOWING,
        topic='/dyknow/streams/uav1_power',
        drops={'max_delay': 2, 'fields': 1},
        violations=3,
        sources=(BATTERY,),
        flow=Flow(19.96, 3_000_000, 9_000_000),
    ),
)


def board_of(*statuses: EvaluationStatus) -> Board:
    board = Board(lambda: 0)
    board.formulas.update(statuses, 21 * SECOND_NS)
    return board


def messages(board: Board, page: PageState) -> dict[str, dict[str, Any]]:
    found = list(board.changes(page))
    json.dumps(found, allow_nan=False)
    return {each['type']: each for each in found}


def opened(board: Board) -> PageState:
    (row,) = board.formulas.rows()
    page = PageState(Interest('formulas', (row['id'],)))
    board.state_topics([page])
    return page


def test_metrics() -> None:
    verdicts = StandingVerdicts(holds=3, fails=2, is_violated=True, episode_count=4)
    slow = replace(POWER, name='slow', episodes=verdicts, margin=Margin(-1.5, math.inf))
    older = replace(POWER, started=1, states_progressed=1)
    board = board_of(POWER, slow, older)
    board.streams.update(STREAMS, ['/engine'])
    gone = NodeHealth('/manager', NodeState(False, Level.OK, 'running', 7 * SECOND_NS))
    board.health.update([gone, NodeHealth('/new', NodeState(absent=SECOND_NS))], 0)
    lines = metrics_of(board).decode().splitlines()
    for expected in (
        'dyknow_formula_failing{formula="power"} 0.0',
        'dyknow_formula_failing{formula="slow"} 1.0',
        'dyknow_formula_state{formula="slow",state="violated"} 1.0',
        'dyknow_formula_states_total{formula="power"} 5.0',
        'dyknow_formula_episodes_total{formula="slow"} 4.0',
        'dyknow_formula_margin{bound="lower",formula="slow"} -1.5',
        'dyknow_stream_flowing{stream="spare"} 0.0',
        'dyknow_stream_rate_hertz{stream="uav1_power"} 19.96',
        'dyknow_stream_delay_seconds{stream="uav1_power"} 0.003',
        'dyknow_stream_drops_total{reason="max_delay",stream="uav1_power"} 2.0',
        'dyknow_stream_violations_total{stream="uav1_power"} 3.0',
        'dyknow_node_alive{node="/manager"} 0.0',
        'dyknow_node_level{node="/manager"} 2.0',
    ):
        assert lines.count(expected) == 1, expected
    hidden = 'bound="upper"', '_states_1', '/new'
    assert not [line for line in lines if any(each in line for each in hidden)]
    # The example for Grafana asks for nothing else.
    known = {re.match(r'\w+', line)[0] for line in lines if not line.startswith('#')}
    panels = json.loads(GRAFANA.read_text(encoding='utf-8'))['panels']
    asked = re.findall(r'dyknow_\w+', str([each['targets'] for each in panels]))
    assert asked
    assert set(asked) <= known


@pytest.mark.parametrize('code', [ExitCode.CONSTRAINT_VIOLATION, ExitCode.NOT_FOUND])
def test_a_failure_lasts_until_a_retry_has_a_state(code: ExitCode) -> None:
    error = DyKnowError('/odom is silent', code)
    failed = replace(POWER, phase=EvaluationPhase.ENDED, error=error)
    started = POWER.started + SECOND_NS
    retry = replace(POWER, started=started, states_progressed=0, latest_valid_time=None)
    board, seen = board_of(POWER), []
    for status in (
        POWER,
        failed,
        replace(retry, phase=EvaluationPhase.GROUNDING),
        retry,
        replace(retry, phase=EvaluationPhase.ENDED, error=error),
        replace(retry, started=started + SECOND_NS),
        replace(retry, started=started + SECOND_NS, states_progressed=1),
    ):
        # The coordinator reports an error until the formula is evaluated again.
        board.formulas.update([status], 21 * SECOND_NS)
        (line,) = re.findall('dyknow_formula_failing{.*', metrics_of(board).decode())
        count = board.formulas.document()['counts']['failing']
        seen.append((float(line.split()[-1]), count))
    assert seen == [(0.0, 0), *[(1.0, 1)] * 5, (0.0, 0)]


@pytest.mark.parametrize(
    ('node', 'metric'),
    [
        ('/r1/stream_reasoning_coordinator', 'formula_failing'),
        ('/stream_manager', 'stream_flowing'),
    ],
)
def test_no_metrics_of_what_a_node_reported_that_is_gone(node: str, metric: str) -> None:
    board = board_of(POWER)
    board.streams.update(STREAMS, ['/engine'])
    for alive in (True, False):
        state = NodeState(alive=alive, message='running', absent=0 if alive else 60 * SECOND_NS)
        board.health.update([NodeHealth(node, state)], 30 * SECOND_NS)
        text = metrics_of(board).decode()
        assert f'dyknow_node_alive{{node="{node}"}} {float(alive)}' in text
        assert (f'dyknow_{metric}{{' in text) == alive


def test_a_page_gets_what_has_changed() -> None:
    board, page = board_of(POWER), PageState()
    assert set(messages(board, page)) == {'formulas', 'nodes', 'history'}
    assert messages(board, page) == {}
    board.formulas.update([POWER], 22 * SECOND_NS)
    assert set(messages(board, page)) == {'formulas'}
    page.show(Interest('streams'))
    assert set(messages(board, page)) == {'streams'}
    assert messages(board, page) == {}


def test_a_row() -> None:
    (row,) = board_of(replace(POWER, margin=Margin(1, 2, 'W', 'a'))).formulas.rows()
    assert row['name'] == 'power'
    assert (row['state'], row['kind'], row['is_running']) == ('running', 'undecided', True)
    assert row['margin'] == '1 to 2 W (a)'
    assert row['since'] == 11


def test_an_opened_formula_gets_details_then_a_drawing_then_points() -> None:
    board = board_of(POWER)
    page = opened(board)
    assert board.state_topics([page]) == {'/dyknow/streams/_states_1'}
    assert {'details', 'drawing'} < set(messages(board, page))
    board.add_states([('/dyknow/streams/_states_1', 11 * SECOND_NS, {'uav1_power.power': 1.0})])
    assert list(messages(board, page)) == ['points']
    board.formulas.update([POWER], 22 * SECOND_NS)
    assert 'drawing' in messages(board, page), 'now there is a panel'
    board.add_states([('/other', 12 * SECOND_NS, {'uav1_power.power': 1.0})])
    assert messages(board, page) == {}
    board.add_states([('/dyknow/streams/_states_1', 12 * SECOND_NS, {'uav1_power.power': 2.0})])
    (points,) = messages(board, page).values()
    assert points['signals'] == [{'t': [2], 'v': [2], 'low': [], 'high': []}]
    assert messages(board, page) == {}


def test_the_deciding_state_is_drawn_though_the_state_stream_ends_with_it() -> None:
    board = board_of(POWER)
    page = opened(board)
    messages(board, page)
    ended = replace(
        POWER,
        phase=EvaluationPhase.ENDED,
        verdict=Verdict.FALSE,
        decided_at=20 * SECOND_NS,
        state_stream='',
    )
    board.formulas.update([ended], 22 * SECOND_NS)
    assert board.state_topics([page]) == {'/dyknow/streams/_states_1'}
    board.add_states([('/dyknow/streams/_states_1', 20 * SECOND_NS, {'uav1_power.power': 6.0})])
    (formula,) = messages(board, page)['drawing']['formulas']
    (deciding,) = formula['marks']['deciding']
    assert deciding['values'] == {'uav1_power.power': 6}


def test_a_formula_that_is_opened_after_its_failure_has_the_signals_before_it() -> None:
    board = board_of(POWER)
    topics = board.state_topics([])
    assert topics == {'/dyknow/streams/_states_1'}, 'no page is open'
    (topic,) = topics
    values = {second: 4.0 if second < 20 else 6.0 for second in range(11, 25)}
    board.add_states((topic, at * SECOND_NS, {'uav1_power.power': v}) for at, v in values.items())
    ended = replace(
        POWER, phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE, decided_at=20 * SECOND_NS
    )
    board.formulas.update([ended], 25 * SECOND_NS)
    assert board.state_topics([]) == set(), 'nothing more is to come'
    drawing = messages(board, opened(board))['drawing']
    (signal,) = drawing['signals']
    assert signal['v'] == [*[4.0] * 9, 6.0]
    (deciding,) = drawing['formulas'][0]['marks']['deciding']
    assert (deciding['time'], deciding['verdict']) == (10, 'false')


def test_the_signals_that_are_kept_are_bounded() -> None:
    board = board_of(*(replace(POWER, name=f'f{number}') for number in range(MAX_KEPT + 5)))
    board.state_topics([])
    last = board.formulas.keys()[-1]
    assert board.signals_of(last) is None
    board.state_topics([PageState(Interest('formulas', (last,)))])
    assert board.signals_of(last) is not None, 'opened ones come first'
    many = ' and '.join(f'(s{number}.power < 5)' for number in range(80))
    wide = [replace(POWER, name=f'w{number}', formula=many) for number in range(30)]
    board = board_of(*wide)
    board.state_topics([])
    keys = board.formulas.keys()
    assert sum(board.signals_of(key) is not None for key in keys) == MAX_KEPT_SIGNALS // 80


def test_failed_formulas_come_first_and_earlier_runs_last() -> None:
    verdicts = StandingVerdicts(
        fails=1,
        is_violated=True,
        episode_count=3,
        latest_episodes=(ViolationEpisode(*[19 * SECOND_NS] * 3, 1, False, ''),),
    )
    ended = replace(POWER, phase=EvaluationPhase.ENDED)
    false = replace(ended, verdict=Verdict.FALSE, decided_at=15 * SECOND_NS)
    board = board_of(
        replace(false, name='again'),
        replace(POWER, name='again', started=12 * SECOND_NS),
        replace(ended, name='true', verdict=Verdict.TRUE),
        replace(false, name='false'),
        replace(POWER, name='standing', episodes=verdicts),
    )
    document = board.formulas.document()
    assert [(each['name'], each['group'], each['failures']) for each in document['rows']] == [
        ('standing', 'failing', 3),
        ('false', 'failing', 1),
        ('again', 'running', 0),
        ('true', 'ended', 0),
        ('again', 'earlier', 1),
    ]
    assert document['counts'] == {'failing': 2, 'running': 1, 'ended': 1, 'earlier': 1}
    assert document['rows'][0]['failed_at'] == {'since': '9.000 s', 'clock': None}


def test_times_are_sent_as_offsets_and_on_the_clock() -> None:
    start = 1_700_000_000 * SECOND_NS
    ended = replace(
        POWER,
        started=start,
        phase=EvaluationPhase.ENDED,
        verdict=Verdict.FALSE,
        decided_at=start + 13_662_345_678,
    )
    (row,) = board_of(ended).formulas.rows()
    assert row['failed_at'] == {'since': '13.662 s', 'clock': 1_700_000_013_662}


def test_a_formula_that_is_not_known_is_not_sent() -> None:
    page = PageState(Interest('formulas', ('unknown',)))
    assert set(messages(board_of(POWER), page)) == {'formulas', 'nodes', 'history'}


def test_evaluations_are_kept_after_their_last_report() -> None:
    ended = replace(POWER, phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE)
    board = board_of(ended)
    board.formulas.update([], 60 * SECOND_NS)
    (row,) = board.formulas.rows()
    assert row['state'] == 'false'


def test_an_evaluation_that_vanished_is_no_longer_running() -> None:
    board = board_of(POWER)
    board.formulas.update([], 60 * SECOND_NS)
    (row,) = board.formulas.rows()
    assert (row['state'], row['is_running']) == ('unavailable', False)
    board.formulas.update([POWER], 61 * SECOND_NS)
    (row,) = board.formulas.rows()
    assert row['state'] == 'running'


def test_the_number_of_evaluations_is_bounded() -> None:
    board = Board(lambda: 0)
    for number in range(200):
        board.formulas.update([replace(POWER, started=number)], number)
    assert len(board.formulas.rows()) == MAX_ENDED + 1
    many = [replace(POWER, started=number) for number in range(MAX_SHOWN + 7)]
    board.formulas.update(many, 0)
    assert board.formulas.hidden == 7
    assert len(board.formulas.rows()) <= MAX_SHOWN + MAX_ENDED
    many[-1] = replace(many[-1], phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE)
    board.report(many, 0)
    document = board.formulas.document()
    assert document['rows'][0]['state'] == 'false', 'a failing one is shown'
    assert document['counts'] == {'failing': 1, 'running': MAX_SHOWN - 1, 'ended': 0, 'earlier': 0}


def test_a_run_that_is_not_shown_makes_a_failed_one_an_earlier_run() -> None:
    failed = replace(POWER, phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE)
    others = [replace(POWER, name=f'p{number}') for number in range(MAX_SHOWN)]
    board = board_of(failed, *others, replace(POWER, started=POWER.started + 1))
    (row,) = [each for each in board.formulas.rows() if each['name'] == 'power']
    assert (row['state'], row['group']) == ('false', 'earlier')
    assert board.formulas.failing() == set()


def test_two_formulas_of_one_name_and_time_keep_apart() -> None:
    """As in simulated time; the coordinator reports the one that has ended no more."""
    ended = replace(
        POWER, formula_text='q.x < 1', phase=EvaluationPhase.ENDED, verdict=Verdict.TRUE
    )
    board = board_of(ended, POWER)
    board.formulas.update([POWER], 22 * SECOND_NS)
    assert [each['state'] for each in board.formulas.rows()] == ['running', 'true']


def test_evaluations_of_one_name_are_distinct() -> None:
    board = board_of(POWER, POWER)
    assert len({each['id'] for each in board.formulas.rows()}) == 2


def test_a_row_has_the_probability() -> None:
    interval = ProbabilityInterval(0.9, 1.0, 'assuming independent errors')
    (row,) = board_of(replace(POWER, probability=interval)).formulas.rows()
    text = 'at least 0.9, assuming independent errors'
    assert row['probability'] == {**interval.document, 'text': text}


def test_probabilities_of_the_future_are_kept_over_time() -> None:
    board = Board(lambda: 0)
    formula = 'P(always (normal(x, 1, 0 s) > 0)) >= 0.9 and always (P(normal(x, 1) > 0) >= 0.5)'
    for second in range(3):
        interval = ProbabilityInterval(0.0, 1 - second / 10, 'assuming independent errors')
        latest = (20 + second) * SECOND_NS
        status = replace(POWER, formula=formula, latest_valid_time=latest, probability=interval)
        board.formulas.update([status], latest)
    evaluation = board.formulas.get(board.formulas.rows()[0]['id'])
    assert evaluation is not None
    details = board.formulas.details(evaluation)
    assert details['probabilities'] == [[10, 0, 1], [11, 0, 0.9], [12, 0, 0.8]]
    # Those at each state are in the panels of the signals.
    assert details['required'] == [{'value': 0.9, 'text': '>= 0.9'}]


def test_margins_are_kept_over_time() -> None:
    board = Board(lambda: 0)
    for second in range(MAX_MARGINS + 10):
        margin = Margin(-1 if second else float('-inf'), second)
        latest = (20 + second) * SECOND_NS
        board.formulas.update([replace(POWER, latest_valid_time=latest, margin=margin)], latest)
    (row,) = board.formulas.rows()
    evaluation = board.formulas.get(row['id'])
    assert evaluation is not None
    margins = board.formulas.details(evaluation)['margins']
    assert len(margins) == MAX_MARGINS
    assert margins[-1] == [10 + MAX_MARGINS + 9, -1, MAX_MARGINS + 9]


def test_kinds_of_ends() -> None:
    kinds = {
        ExitCode.CANCELLED: 'undecided',
        ExitCode.TIMEOUT: 'undecided',
        ExitCode.CONSTRAINT_VIOLATION: 'error',
    }
    for code, kind in kinds.items():
        ended = replace(POWER, phase=EvaluationPhase.ENDED, error=DyKnowError('why', code))
        (row,) = board_of(ended).formulas.rows()
        assert (row['kind'], row['text']) == (kind, 'why')


def test_streams() -> None:
    board, page = board_of(POWER), PageState(Interest('streams'))
    board.streams.update(STREAMS, ['/engine'])
    found = messages(board, page)['streams']
    assert found['engines'] == ['/engine']
    own, spare, power = found['streams']
    assert own['is_own']
    assert own['shown'] == 'states of power'
    (battery,) = found['topics']
    assert battery == {
        'name': '/uav1/battery',
        'rate': 20.0,
        'delay': '3 ms',
        'received': 80,
        'lost': 2,
        'dropped': 1,
        'drops': {'lost': 2, 'message': 1},
        'formulas': ['power'],
        'streams': ['uav1_power'],
        'message': '',
    }
    assert spare['stand_in_for'] == ['Power[uav1]']
    assert (spare['state'], spare['rate']) == ('waiting', None)
    assert (power['rate'], power['dropped'], power['violations']) == (20.0, 3, 3)


def test_the_source_of_a_stream() -> None:
    assert source_of('select a from b') == 'b'
    assert source_of('select a from "/b" where c = 1') == '/b'
    assert source_of('select a from b with max_delay = 1 s') == 'b'


def test_the_graph_from_topics_to_formulas() -> None:
    other = replace(POWER, name='other')
    found = graph(STREAMS, [POWER, other])
    layers = found['layers']
    names = {each['id']: (layers[each['layer']], each['name']) for each in found['nodes']}
    edges = {(names[start], names[end]) for start, end in found['edges']}
    states = 'states', 'of power, other'
    assert edges == {
        (('topic', '/uav1/battery'), ('stream', 'uav1_power')),
        (('stream', 'uav1_power'), states),
        (states, ('formula', 'power')),
        (states, ('formula', 'other')),
    }
    assert ('stream', 'spare') in names.values()


def test_the_graph_is_bounded() -> None:
    many = [StreamReport(f's{number}', StreamState.FLOWING) for number in range(MAX_NODES + 9)]
    found = graph(many, [POWER])
    assert len(found['nodes']) == MAX_NODES
    assert found['hidden'] > 0
    known = {each['id'] for each in found['nodes']}
    assert all({*edge} <= known for edge in found['edges'])


def test_health() -> None:
    table = HealthTable()
    alive = NodeHealth('/manager', NodeState(True, Level.OK, 'running'))
    gone = NodeHealth('/engine', NodeState(False, Level.OK, 'running', 7 * SECOND_NS))
    table.diagnose([DiagnosedPart('driver: battery', 1, 'low')], 0)
    table.diagnose([DiagnosedPart('/manager: node', 0, 'ok')], 0)
    table.update([alive, gone], 0)
    document = table.document()
    assert [each['level'] for each in document['nodes']] == ['ok', 'error']
    assert document['nodes'][1]['message'].startswith('gone for 7')
    assert document['diagnoses'] == [
        {'name': 'driver: battery', 'level': 'warning', 'message': 'low'}
    ]
    table.update([alive], STALE_NS)
    assert table.document()['diagnoses'] == []


def test_a_run_after_simulated_time_was_set_back_is_the_latest() -> None:
    failed = replace(POWER, phase=EvaluationPhase.ENDED, verdict=Verdict.FALSE)
    board = board_of(failed)
    board.formulas.update([failed], failed.started + SECOND_NS)
    again = replace(failed, started=2 * SECOND_NS)
    for now in (3, 4, 100):
        board.formulas.update([failed, again], now * SECOND_NS)
        assert [each['group'] for each in board.formulas.rows()] == ['failing', 'earlier']
        known = board.formulas.by_key()
        started = [known[key].started for key in board.formulas.keys()]  # noqa: SIM118
        assert started == [2 * SECOND_NS, failed.started]

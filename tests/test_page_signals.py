"""What the server of the live page sends over real nodes, to a page without a browser."""

from __future__ import annotations

import json
import time
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from dashboards import dashboard
from page_client import post, receive
from system import LIMIT, System


def test_a_formula_that_failed_before_it_is_opened_shows_why(served: tuple[System, str]) -> None:
    system, address = served
    name = 'forall u in UAV: always (Power[u] < 150)'
    answer = system.ask(name)
    system.wait_until_running(answer)
    system.client.wait(3.0)
    system.batteries.power['uav2'] = 170.0
    system.client.spin_until(answer.done, 'the verdict')
    system.batteries.reset()
    system.client.wait(2.0)  # Now somebody hears the alarm.
    drawing = receive(
        address, 'formulas', name, lambda found: found['type'] == 'drawing' and found['signals']
    )
    (formula,), first = drawing['formulas'], drawing['captions'][0]
    assert (first['objects'], first['is_decisive']) == ('u = uav2', True)
    assert first['names'] == ['Power[uav2]']
    signal = drawing['signals'][formula['panels'][0]['signals'][0]]
    (deciding,) = formula['marks']['deciding']
    assert deciding['values']['Power[uav2]'] == pytest.approx(170.0)
    assert signal['t'][-1] == pytest.approx(deciding['time']), 'the line ends with the formula'
    assert signal['v'][-1] == pytest.approx(170.0)
    assert len(signal['v']) > 5
    assert max(signal['v'][:-1]) < 150.0


def test_failed_formulas_come_first_and_are_counted(served: tuple[System, str]) -> None:
    _, address = served
    found = receive(address, 'formulas', '', lambda each: each['type'] == 'formulas')
    assert found['counts']['failing'] == 1
    assert (found['rows'][0]['group'], found['rows'][0]['failures']) == ('failing', 1)
    assert found['rows'][0]['failed_at']['clock'] / 1000 == pytest.approx(time.time(), abs=120.0)


def test_the_topics_of_a_formula(served: tuple[System, str]) -> None:
    system, address = served
    formula = 'always ("/uav1/battery".voltage > 1.0)'
    answer = system.ask(formula, timeout=LIMIT)
    system.wait_until_running(answer)

    def shows_topic_and_states(found: Any) -> bool:
        # Evaluations and streams are reported by different nodes, so one of them is known first.
        if found['type'] != 'streams':
            return False
        names = [each['shown'] for each in found['streams']]
        return f'states of {formula}' in names and any(
            each['formulas'] == [formula] and each['rate'] > 1.0 for each in found['topics']
        )

    receive(address, 'streams', '', shows_topic_and_states)


def test_failures_outlive_the_page(served: tuple[System, str], tmp_path: Path) -> None:
    system, _ = served
    path = tmp_path / 'history.db'

    def power(address: str) -> list[dict[str, Any]]:
        # The shared system has failures of other tests as well.
        with urllib.request.urlopen(f'{address}/api/history?name=175') as answer:  # noqa: S310
            return list(json.load(answer)['failures'])

    with dashboard(system.environment, 0, '--history', str(path)) as address:
        answer = system.ask('always (uav1_power.power < 175)')
        system.wait_until_running(answer)
        system.batteries.power['uav1'] = 190.0
        system.client.spin_until(lambda: bool(power(address)), 'the failure')
        system.batteries.reset()
        failure = power(address)[0]
        assert 'is not < 175' in failure['explanation']
        assert failure['known_at'] / 1e9 == pytest.approx(time.time(), abs=600.0)
        assert post(address, 'acknowledge', ids=[failure['id']], by='Ada') == 200
        before = power(address)
    with dashboard(system.environment, 0, '--history', str(path)) as address:
        # The coordinator reports them again.
        receive(address, 'formulas', '', lambda each: each['type'] == 'formulas' and each['rows'])
        assert power(address) == before
        (seen,) = [each for each in before if each['acknowledged_by']]
        assert seen['id'] == failure['id']

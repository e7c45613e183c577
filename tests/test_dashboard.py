"""The live page in Chromium, over real nodes."""

from __future__ import annotations

import os
import subprocess
import urllib.request
from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from browser import Browser
from commands import command, output_of
from dashboards import LivePage, dashboard
from dyknow_bringup.simulation.link import free_port
from guards import guarded_base
from system import LIMIT, System, private_environment

POWER = 'forall u in UAV: always (Power[u] < 150)'

DISCONNECTED = 'WebSocket connection to'
"""Log lines of Chromium while the server is away."""


@pytest.fixture(scope='module')
def page(browser: Browser) -> LivePage:
    return LivePage(browser)


def ask(page: LivePage, formula: str, name: str, *, every_state: bool = False) -> None:
    if page.find('#asking').get_attribute('open') is None:  # As on a phone.
        page.find('#asking summary').click()
    page.type('#formula', formula)
    page.type('#name', name)
    if page.find('#every').is_selected() is not every_state:
        page.find('#every').click()
    page.find('#ask button.main').click()


def test_a_formula_is_asked_drawn_and_cancelled(page: LivePage, served: tuple[System, str]) -> None:
    system, address = served
    page.show(address)
    page.until(lambda: '7 nodes ok' in page.text('#health'), 'all nodes')
    ask(page, POWER, 'draws little')
    page.until(lambda: 'running' in page.state('draws little'), 'it runs')
    row = page.open('draws little')
    page.until(lambda: len(row.find_elements(By.CSS_SELECTOR, '.js-plotly-plot')) == 2, 'panels')
    script = "return document.querySelector('.js-plotly-plot').data[0].x.length"
    before = page.driver.execute_script(script)
    page.until(lambda: page.driver.execute_script(script) > before + 5, 'more points')
    assert '< 150' in row.text
    system.batteries.power['uav2'] = 170.0
    page.until(lambda: 'false' in page.state('draws little'), 'the verdict')
    page.until(lambda: 'for u = uav2: Power[uav2] = 170' in row.text, 'the explanation')
    assert 'decides' in page.text('.panels figure')
    system.batteries.reset()
    ask(page, 'always (uav1_power.power < 1000)', 'endless')
    endless = page.open('endless')
    page.until(lambda: endless.find_elements(By.XPATH, './/button[.="Cancel"]'), 'the button')
    endless.find_element(By.XPATH, './/button[.="Cancel"]').click()
    page.until(lambda: 'cancelled' in page.state('endless'), 'it is cancelled')
    assert page.errors() == []


def test_a_standing_formula_has_its_episodes(page: LivePage, served: tuple[System, str]) -> None:
    system, address = served
    page.show(address, 390, 844, dark=True)
    ask(page, 'forall u in UAV: Power[u] < 150', 'standing', every_state=True)
    row = page.open('standing')
    system.batteries.power['uav1'] = 160.0
    page.until(lambda: 'violated' in page.state('standing'), 'an episode')
    system.batteries.reset()
    page.until(lambda: 'Episodes' in row.text, 'the table of episodes')
    page.until(lambda: 'running' in page.state('standing'), 'it holds again')
    segments = {each.get_attribute('class') for each in row.find_elements(By.CSS_SELECTOR, 'i')}
    assert {'is-true', 'is-false'} <= segments
    assert not page.is_wider_than_the_screen
    row.find_element(By.XPATH, './/button[.="Cancel"]').click()
    page.until(lambda: 'running' not in page.state('standing'), 'it ends')
    assert page.errors() == []


def test_faults_and_completions_as_one_types(page: LivePage, served: tuple[System, str]) -> None:
    _, address = served
    page.show(address)
    page.tab('ontology')
    page.until(lambda: 'Power[' in page.text('#features-table'), 'the features')
    page.tab('formulas')
    page.type('#formula', 'forall u in UAV: always Pow')
    page.until(lambda: 'Power' in page.text('#proposals'), 'a completion')
    page.find('#formula').send_keys(Keys.ARROW_DOWN, Keys.ENTER, '[u] <')
    assert page.find('#formula').get_property('value') == 'forall u in UAV: always Power[u] <'
    page.until(lambda: 'unexpected end of the formula' in page.text('#fault'), 'the fault')
    lines = page.find('#fault').get_property('textContent').split('\n')
    assert lines[-1].index('^') == lines[-2].index('<') + 1
    page.find('#formula').send_keys(Keys.BACKSPACE, 'al')
    page.find('#formula').send_keys(Keys.ESCAPE)
    page.until(lambda: not page.find('#proposals').is_displayed(), 'Escape hides completions')
    page.type('#formula', 'always nothing_there < 3')
    page.find('#formula').send_keys(Keys.CONTROL, Keys.ENTER)
    assert page.errors() == []


@pytest.mark.parametrize('width', [390, 1400])
def test_all_parts_fit_the_screen(
    page: LivePage, served: tuple[System, str], width: int, tmp_path: Path
) -> None:
    _, address = served
    page.show(address, width)
    expected = {
        'streams': ('#streams-table', 'uav1_power'),
        'graph': ('#graph-view', 'uav1_power'),
        'nodes': ('#nodes-table', '/stream_processing_engine'),
        'ontology': ('#sorts-table', 'uav1, uav2'),
    }
    for tab, (place, text) in expected.items():
        page.tab(tab)
        page.until(lambda: text in page.text(place), tab)  # noqa: B023
        assert not page.is_wider_than_the_screen, tab
        page.save(tmp_path / f'{tab}_{width}.png')
    assert page.errors() == []


def test_the_tabs_by_keyboard(page: LivePage, served: tuple[System, str]) -> None:
    page.show(served[1])
    page.find('#tab-formulas').send_keys(Keys.ARROW_RIGHT)
    assert page.find('#history').is_displayed()
    page.driver.switch_to.active_element.send_keys(Keys.END)
    assert page.find('#ontology').is_displayed()
    assert page.driver.switch_to.active_element.get_attribute('id') == 'tab-ontology'
    page.driver.switch_to.active_element.send_keys(Keys.HOME)
    assert page.find('#formulas').is_displayed()
    names = page.driver.execute_script(
        "return [...document.querySelectorAll('button, input, textarea, [tabindex]')]"
        '.filter((each) => !each.textContent && !each.labels?.length && !each.ariaLabel).length'
    )
    assert names == 0, 'all that takes the focus has a name'


def test_the_page_survives_the_restart_of_every_node(
    page: LivePage, served: tuple[System, str]
) -> None:
    system, address = served
    page.show(address)
    page.until(lambda: '7 nodes ok' in page.text('#health'), 'all nodes')
    for executable in tuple(system.processes):
        with system.killed(executable):
            page.until(lambda: 'missing' in page.text('#health'), f'{executable} is missing')
        page.until(lambda: '7 nodes ok' in page.text('#health'), f'{executable} is back')
    system.client.wait_for_coordinator()
    system.wait_for_streams()
    ask(page, POWER, 'afterwards')
    page.until(lambda: 'running' in page.state('afterwards'), 'a formula runs')
    row = page.open('afterwards')
    page.until(lambda: row.find_elements(By.CSS_SELECTOR, '.js-plotly-plot'), 'its signals')
    row.find_element(By.XPATH, './/button[.="Cancel"]').click()
    page.until(lambda: 'cancelled' in page.state('afterwards'), 'it is cancelled')
    assert page.errors() == []


def test_the_page_survives_the_restart_of_its_server(page: LivePage) -> None:
    environment, port = private_environment(), free_port()
    with dashboard(environment, port) as address:
        page.show(address)
        page.until(lambda: page.text('#connection') == 'live', 'it is connected')
    page.until(lambda: 'connection to the server is lost' in page.text('#lost'), 'it says so')
    with dashboard(environment, port):
        page.until(lambda: page.text('#connection') == 'live', 'it is connected again')
        assert not page.find('#lost').is_displayed()
    assert page.errors(DISCONNECTED) == []


def test_the_surge_of_the_demonstration(page: LivePage) -> None:
    environment = private_environment()
    with dashboard(environment) as address:
        page.show(address)
        line = command('uav_demo', '--scenario', 'power_surge')
        with subprocess.Popen(
            line, env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True
        ) as demo:
            row = page.open('power')
            page.until(lambda: 'false' in page.state('power'), 'the verdict', LIMIT * 2)
            page.until(lambda: 'for u = uav2: Power[uav2] = 24' in row.text, 'the explanation')
            assert 'is not < 200' in row.text
            figure = page.until(lambda: row.find_elements(By.CSS_SELECTOR, 'figure'), 'signals')[0]
            page.until(lambda: 'decides' in figure.text, 'the decisive signal is the first')
            assert 'Power[uav2]' in figure.text
            said, _ = demo.communicate(timeout=LIMIT * 2)
            assert demo.returncode == 0, said
        assert page.errors() == []


def test_a_page_for_others_is_announced_with_a_warning() -> None:
    with dashboard(private_environment(), 0, '--host', '0.0.0.0', '--read-only') as address:  # noqa: S104
        port = address.rpartition(':')[2]
        with urllib.request.urlopen(f'http://127.0.0.1:{port}/', timeout=LIMIT) as response:
            assert b'<title>DyKnow</title>' in response.read()


def test_a_port_that_is_taken() -> None:
    environment = private_environment()
    with dashboard(environment) as address:
        port = address.rpartition(':')[2]
        done = output_of(command('dyknow', 'dashboard', '--port', port), environment)
    assert done.returncode == 2
    assert f'cannot listen on 127.0.0.1:{port}: ' in done.stderr
    assert 'Traceback' not in done.stderr


def test_guards_and_their_states(
    page: LivePage, served: tuple[System, str], tmp_path: Path
) -> None:
    """The last test: a guard that is gone stays in the lists of all pages."""
    system, _ = served

    def row() -> str:
        found = [each.text for each in page.all('#nodes-table tr') if '/base_guard' in each.text]
        return ' '.join(found)

    with (
        dashboard(system.environment) as address,
        guarded_base(system, tmp_path, "['Power[uav1] < 150']", timeout='1 s') as base,
    ):
        page.show(address)
        page.tab('nodes')
        page.until(lambda: 'open' in row(), 'the guard is open')
        system.batteries.power['uav1'] = 200.0
        page.until(lambda: 'closed: Power[uav1] < 150: Power[uav1] = 200.0' in row(), 'it is not')
        system.batteries.reset()
        page.until(lambda: 'open' in row(), 'the guard is open again')
        base.process.kill()
        page.until(lambda: 'gone for' in row(), 'the guard is gone')
        page.until(lambda: 'missing' in page.text('#health'), 'it is missing')
    assert page.errors(DISCONNECTED) == []

"""The page of `dyknow check --html`, in a browser."""

from __future__ import annotations

from pathlib import Path

import pytest

from browser import Browser
from dyknow_command import main

ROOT = Path(__file__).parent.parent
ROVER = ROOT / 'examples' / 'rover'

PANELS = "document.querySelectorAll('.js-plotly-plot').length"

BACKGROUND = 'getComputedStyle(document.body).backgroundColor'


def test_a_page_that_is_too_wide_is_noticed(browser: Browser) -> None:
    browser.open('data:text/html,<div style="width:500px">wide</div>', 390)
    assert browser.overflow() > 100
    browser.resize(1400, 900)
    assert browser.overflow() <= 0


def test_errors_and_requests_are_noticed(browser: Browser) -> None:
    browser.open('data:text/html,<img src="https://example.org/a.png"><script>none()</script>')
    assert any('none is not defined' in each for each in browser.errors())
    assert 'https://example.org/a.png' in browser.requests()


@pytest.fixture(scope='module')
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of the page of a recording with formulas that are false."""
    path = tmp_path_factory.mktemp('page') / 'report.html'
    recording, config = ROVER / 'recordings' / 'faults', ROVER / 'robot.yaml'
    assert main(['check', str(recording), '--config', str(config), '--html', str(path)]) == 1
    return path.as_uri()


@pytest.mark.parametrize('dark', [False, True], ids=['light', 'dark'])
@pytest.mark.parametrize('width', [390, 1400])
def test_the_page_is_drawn(browser: Browser, page: str, width: int, *, dark: bool) -> None:
    browser.open(page, width, dark=dark)
    browser.wait_for(PANELS)
    assert browser.run('document.title') == '(5) faults - DyKnow'
    assert browser.errors() == []
    assert browser.requests() == [page]
    assert browser.overflow() <= 0


def test_plotly_is_read_when_a_plot_is_opened(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / 'report.html'
    recording, config = ROVER / 'recordings' / 'clean', ROVER / 'robot.yaml'
    assert main(['check', str(recording), '--config', str(config), '--html', str(path)]) == 0
    browser.open(path.as_uri())
    assert browser.run('document.title') == 'clean - DyKnow'
    assert not browser.run('Boolean(window.Plotly)')
    browser.driver.execute_script("document.querySelector('details.formula').open = true")
    browser.wait_for(PANELS)
    assert browser.errors() == []


def test_every_formula_can_be_opened_on_a_phone(browser: Browser, page: str) -> None:
    browser.open(page, 390)
    browser.driver.execute_script(
        "document.querySelectorAll('details').forEach((each) => { each.open = true; })"
    )
    plots = browser.run("document.querySelectorAll('.plot').length")
    browser.wait_for(f'{PANELS} === {plots}')
    drawn = browser.run(
        "[...document.querySelectorAll('.plot')].every((each) =>"
        " each.querySelector('svg.main-svg') && each.getBoundingClientRect().height > 50)"
    )
    assert plots
    assert drawn
    assert browser.overflow() <= 0
    assert browser.errors() == []


def test_the_dark_page_has_light_text(browser: Browser, page: str) -> None:
    def brightness(colour: str) -> int:
        return sum(browser.run(f'{colour}.match(/\\d+/g).slice(0, 3).map(Number)'))

    text = 'getComputedStyle(document.body).color'
    browser.open(page)
    assert brightness(BACKGROUND) - brightness(text) > 400
    browser.open(page, dark=True)
    assert brightness(text) - brightness(BACKGROUND) > 400

"""The live page for tests: a running `dyknow dashboard`, and Chromium that shows it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

from commands import command, running

LIMIT_S = 60.0
"""Seconds after which a wait for a page has failed."""

FLAGS = (
    '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
    '--hide-scrollbars', '--disable-background-networking', '--disable-component-update',
    '--disable-sync',
)  # fmt: skip

HAS_BROWSER = bool(shutil.which('chromium') and shutil.which('chromedriver'))


@contextmanager
def dashboard(environment: dict[str, str], port: int = 0, *arguments: str) -> Iterator[str]:
    """Run `dyknow dashboard`, and yield its address."""
    line = command('dyknow', 'dashboard', '--port', str(port), *arguments)
    with running(line, environment) as process:
        assert process.stdout is not None
        said = process.stdout.readline()
        assert said.startswith('open http://'), said
        yield said.split()[1]


@contextmanager
def chromium() -> Iterator[LivePage]:
    """Chromium with an empty profile."""
    options = ChromeOptions()
    options.binary_location = shutil.which('chromium') or ''
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL'})
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in (*FLAGS, f'--user-data-dir={profile}'):
            options.add_argument(flag)
        driver = Chrome(options, Service(shutil.which('chromedriver')))
        try:
            yield LivePage(driver)
        finally:
            driver.quit()


class LivePage:
    """The page in a browser."""

    def __init__(self, driver: Chrome) -> None:
        self.driver = driver

    def show(self, url: str, width: int = 1400, height: int = 1000, *, dark: bool = False) -> None:
        """Load the page, and forget the errors of those before."""
        self.driver.get('about:blank')
        self.errors()
        metrics = {'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': width < 600}
        self.driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', metrics)
        scheme = {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}
        self.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'features': [scheme]})
        self.driver.get(url)

    def until(self, condition: Callable[[], Any], what: str, limit: float = LIMIT_S) -> Any:
        """Wait for a condition, and return its value."""
        end = time.monotonic() + limit
        while True:
            try:
                if found := condition():
                    return found
            except StaleElementReferenceException:
                pass
            assert time.monotonic() < end, f'{what}; the page shows: {self.text()[:3000]}'
            time.sleep(0.1)

    def find(self, selector: str) -> Any:
        """Return the first element."""
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def all(self, selector: str) -> list[Any]:
        """Return all elements."""
        return list(self.driver.find_elements(By.CSS_SELECTOR, selector))

    def text(self, selector: str = 'body') -> str:
        """Return the visible text of an element."""
        return str(self.find(selector).text)

    def tab(self, name: str) -> None:
        """Show a part of the system."""
        self.find(f'#tab-{name}').click()

    def formula(self, name: str) -> Any:
        """Return the element of a formula; None if it is not shown."""
        for each in self.all('details.formula'):
            if name in {
                each.find_element(By.CSS_SELECTOR, part).text for part in ('.name', 'code')
            }:
                return each
        return None

    def state(self, name: str) -> str:
        """Return the word for the state of a formula; empty if it is not shown."""
        row = self.formula(name)
        return '' if row is None else str(row.find_element(By.CSS_SELECTOR, '.word').text)

    def open(self, name: str) -> Any:
        """Open the details of a formula, and return its element."""
        row = self.until(lambda: self.formula(name), f'the formula {name}')
        row.find_element(By.CSS_SELECTOR, 'summary').click()
        return row

    def type(self, selector: str, text: str) -> None:
        """Replace the text of a field."""
        field = self.find(selector)
        field.clear()
        field.send_keys(text)

    def save(self, path: Path) -> None:
        """Take a screenshot."""
        self.driver.save_screenshot(str(path))

    def errors(self, *expected: str) -> list[str]:
        """Return the errors in the console since the last call, but those with expected texts."""
        messages = [each['message'] for each in self.driver.get_log('browser')]
        return [each for each in messages if not any(text in each for text in expected)]

    @property
    def is_wider_than_the_screen(self) -> bool:
        """True if the page scrolls to the side."""
        script = 'return document.documentElement.scrollWidth > innerWidth'
        return bool(self.driver.execute_script(script))

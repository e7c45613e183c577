"""The live page for tests: a running `dyknow dashboard`, and Chromium that shows it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver.common.by import By

from browser import LIMIT_S, Browser
from commands import command, running


@contextmanager
def dashboard(environment: dict[str, str], port: int = 0, *arguments: str) -> Iterator[str]:
    """Run `dyknow dashboard`, which keeps no failures unless told so; yield its address."""
    line = command('dyknow', 'dashboard', '--port', str(port), '--history', 'none', *arguments)
    with running(line, environment) as process:
        assert process.stdout is not None
        said = process.stdout.readline()
        assert said.startswith('open http://'), said
        yield said.split()[1]


class LivePage:
    """The page in a browser."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser
        self.driver = browser.driver

    def show(self, url: str, width: int = 1400, height: int = 1000, *, dark: bool = False) -> None:
        """Load the page, and forget the errors of those before."""
        self.driver.get('about:blank')
        self._browser.open(url, width, height, dark=dark)

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
        return self._browser.overflow() > 0

"""Pages in headless Chromium, for tests and screenshots."""

from __future__ import annotations

import base64
import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

LIMIT_S = 60.0
"""Seconds after which a wait for a page has failed."""

POLL_S = 0.1

FLAGS = (
    '--headless=new',
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--disable-dev-shm-usage',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--hide-scrollbars',
    '--force-color-profile=srgb',
    # A page that needs more than this machine fails, also where there is a network.
    '--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost',
)


def missing_programs() -> list[str]:
    """Return what a browser needs and this machine does not have."""
    missing = [each for each in ('chromium', 'chromedriver') if shutil.which(each) is None]
    return missing if find_spec('selenium') else [*missing, 'selenium']


@contextmanager
def open_browser() -> Iterator[Browser]:
    """Start Chromium with an empty profile, and stop it afterwards."""
    # The other system tests need no selenium.
    from selenium.webdriver import Chrome, ChromeOptions  # noqa: PLC0415
    from selenium.webdriver.chrome.service import Service  # noqa: PLC0415

    options = ChromeOptions()
    options.binary_location = shutil.which('chromium') or ''
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in (*FLAGS, f'--user-data-dir={profile}'):
            options.add_argument(flag)
        driver = Chrome(options, Service(shutil.which('chromedriver')))
        try:
            yield Browser(driver)
        finally:
            driver.quit()


class Browser:
    """A browser with one page.

    Args:
        driver: the WebDriver of selenium, for what has no method here.
    """

    def __init__(self, driver: Chrome) -> None:
        self.driver = driver
        self._width = 0

    def open(self, url: str, width: int = 1400, height: int = 900, *, dark: bool = False) -> Self:
        """Load a page.

        Args:
            url: of the page.
            width: of the window in CSS pixels; below 600 it is the screen of a phone.
            height: likewise.
            dark: whether the user prefers dark pages.
        """
        theme = {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}
        self._command('Emulation.setEmulatedMedia', features=[theme])
        self.resize(width, height)
        self.driver.get_log('browser')
        self.driver.get_log('performance')
        self.driver.get(url)
        return self

    def resize(self, width: int, height: int) -> None:
        """Set the size of the window in CSS pixels; below a width of 600 it is a phone."""
        self._width = width
        self._command(
            'Emulation.setDeviceMetricsOverride',
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def run(self, script: str) -> Any:
        """Return the value of an expression in JavaScript."""
        return self.driver.execute_script(f'return ({script})')

    def wait_for(self, condition: str, limit: float = LIMIT_S) -> Any:
        """Wait until an expression in JavaScript is true, and return its value.

        Raises:
            AssertionError: if that takes longer than the limit, in seconds.
        """
        end = time.monotonic() + limit
        while not (found := self.run(condition)):
            if time.monotonic() > end:
                text = self.run('document.body.innerText.slice(0, 1000)')
                raise AssertionError(f'not within {limit} s: {condition}; the page is: {text}')
            time.sleep(POLL_S)
        return found

    def errors(self) -> list[str]:
        """Return the warnings and errors on the console since the last call."""
        entries = self.driver.get_log('browser')
        return [each['message'] for each in entries if each['level'] in {'SEVERE', 'WARNING'}]

    def requests(self) -> list[str]:
        """Return the addresses that the page has requested since the last call."""
        messages = (
            json.loads(each['message'])['message'] for each in self.driver.get_log('performance')
        )
        return [
            message['params']['request']['url']
            for message in messages
            if message['method'] == 'Network.requestWillBeSent'
        ]

    def overflow(self) -> int:
        """Return by how many pixels the page is wider than the window."""
        # Not innerWidth: a phone zooms out until a page fits that is too wide.
        return int(self.run('document.documentElement.scrollWidth')) - self._width

    def screenshot(self, path: Path, height: int | None = None) -> None:
        """Write a picture of the page as PNG: the window, or its first pixels of that height."""
        width, shown = self.run('[innerWidth, innerHeight]')
        clip = {'x': 0, 'y': 0, 'width': width, 'height': height or shown, 'scale': 1}
        picture = self._command(
            'Page.captureScreenshot', format='png', clip=clip, captureBeyondViewport=True
        )
        path.write_bytes(base64.b64decode(picture['data']))

    def _command(self, name: str, **arguments: Any) -> Any:
        return self.driver.execute_cdp_cmd(name, arguments)

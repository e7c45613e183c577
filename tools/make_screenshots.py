"""Make the screenshots of the README and the documentation: pages in Chromium, as small PNG files.

    source env.sh
    python tools/make_screenshots.py            # all of them
    python tools/make_screenshots.py report     # those whose names begin so

PAGES has what makes each page, and SCREENSHOTS the pictures of it. Commands that start nodes have a
ROS domain of their own.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from subprocess import DEVNULL, run
from tempfile import TemporaryDirectory

from PIL import Image

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / 'tests'))

from browser import Browser, open_browser  # noqa: E402 - of the folder of the tests
from system import private_environment  # noqa: E402

FOLDER = ROOT / 'docs' / 'images'
COLOURS = 128
MAX_BYTES = 150_000


@contextmanager
def page_of(*line: str) -> Iterator[str]:
    """Run a command that writes a page, and yield its address."""
    with TemporaryDirectory() as folder:
        page = Path(folder) / 'page.html'
        environment = {**os.environ, **private_environment()}
        # The exit code tells about formulas that are false, which are wanted.
        run([*line, str(page)], cwd=ROOT, env=environment, stdout=DEVNULL, check=False)
        yield page.as_uri()


PAGES: dict[str, Callable] = {
    # The flight of the demonstration.
    'report': partial(
        page_of, 'dyknow', 'check', 'dyknow_bringup/recordings/power_surge',
        '--config', 'dyknow_bringup/robots/uav.yaml', '--html',
    ),
}  # fmt: skip
"""Context managers that yield the address of a page."""


@dataclass(frozen=True)
class Screenshot:
    """A picture of a page.

    Args:
        name: of the file, without its suffix.
        page: the key of PAGES.
        width: of the window.
        height: of the picture.
        dark: whether the user prefers dark pages.
        ready: an expression in JavaScript that is true when the page is complete.
    """

    name: str
    page: str
    width: int = 1400
    height: int = 900
    dark: bool = False
    ready: str = "document.querySelectorAll('.js-plotly-plot').length"


SCREENSHOTS = (
    Screenshot('report', 'report', height=860),
    Screenshot('report_dark', 'report', height=860, dark=True),
    Screenshot('report_phone', 'report', width=390, height=844, dark=True),
)


def take(browser: Browser, address: str, screenshot: Screenshot) -> None:
    """Write a screenshot.

    Raises:
        RuntimeError: if it would be too large, or the page has errors.
    """
    browser.open(address, screenshot.width, screenshot.height, dark=screenshot.dark)
    browser.wait_for(screenshot.ready)
    path = FOLDER / f'{screenshot.name}.png'
    browser.screenshot(path)
    with Image.open(path) as picture:
        reduced = picture.convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE)
    reduced.save(path, optimize=True)
    if errors := browser.errors():
        raise RuntimeError(f'{screenshot.name}: {errors}')
    if (size := path.stat().st_size) > MAX_BYTES:
        raise RuntimeError(f'{path} has {size} bytes, more than {MAX_BYTES}: show less of the page')
    print(f'{path.relative_to(ROOT)}: {size} bytes')


def main():
    """Make the screenshots whose names begin with an argument, or all."""
    wanted = [each for each in SCREENSHOTS if each.name.startswith(tuple(sys.argv[1:] or ('',)))]
    with ExitStack() as stack:
        browser = stack.enter_context(open_browser())
        addresses = {
            name: stack.enter_context(PAGES[name]()) for name in {each.page for each in wanted}
        }
        for each in wanted:
            take(browser, addresses[each.page], each)


if __name__ == '__main__':
    main()

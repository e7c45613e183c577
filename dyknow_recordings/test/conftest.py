"""Makes the helpers of these tests importable, and keeps the signals of pytest."""

import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from running_checks import EndlessRecording
from small_bags import messages, write

from dyknow_common.executables import Interruption


@pytest.fixture(autouse=True, scope='session')
def _signals_are_those_of_pytest() -> Iterator[None]:
    """A command ends by ignoring signals; tests call it in their own process."""
    with pytest.MonkeyPatch.context() as patch:
        here = nullcontext(Interruption())
        patch.setattr('dyknow_recordings.check.interruptible', lambda: here)
        yield


@pytest.fixture(scope='session')
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Four bags; the first formula is false over the later ones."""
    folder = tmp_path_factory.mktemp('bags')
    paths = [folder / f'flight{number}' for number in range(4)]
    for number, path in enumerate(paths):
        write(path, 'mcap', 'none', messages(58 + number))
    return [str(path) for path in paths]


@pytest.fixture
def endless(tmp_path: Path) -> EndlessRecording:
    return EndlessRecording(tmp_path / 'endless.mcap')

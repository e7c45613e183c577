"""The libraries that only some options need, such as pictures."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dyknow_common import ExitCode
from dyknow_recordings.errors import RecordingError


def plotly_script() -> str:
    """Return the JavaScript of plotly.

    Raises:
        RecordingError: naming the mend, if plotly is not installed.
    """
    script: str = optional_library('plotly.offline', '--html').get_plotlyjs()
    return script


def optional_library(module: str, option: str, package: str = '') -> Any:
    """Return a module of a library that only an option needs, installed by the name of a package.

    Raises:
        RecordingError: naming the mend, if the library is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = package or module.partition('.')[0]
        raise RecordingError(
            f'{option} needs {library}: {error}; run: pip install {library}', ExitCode.UNAVAILABLE
        ) from None

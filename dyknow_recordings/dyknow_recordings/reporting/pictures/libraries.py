"""The libraries that only pictures need."""

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
    script: str = picture_library('plotly.offline', '--html').get_plotlyjs()
    return script


def picture_library(module: str, option: str) -> Any:
    """Return a module of a library that only an option needs.

    Raises:
        RecordingError: naming the mend, if the library is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition('.')[0]
        raise RecordingError(
            f'{option} needs {library}: {error}; run: pip install {library}', ExitCode.UNAVAILABLE
        ) from None

"""The files of pictures of a check."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from dyknow_common import DyKnowError
from dyknow_recordings.evaluation.results import RecordingReport
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.outputs import (
    CheckOutput,
    check_place,
    optional_library,
    write_report,
)


class PictureFiles(CheckOutput):
    """A page, an image and maps with the results of recordings. They are written at the end.

    Args:
        html: the file of the page; None for none.
        png: the file of the image; None for none.
        judgement: the judgement of undecided formulas.
        geojson: the file of the maps; None for none.

    Raises:
        RecordingError: if a file could not be written, or a library is missing; before the
            recordings are read.
    """

    def __init__(
        self,
        html: Path | None,
        png: Path | None,
        judgement: Judgement,
        geojson: Path | None = None,
    ) -> None:
        for option, path, library in (
            ('--html', html, 'plotly'),
            ('--png', png, 'matplotlib'),
            ('--geojson', geojson, 'shapely'),
        ):
            if path is not None:
                optional_library(library, option)
                check_place(option, path)
        self._geojson = geojson
        self._html = html
        self._png = png
        self._judgement = judgement
        self._reports: list[RecordingReport] = []
        self._failures: list[str] = []

    def add(self, report: RecordingReport) -> None:
        """Add the results of a recording, with its signals."""
        self._reports.append(report)

    def add_failure(self, recording: str | None, error: DyKnowError) -> None:  # noqa: ARG002
        """Add a recording that could not be checked, which the error names."""
        self._failures.append(error.message)

    def close(self, unchecked: Sequence[str]) -> None:
        """Write the files.

        Args:
            unchecked: the recordings that were not checked because of an interruption.

        Raises:
            RecordingError: naming a file that cannot be written.
        """
        self._failures += (f'{each}: not checked: interrupted' for each in unchecked)
        # The modules are imported here, as most checks draw nothing.
        if self._html is not None:
            from dyknow_recordings.reporting.pictures.page import report_page  # noqa: PLC0415

            page = report_page(self._reports, self._failures, self._judgement)
            write_report(self._html, page.encode())
        if self._png is not None:
            from dyknow_recordings.reporting.pictures.image import report_image  # noqa: PLC0415

            write_report(self._png, report_image(self._reports, self._judgement))
        if self._geojson is not None:
            from dyknow_recordings.reporting.pictures.maps import map_features  # noqa: PLC0415

            features = [each for report in self._reports for each in map_features(report)]
            document = {'type': 'FeatureCollection', 'features': features}
            write_report(self._geojson, json.dumps(document, allow_nan=False).encode())

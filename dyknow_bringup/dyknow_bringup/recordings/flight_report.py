"""A page about the flight of a scenario: the formulas, checked over its recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from dyknow_bringup.recordings.recording import record
from dyknow_bringup.simulation.scenario import Scenario
from dyknow_recordings import (
    MonitoringFiles,
    PictureFiles,
    RequestedFormula,
    evaluate_recording,
    open_recording,
)


def write_flight_report(
    scenario: Scenario,
    vehicles: Sequence[str],
    start: int,
    files: MonitoringFiles,
    formulas: Iterable[RequestedFormula],
    folder: Path,
    pictures: PictureFiles,
) -> None:
    """Record the flight of a scenario, and write a page about formulas over it.

    Args:
        scenario: it determines the flight.
        vehicles: the names of the fleet.
        start: the time of the first stamp, in nanoseconds since the epoch.
        files: the configuration of DyKnow for the fleet.
        formulas: to check.
        folder: for the recording.
        pictures: the files to write.

    Raises:
        DyKnowError: naming a file that cannot be written.
    """
    bag = folder / scenario.name
    record(scenario, vehicles, start, bag)
    with open_recording(bag) as recording:
        report = evaluate_recording(recording, list(formulas), files, keep_signals=True)
    pictures.add(report)
    pictures.close(())

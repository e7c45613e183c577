"""The file that describes three UAVs means what the demonstration makes for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_bringup.processes.processes import SystemConfiguration, write_fleet_configuration
from dyknow_bringup.processes.robot import with_robot
from dyknow_bringup.simulation.fleet import vehicle_names
from dyknow_configuration import read_robot
from dyknow_recordings import MonitoringFiles, evaluate_recording, open_recording
from dyknow_semantics import Ontology
from dyknow_stream_processing import parse_specification, specifications_by_sink


@pytest.fixture
def by_one_file(share: Path) -> SystemConfiguration:
    return with_robot(SystemConfiguration(), share / 'robots' / 'uav.yaml')


@pytest.fixture
def of_fleet(share: Path, tmp_path: Path) -> SystemConfiguration:
    ontology = share / 'ontology' / 'uav.owl'
    return write_fleet_configuration(vehicle_names(3), ontology, tmp_path)


def test_the_streams_are_the_same(
    by_one_file: SystemConfiguration, of_fleet: SystemConfiguration
) -> None:
    one, other = (
        {
            name: str(part)
            for path in each.streams
            for name, part in specifications_by_sink(parse_specification(path.read_text())).items()
        }
        for each in (by_one_file, of_fleet)
    )
    # It has a stream for each order of two vehicles.
    added = {name for name in one if name.endswith('_distance')} - {*other}
    assert added == {'uav2_uav1_distance', 'uav3_uav1_distance', 'uav3_uav2_distance'}
    assert {name: text for name, text in one.items() if name not in added} == other


def test_the_features_are_the_same(
    by_one_file: SystemConfiguration, of_fleet: SystemConfiguration
) -> None:
    found = []
    for each in (by_one_file, of_fleet):
        with Ontology() as ontology:
            for path in each.ontologies:
                ontology.load(path)
            found.append((ontology.knowledge.features, ontology.knowledge.instances('Vehicle')))
    assert found[0] == found[1]


@pytest.mark.parametrize('recording', ['nominal', 'power_surge'])
def test_the_verdicts_are_the_same(
    share: Path, by_one_file: SystemConfiguration, of_fleet: SystemConfiguration, recording: str
) -> None:
    formulas = read_robot(share / 'robots' / 'uav.yaml').formulas
    found = []
    for each in (by_one_file, of_fleet):
        files = MonitoringFiles(each.ontologies, each.annotations, each.streams)
        with open_recording(share / 'recordings' / recording) as source:
            report = evaluate_recording(source, formulas, files)
        found.append([(each.name, each.states, each.episodes) for each in report.formulas])
    assert len(found[0]) == 6
    assert found[0] == found[1]

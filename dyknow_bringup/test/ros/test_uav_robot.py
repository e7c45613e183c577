"""The file that describes the UAVs of the demonstration, with any number of vehicles."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_bringup.processes.robot import fleet_configuration, requested_streams
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_configuration import read_robot
from dyknow_recordings import MonitoringFiles, evaluate_recording, open_recording
from dyknow_semantics import Ontology, check_annotation, parse_annotations


@pytest.mark.parametrize('count', [1, 2, 5])
def test_every_stream_has_a_meaning(count: int) -> None:
    vehicles = vehicle_names(count)
    fleet = fleet_configuration(vehicles)
    streams = {
        *(f'{each}_{kind}' for each in vehicles for kind in ('power', 'altitude', 'speed')),
        *(f'{each}_position' for each in vehicles),
        *(f'{a}_{b}_distance' for a in vehicles for b in vehicles if a != b),
    }
    assert requested_streams(fleet) == streams
    (annotations,) = fleet.annotations
    parsed = parse_annotations(annotations.read_text(encoding='utf-8'))
    assert {each.stream for each in parsed} == streams
    with Ontology() as ontology:
        for path in fleet.ontologies:
            ontology.load(path)
        assert set(ontology.knowledge.instances('UAV')) == set(vehicles)
        for annotation in parsed:
            check_annotation(annotation, ontology.knowledge)


def test_the_features_are_those_of_the_ontology_that_is_shipped(share: Path) -> None:
    found = []
    for path in (share / 'ontology' / 'uav.owl', *fleet_configuration(['uav1']).ontologies):
        with Ontology() as ontology:
            ontology.load(path)
            found.append(ontology.knowledge.features)
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ('recording', 'decided'),
    [
        ('nominal', {'power': 'undecided', 'takeoff': 'true'}),
        ('power_surge', {'power': 'false', 'takeoff': 'true'}),
    ],
)
def test_the_verdicts_over_the_recordings(
    share: Path, recording: str, decided: dict[str, str]
) -> None:
    fleet = fleet_configuration(vehicle_names(3))
    formulas = read_robot(share / 'robots' / 'uav.yaml').formulas
    files = MonitoringFiles(fleet.ontologies, fleet.annotations, fleet.streams)
    with open_recording(share / 'recordings' / recording) as source:
        report = evaluate_recording(source, formulas, files)
    outcomes = {each.name: str(each.outcome) for each in report.formulas}
    undecided = dict.fromkeys(('separation', 'ceiling', 'geofence', 'speed_limit'), 'undecided')
    assert outcomes == undecided | decided

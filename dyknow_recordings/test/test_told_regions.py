"""Formulas about regions whose relations are drawn, told, or not known."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

from dyknow_configuration import read_robot
from dyknow_recordings import MonitoringFiles, evaluate_recording, open_recording

pytestmark = pytest.mark.skipif(find_spec('shapely') is None, reason='shapely is not installed')

ROBOT = """
objects: {Room: [kitchen, hall]}
regions:
  flat: {is: Flat, frame: map, wkt: 'POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0))'}
  office: {is: Office, frame: map, wkt: 'POLYGON ((20 0, 29 0, 29 9, 20 0))'}
relations: [kitchen part_of flat, 'hall {EC, DC} flat']
formulas:
"""
OUTCOMES = {
    'part_of[kitchen, flat] and DC[flat, office]': 'true',
    'forall z in Room: not overlaps(z, flat)': 'false',
    'forall z in Room: apart(z, flat) or touches(z, flat) or part_of(z, flat)': 'true',
    '(always DC[hall, flat]) or (always not DC[hall, flat])': 'true',
    'forall z in Room: part_of(z, flat) -> eventually speed > 1': 'true',
    'forall z in Room: EC[z, flat] -> always speed < 1': 'undecided',
    'TPP[kitchen, flat] and eventually[0 s, 1 s] speed > 1': 'false',
    'exists z in Room: EC[z, flat]': 'error',
}


def test_formulas_over_told_regions(tmp_path: Path) -> None:
    formulas = [f'  - {{name: f{at}, formula: "{text}"}}\n' for at, text in enumerate(OUTCOMES)]
    (tmp_path / 'robot.yaml').write_text(ROBOT + ''.join(formulas))
    (tmp_path / 'trace.csv').write_text('time_s,speed\n0,0.5\n1,0.7\n2,1.4\n')
    robot = read_robot(tmp_path / 'robot.yaml')
    files = MonitoringFiles(robot.ontologies, robot.annotations, robot.streams)
    with open_recording(tmp_path / 'trace.csv') as recording:
        report = evaluate_recording(recording, robot.formulas, files)
    found = [str(each.outcome) for each in report.formulas]
    assert found == [*OUTCOMES.values()]
    assert 'the relations of flat, hall are not known' in str(report.formulas[-1].error)

"""Margins of formulas over recordings."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from running_checks import CheckOutput, run_check

ONTOLOGY = """\
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix : <http://example.org/r#> .
<http://example.org/r> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
:Power a owl:Class ; rdfs:subClassOf dyknow:NullaryFeature ;
  dyknow:value_type "float" ; dyknow:unit "W" .
:MotorPower a owl:Class ; rdfs:subClassOf :Power .
:Robot a owl:Class ; rdfs:subClassOf dyknow:Object .
:r1 a :Robot .
:Range a owl:Class ; rdfs:subClassOf dyknow:Feature ; dyknow:argument1 :Robot ;
  dyknow:value_type "float" ; dyknow:unit "m" .
:LaserRange a owl:Class ; rdfs:subClassOf :Range .
"""
TRACE = 'time_s,MotorPower,x,LaserRange[r1]\n0,100,1,7\n1,142.5,2,6\n2,130,4,8\n'


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    (tmp_path / 'r.ttl').write_text(ONTOLOGY, encoding='utf-8')
    path = tmp_path / 'flight.csv'
    path.write_text(TRACE, encoding='utf-8')
    return path


def check(recording: Path, *options: str) -> CheckOutput:
    ontology = recording.with_name('r.ttl')
    return run_check(recording, '--ontology', ontology, '--margins', *options)


def margin(lower: float | str, upper: float, atom: str, unit: str = '') -> dict[str, object]:
    return {'lower': lower, 'upper': upper, 'unit': unit, 'atom': atom}


def test_margins_in_tables(recording: Path) -> None:
    words = ' '.join(check(recording, '--formula', 'always x < 5').out.replace('│', ' ').split())
    assert 'margin' in words
    assert 'at most 1 (x <' in words
    assert 'margin ' not in run_check(recording, '--formula', 'always x < 5').out


@pytest.mark.parametrize(
    ('formula', 'expected'),
    [
        ('always x < 5', [margin('-inf', 1.0, 'x < 5')]),
        ('always[0 s, 2 s] x < 5', [margin(1.0, 1.0, 'x < 5')]),
        ('always x < 3', [margin('-inf', -1.0, 'x < 3')]),
        ('x < (', []),
        # Sorts and units come from the ontology.
        (
            'forall r: always LaserRange[r] > 1',
            [margin('-inf', 5.0, 'LaserRange[r1] > 1', 'm')],
        ),
        ('always MotorPower < 150', [margin('-inf', 7.5, 'MotorPower < 150', 'W')]),
    ],
)
def test_margins_in_json(recording: Path, formula: str, expected: list[dict[str, object]]) -> None:
    [found] = check(recording, '--json', '--formula', formula).formulas
    assert [each['margin'] for each in found['episodes']] == expected
    if 'forall r:' in formula:
        assert found['formula'] == 'forall r in Robot: (always (LaserRange[r] > 1))'


def test_units_that_a_formula_states(recording: Path) -> None:
    """The formula of a black box states the units, as the ontology is not there."""
    text = 'let MotorPower: "W" in (always MotorPower < 0.15 "kW")'
    [found] = run_check(recording, '--margins', '--json', '--formula', text).formulas
    (episode,) = found['episodes']
    assert episode['margin'] == margin('-inf', 7.5, 'MotorPower < 150.0', 'W')


def test_the_worst_margin_of_several_episodes(recording: Path, tmp_path: Path) -> None:
    report = tmp_path / 'report.xml'
    # Of the states at 0 s and 2 s.
    options = ('--every', 'x < 2 or x > 3', '--junit', str(report))
    assert '1 (x < 5)' in check(recording, *options, '--formula', 'x < 5').out
    suite = ET.parse(report).getroot()[0]  # noqa: S314 - our own file
    found = {each.get('name'): each.get('value') for each in suite.iter('property')}
    assert found == {
        'margin_lower of x < 5': '1.0',
        'margin_upper of x < 5': '1.0',
        'margin_unit of x < 5': '',
        'margin_atom of x < 5': 'x < 5',
    }


def test_margins_from_every_state(recording: Path) -> None:
    options = ('--every', 'state', '--formula')
    found = check(recording, '--json', *options, 'always[0 s, 1 s] x < 4')
    assert found.code == 1
    [report] = found.formulas
    assert [each['margin'] for each in report['episodes']] == [
        margin(2.0, 2.0, 'x < 4'),
        margin(0.0, 0.0, 'x < 4'),
        margin('-inf', 0.0, 'x < 4'),
    ]
    assert '-1.5 W' in check(recording, *options, 'MotorPower < 141').out

"""Margins of formulas over recordings."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from dyknow_recordings.check import main

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


def check(recording: Path, *options: str) -> int:
    ontology = str(recording.with_name('r.ttl'))
    return main([str(recording), '--ontology', ontology, '--margins', *options])


def test_margins_in_tables(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(recording, '--formula', 'always x < 5')
    words = ' '.join(capsys.readouterr().out.replace('│', ' ').split())
    assert 'margin' in words
    assert 'at most 1 (x <' in words
    main([str(recording), '--formula', 'always x < 5'])
    assert 'margin ' not in capsys.readouterr().out


def test_margins_in_json(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formulas = ['always x < 5', 'always[0 s, 2 s] x < 5', 'always x < 3', 'x < (']
    check(recording, '--json', *(word for each in formulas for word in ('--formula', each)))
    document = json.loads(capsys.readouterr().out)
    found = [each['episodes'][0]['margin'] for each in document['formulas'][:3]]
    assert found == [
        {'lower': '-inf', 'upper': 1.0, 'unit': '', 'atom': 'x < 5'},
        {'lower': 1.0, 'upper': 1.0, 'unit': '', 'atom': 'x < 5'},
        {'lower': '-inf', 'upper': -1.0, 'unit': '', 'atom': 'x < 3'},
    ]
    assert document['formulas'][3]['episodes'] == []


def test_the_worst_margin_of_several_episodes(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / 'report.xml'
    # Of the states at 0 s and 2 s.
    trigger = 'x < 2 or x > 3'
    check(recording, '--every', trigger, '--junit', str(report), '--formula', 'x < 5')
    assert '1 (x < 5)' in capsys.readouterr().out
    suite = ET.parse(report).getroot()[0]  # noqa: S314 - our own file
    found = {each.get('name'): each.get('value') for each in suite.iter('property')}
    assert found == {
        'margin_lower of x < 5': '1.0',
        'margin_upper of x < 5': '1.0',
        'margin_unit of x < 5': '',
        'margin_atom of x < 5': 'x < 5',
    }


def test_margins_from_every_state(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formula = 'always[0 s, 1 s] x < 4'
    assert check(recording, '--json', '--every', 'state', '--formula', formula) == 1
    [report] = json.loads(capsys.readouterr().out)['formulas']
    assert [each['margin'] for each in report['episodes']] == [
        {'lower': 2.0, 'upper': 2.0, 'unit': '', 'atom': 'x < 4'},
        {'lower': 0.0, 'upper': 0.0, 'unit': '', 'atom': 'x < 4'},
        {'lower': '-inf', 'upper': 0.0, 'unit': '', 'atom': 'x < 4'},
    ]


def test_margins_from_every_state_have_units(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check(recording, '--every', 'state', '--formula', 'MotorPower < 141')
    assert '-1.5 W' in capsys.readouterr().out


def test_sorts_are_inherited(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(recording, '--json', '--formula', 'forall r: always LaserRange[r] > 1')
    [formula] = json.loads(capsys.readouterr().out)['formulas']
    assert formula['formula'] == 'forall r in Robot: (always (LaserRange[r] > 1))'
    expected = {'lower': '-inf', 'upper': 5.0, 'unit': 'm', 'atom': 'LaserRange[r1] > 1'}
    assert formula['episodes'][0]['margin'] == expected


def test_units_come_from_the_ontology(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(recording, '--json', '--formula', 'always MotorPower < 150')
    [formula] = json.loads(capsys.readouterr().out)['formulas']
    expected = {'lower': '-inf', 'upper': 7.5, 'unit': 'W', 'atom': 'MotorPower < 150'}
    assert formula['episodes'][0]['margin'] == expected

"""Outputs of a check: JSON lines that their schema describes, and reports of JUnit."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from jsonschema.validators import Draft202012Validator, extend
from small_bags import START, messages, write

from dyknow_common import SECOND_NS, ExitCode, Verdict
from dyknow_recordings import Episode, FormulaReport, RecordingError, RecordingReport, StateGap
from dyknow_recordings.check import main
from dyknow_recordings.health import BrokenExpectation
from dyknow_recordings.reporting.judgement import Judgement
from dyknow_recordings.reporting.junit import JUnitReport
from dyknow_recordings.reporting.outputs import AllOutputs, recording_document
from dyknow_recordings.reporting.pictures.files import PictureFiles
from dyknow_recordings.reporting.table import Tables
from dyknow_stream_processing import Violation

GOLDEN = Path(__file__).parent / 'golden'
SCHEMA = Path(__file__).parents[2] / 'docs' / 'recordings.schema.json'
MISSED = Episode(START, residual_formula='eventually a.x = 1', presumably_false=True)
UNBROKEN = Episode(START, residual_formula='always a.x = 1')
FORMULAS = (
    FormulaReport('holds', 'a.x = 1', (Episode(START, Verdict.TRUE, START, 'a.x = 1 at 0 s'),)),
    FormulaReport(
        'breaks',
        'always a.x < 2',
        (
            Episode(START, Verdict.FALSE, START + 1_500_000_000, 'a.x = 3 is not < 2 & "bad"'),
            Episode(START + 1, Verdict.TRUE, START + SECOND_NS, 'well'),
        ),
        states=3,
        violations=(Violation('a', 'max_delay', START, START + 1, 2, 1, 'late'),),
        gaps=(StateGap(START, START + 5), StateGap(START, None)),
        events=('stream a is gone',),
    ),
    FormulaReport('waits', 'always a.x = 1', (UNBROKEN,), waits_for='nothing comes'),
    FormulaReport('misses', 'eventually a.x = 1', (UNBROKEN, MISSED)),
    FormulaReport('fails', 'always (', error=RecordingError('line 1\n\x07', ExitCode.NOT_FOUND)),
    FormulaReport(
        'stops', 'always a.x = 2', (Episode(START, error=RecordingError('gone')), UNBROKEN)
    ),
    FormulaReport('never', 'a.x = 3'),
)
REPORT = RecordingReport('/data/day.1/flight.mcap', START, START + 2_345_678_901, FORMULAS, ('n',))


DESCRIBED = json.loads(SCHEMA.read_text(encoding='utf-8'))
# Python writes integers and floats as such.
TYPES = Draft202012Validator.TYPE_CHECKER.redefine_many(
    {
        'integer': lambda _, value: type(value) is int,
        'number': lambda _, value: type(value) is float,
    }
)
Line = extend(Draft202012Validator, type_checker=TYPES)


def faults(value: Any, schema: Any = DESCRIBED) -> list[str]:
    """Return the differences between a value and a schema."""
    found = Line(schema).iter_errors(value)
    return [f'{each.json_path}: {each.message}' for each in found]


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('bags') / 'flight'
    write(path, 'mcap', 'none', messages(60))
    return path


def test_lines_of_json_follow_their_schema(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kinds = ('results', 'topics', 'health', 'failure')
    assert DESCRIBED['oneOf'] == [{'$ref': f'#/$defs/{name}'} for name in kinds]
    z = '"/odom".pose.pose.position.z'
    formulas = [f'always {z} < 50', f'eventually {z} > 90', 'always x.y = 1', f'{z} < 80', 'true']
    options = [word for each in formulas for word in ('--formula', each)]
    main([str(bag), 'missing', *options, '--json', '--every', 'state'])
    main([str(bag), *options, '--json', '--margins'])
    main([str(bag), '--topics', '--json'])
    main([str(bag), '--health', '--json'])
    main([str(bag), '--json'])
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(documents) == 6
    documents.append(json.loads(json.dumps(recording_document(REPORT, Judgement.AUTO))))
    for each in documents:
        assert faults(each) == []


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'notes': None}, "$.notes: None is not of type 'array'"),
        ({'more': 1}, "'more' was unexpected"),
        ({'start_ns': 1.0}, '$.start_ns: 1.0'),
        ({'formulas': [{}]}, "$.formulas[0]: 'outcome' is a required property"),
    ],
)
def test_the_schema_refuses_others(change: dict[str, Any], message: str) -> None:
    document = json.loads(json.dumps(recording_document(REPORT, Judgement.AUTO))) | change
    results = {'$defs': DESCRIBED['$defs'], '$ref': '#/$defs/results'}
    assert message in '\n'.join(faults(document, results))
    assert faults(document)


def test_all_outputs_count_times_from_the_start_as_begin_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The first state was valid 5 ms before the first message was logged.
    begin, reason = START - 5_000_000, f'a.x = 3 at {START // SECOND_NS}.245 s is not < 2'
    episode = Episode(begin, Verdict.FALSE, START + 240_000_000, reason)
    formula = FormulaReport('a', 'let a.x: "m" in (always a.x < 2 "m")', (episode,), states=9)
    report = RecordingReport('flight.mcap', START, START + SECOND_NS, (formula,))
    paths = tmp_path / 'out.xml', tmp_path / 'out.html'
    files = JUnitReport(paths[0], Judgement.AUTO), PictureFiles(paths[1], None, Judgement.AUTO)
    output = AllOutputs([*files, Tables(Judgement.AUTO)])
    output.add(report)
    output.close(())
    for text in (*(each.read_text(encoding='utf-8') for each in paths), capsys.readouterr().out):
        assert 'a.x = 3 at 0.245 s is not' in text
    assert 'formula: always (a.x &lt; 2 m)' in paths[0].read_text(encoding='utf-8')


def test_the_place_of_an_error_is_below_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    fault = "a:1:9: did you mean '<='?\n  always x =< 1\n           ^"
    report = FormulaReport('a', 'always x =< 1', error=RecordingError(fault))
    Tables(Judgement.AUTO).add(RecordingReport('b', START, START + SECOND_NS, (report,)))
    shown = capsys.readouterr().out
    assert "│ a:1:9: did you mean '<='? │" in shown
    assert shown.endswith('a:\n  always x =< 1\n           ^\n')


def test_a_report_of_junit(tmp_path: Path) -> None:
    path = tmp_path / 'out.xml'
    output = AllOutputs([JUnitReport(path, Judgement.AUTO)])
    output.add(REPORT)
    output.add_failure('../flight2', RecordingError('../flight2: no such recording'))
    output.add_failure(None, RecordingError('the configuration is wrong'))
    assert not path.exists()
    output.close(['flight3'])
    assert path.read_text(encoding='utf-8') == (GOLDEN / 'junit.xml').read_text(encoding='utf-8')
    assert [each.name for each in tmp_path.iterdir()] == ['out.xml']


@pytest.mark.parametrize(
    ('judgement', 'failed'),
    [
        (Judgement.AUTO, ['breaks', 'misses']),
        (Judgement.PASS, ['breaks']),
        (Judgement.FAIL, ['breaks', 'waits', 'misses', 'never']),
    ],
)
def test_undecided_formulas_in_junit(
    tmp_path: Path, judgement: Judgement, failed: list[str]
) -> None:
    output = JUnitReport(tmp_path / 'out.xml', judgement)
    output.add(REPORT)
    output.close(())
    (suite,) = ET.parse(tmp_path / 'out.xml').getroot()  # noqa: S314 - our own file
    assert [each.get('name') for each in suite if each.find('failure') is not None] == failed
    assert suite.get('failures') == str(len(failed))
    assert suite.get('errors') == '2'


def test_test_cases_of_one_name_have_numbers(tmp_path: Path) -> None:
    broken = tuple(BrokenExpectation('/a', rule, 'slow') for rule in ('min_rate', 'type') * 2)
    output = JUnitReport(tmp_path / 'out.xml', Judgement.AUTO)
    output.add(replace(REPORT, formulas=REPORT.formulas[:1] * 2, broken=broken))
    output.close(())
    (suite,) = ET.parse(tmp_path / 'out.xml').getroot()  # noqa: S314 - our own file
    names = [each.get('name', '') for each in suite.iter('testcase')]
    topic = ['/a min_rate', '/a type', '/a min_rate (2)', '/a type (2)']
    assert names[1:] == [f'{names[0]} (2)', *topic]


def test_a_report_of_junit_of_the_command(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'out.xml'
    formula = ['--formula', 'always "/odom".pose.pose.position.z < 50']
    contents = set()
    for jobs in '12':
        options = ['--junit', str(path), '--jobs', jobs]
        assert main([str(bag), str(bag), *formula, *options]) == 1
        contents.add(path.read_text(encoding='utf-8'))
    (content,) = contents
    assert content.count('<failure') == 2
    assert main([str(bag), '--junit', str(path)]) == 2
    assert 'there is no formula to check' in path.read_text(encoding='utf-8')
    capsys.readouterr()
    assert main([str(bag), *formula, '--junit', str(tmp_path / 'missing' / 'out.xml')]) == 2
    captured = capsys.readouterr()
    assert (captured.out, 'out.xml: there is no folder' in captured.err) == ('', True)
    assert main([str(bag), *formula, '--junit', str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err

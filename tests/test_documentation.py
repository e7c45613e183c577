"""Every example that users read is true: it parses, and is what the example files say."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import dyknow_command
from dyknow_common import NO_CONSTRAINTS, InlineText, LanguageError, SymbolKind
from dyknow_configuration import ConfigurationError, read_robot
from dyknow_reasoning import check_types, parse_formula, symbols_of
from dyknow_semantics import (
    Annotation,
    Knowledge,
    Ontology,
    check_annotation,
    match,
    parse_annotations,
    parse_bridges,
    parse_concept,
)
from dyknow_stream_processing import (
    load_units,
    made,
    parse_specification,
    resolve,
    specifications_by_sink,
)

ROOT = Path(__file__).parent.parent
SHIPPED_UNITS = 'dyknow_stream_processing.'
EXAMPLES = ROOT / 'docs' / 'examples'
CONFIGURATION = 'docs/configuration.md'
MEANING = 'docs/meaning.md'
UNCERTAINTY = 'docs/uncertainty.md'
FORMULAS = 'docs/formulas.md'
STREAMS = 'docs/streams.md'
ONTOLOGY = 'docs/ontology.md'
DOCUMENTS = (
    'README.md',
    'docs/clients.md',
    CONFIGURATION,
    'docs/index.md',
    'docs/languages.md',
    UNCERTAINTY,
    FORMULAS,
    'docs/space_graph.md',
    'docs/space_relations.md',
    STREAMS,
    ONTOLOGY,
    MEANING,
    'docs/space.md',
)

_BLOCK = re.compile(r'^```(?P<language>\w+)\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)


def blocks(document: str, language: str) -> list[str]:
    """The fenced blocks of a document in one language."""
    text = (ROOT / document).read_text(encoding='utf-8')
    return [each['text'] for each in _BLOCK.finditer(text) if each['language'] == language]


def excerpt(language: str, document: str = 'README.md') -> str:
    """The one block of a language in a document."""
    (text,) = blocks(document, language)
    return text


def example(name: str) -> str:
    """The text of an example file."""
    return (EXAMPLES / name).read_text(encoding='utf-8')


def every(language: str) -> list[object]:
    """A parameter for each block of a language in all documents."""
    return [
        pytest.param(text, id=f'{document}-{number}')
        for document in DOCUMENTS
        for number, text in enumerate(blocks(document, language), start=1)
    ]


def statements(text: str) -> list[str]:
    """The lines that say something: neither empty nor comments."""
    return [line for line in text.splitlines() if line and not line.startswith('#')]


@pytest.fixture(scope='module')
def knowledge() -> Iterator[Knowledge]:
    with Ontology() as ontology:
        ontology.load(EXAMPLES / 'rover.owl')
        yield ontology.knowledge


@pytest.fixture(scope='module')
def rover_annotations() -> tuple[Annotation, ...]:
    return parse_annotations(example('rover.ssl'))


@pytest.mark.parametrize(
    ('document', 'languages'),
    [
        (FORMULAS, ('formula', 'python')),
        (STREAMS, ('streams', 'python')),
        (ONTOLOGY, ('ssl', 'bridges')),
    ],
)
def test_the_manual_shows_every_language(document: str, languages: tuple[str, ...]) -> None:
    for language in languages:
        assert blocks(document, language), language


def test_a_wrong_example_would_be_noticed() -> None:
    with pytest.raises(LanguageError):
        parse_specification('stream a = select from b')
    with pytest.raises(LanguageError):
        parse_formula('always until p')
    with pytest.raises(LanguageError):
        parse_annotations('stream a contains = b')


@pytest.mark.parametrize('text', every('formula'))
def test_formulas_make_sense(text: str) -> None:
    for line in text.splitlines():
        check_types(parse_formula(line), line)


def test_both_spellings_are_one_formula() -> None:
    ascii_spelling, symbols, *_ = blocks(FORMULAS, 'formula')[0].splitlines()
    assert '□' in symbols
    assert parse_formula(symbols) == parse_formula(ascii_spelling)


@pytest.mark.parametrize('text', every('streams'))
def test_streams_can_be_made(text: str) -> None:
    specification = parse_specification(text)
    assert parse_specification(str(specification)) == specification
    made(specification)


@pytest.mark.parametrize('text', every('ssl'))
def test_annotations_parse(text: str) -> None:
    annotations = parse_annotations(text)
    assert parse_annotations(''.join(map(str, annotations))) == annotations


@pytest.mark.parametrize('text', every('bridges'))
def test_bridges_parse(text: str) -> None:
    bridges = parse_bridges(text)
    assert parse_bridges(''.join(map(str, bridges))) == bridges


@pytest.mark.parametrize('text', every('python'))
def test_python_compiles(text: str) -> None:
    compile(text, 'example', 'exec')


def test_the_formula_group_of_the_manual_finds_the_surge(
    capsys: pytest.CaptureFixture[str],
) -> None:
    (text,) = blocks(FORMULAS, 'python')
    exec(compile(text, 'example', 'exec'), {})  # noqa: S102
    told = capsys.readouterr().out
    assert told.startswith('power FALSE 5000000000 for u = uav2: ')
    assert told.endswith(' None\n')


def test_the_computational_units_of_the_manual_are_those_that_come_with_dyknow() -> None:
    text = (ROOT / STREAMS).read_text(encoding='utf-8')
    text = text.partition('## Computational units')[2].partition('\n#')[0]
    rows = re.findall(r'^\| (`.*?`) \|', text, re.MULTILINE)
    shipped = {
        name for name, unit in load_units().items() if unit.__module__.startswith(SHIPPED_UNITS)
    }
    assert {name for row in rows for name in re.findall(r'`(\w+)`', row)} == shipped


USE_OF_UNITS = """
from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing import Dataflow, Sample, load_units, parse_specification

samples = []
dataflow = Dataflow(load_units(), lambda topic: None)
dataflow.create('s', parse_specification('compunit slip: float wheel_slip(speed: float, '
    'speed: float); sink wheel_slip("wheels", "ground")'), NO_CONSTRAINTS, samples.append, print)
for topic, speed in ('wheels', 2.0), ('ground', 1.5):
    dataflow.push(topic, Sample(1, 2, {'speed': speed}))
print(dict(samples[0].fields))
"""


def test_the_package_of_units_can_be_installed_and_used(tmp_path: Path) -> None:
    setup, module = (
        text for text in blocks(STREAMS, 'python') if 'rover_units' in text or 'slip' in text
    )
    package, installed = tmp_path / 'rover_units', tmp_path / 'installed'
    package.mkdir()
    installed.mkdir()
    (package / 'setup.py').write_text(setup, encoding='utf-8')
    (package / 'rover_units.py').write_text(module, encoding='utf-8')
    # What pip does, without fetching the tools that it would build a wheel with.
    steps = ('--quiet', 'egg_info', '--egg-base', installed, 'build_py', '--build-lib', installed)
    subprocess.run([sys.executable, 'setup.py', *steps], cwd=package, check=True, timeout=60)
    paths = os.pathsep.join([str(installed), os.environ.get('PYTHONPATH', '')])
    used = subprocess.run(
        [sys.executable, '-c', USE_OF_UNITS],
        env={**os.environ, 'PYTHONPATH': paths},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (used.stdout, used.stderr) == ("{'slip': 0.25}\n", '')


def test_the_readme_shows_the_robot_that_is_shipped() -> None:
    assert statements(excerpt('yaml')) == statements(example('rover.yaml'))


@pytest.mark.parametrize(
    'text',
    blocks('README.md', 'yaml')
    + blocks(CONFIGURATION, 'yaml')
    + blocks(UNCERTAINTY, 'yaml')
    + blocks('docs/guards.md', 'yaml')
    + blocks('docs/space.md', 'yaml')
    + blocks(MEANING, 'yaml')
    + blocks('docs/uncertainty.md', 'yaml')
    + blocks('docs/tutorial.md', 'yaml'),
)
def test_robots_can_be_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(text, encoding='utf-8')
    robot = read_robot(path)
    sources = (*robot.ontologies, *robot.annotations, *robot.streams)
    assert sources or robot.topics
    with Ontology() as ontology:
        for source in robot.ontologies:
            assert isinstance(source, InlineText)
            ontology.load_text(source.text)
        for source in robot.annotations:
            assert isinstance(source, InlineText)
            (annotation,) = parse_annotations(source.text)
            check_annotation(annotation, ontology.knowledge)


@pytest.mark.parametrize('text', blocks('docs/federation.md', 'yaml'))
def test_federations_can_be_read(text: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / 'docs' / 'examples' / 'federation', tmp_path, dirs_exist_ok=True)
    path = tmp_path / 'robot.yaml'
    path.write_text(text, encoding='utf-8')
    assert read_robot(path).federation


@pytest.mark.parametrize('text', blocks('docs/monitoring.md', 'yaml'))
def test_files_of_formulas_can_be_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(text, encoding='utf-8')
    assert read_robot(path).formulas


def test_the_manual_shows_a_fault_as_it_is(tmp_path: Path) -> None:
    text = (ROOT / CONFIGURATION).read_text(encoding='utf-8')
    shown = text.partition('```\nrobot.yaml:12:')[2].partition('\n```')[0]
    formula = shown.splitlines()[1].removeprefix('  ')
    path = tmp_path / 'robot.yaml'
    path.write_text('formulas:\n' + '\n' * 9 + f'  - name: slow\n{formula}\n', encoding='utf-8')
    with pytest.raises(ConfigurationError) as error:
        read_robot(path)
    assert str(error.value) == f'{path}:12:{shown}'


def test_the_manual_shows_the_annotations_that_are_shipped() -> None:
    assert statements(excerpt('ssl', CONFIGURATION)) == statements(example('rover.ssl'))


def test_the_manual_shows_the_streams_that_are_shipped() -> None:
    shown = blocks(CONFIGURATION, 'streams')[-1]
    assert statements(shown) == statements(example('rover.streams'))


def test_the_annotations_fit_the_ontology(
    rover_annotations: tuple[Annotation, ...], knowledge: Knowledge
) -> None:
    for annotation in rover_annotations:
        check_annotation(annotation, knowledge)


def test_the_streams_have_the_fields_that_are_annotated(
    rover_annotations: tuple[Annotation, ...],
) -> None:
    streams = specifications_by_sink(parse_specification(example('rover.streams')))
    annotated = [annotation for annotation in rover_annotations if not annotation.is_topic]
    assert {annotation.stream for annotation in annotated} == set(streams)
    for annotation in annotated:
        specification = streams[annotation.stream]
        resolved = resolve(specification, NO_CONSTRAINTS, {}, lambda _: None, load_units())
        assert {content.field for content in annotation.contents} <= set(resolved.fields or ())


def test_the_formula_of_the_node_is_about_what_is_annotated(
    rover_annotations: tuple[Annotation, ...], knowledge: Knowledge
) -> None:
    symbols = symbols_of(parse_formula(_constant('FORMULA', example('stop_when_empty.py'))))
    sorts = [symbol.name for symbol in symbols if symbol.kind is SymbolKind.SORT]
    features = [symbol.name for symbol in symbols if symbol.kind is SymbolKind.FEATURE]
    objects = {each for sort in sorts for each in knowledge.instances(sort)}
    assert objects
    for feature in features:
        found = {
            each.ground_feature
            for each in match(parse_concept(feature), rover_annotations, knowledge)
        }
        assert found == {f'{feature}[{each}]' for each in objects}


def _constant(name: str, source: str) -> str:
    """The string that a module assigns to a name."""
    for statement in ast.parse(source).body:
        match statement:
            case ast.Assign([ast.Name(assigned)], ast.Constant(str(value))) if assigned == name:
                return value
    raise AssertionError(name)


def printed(verb: str) -> str:
    """Return the output that the page on configuration shows for a verb."""
    text = (ROOT / CONFIGURATION).read_text(encoding='utf-8')
    (found,) = re.findall(rf'^\$ dyknow {verb} .*\n((?:.*\n)*?)```$', text, re.MULTILINE)
    return str(found)


def test_the_suggestion_of_the_manual(capsys: pytest.CaptureFixture[str]) -> None:
    recording = ROOT / 'dyknow_bringup' / 'recordings' / 'nominal'
    assert dyknow_command.main(['suggest', '/uav1/battery', str(recording)]) == 0
    assert capsys.readouterr().out == printed('suggest')


def test_the_findings_of_the_manual() -> None:
    shown = (ROOT / 'dyknow_command/test/linted/robot.expected').read_text(encoding='utf-8')
    assert printed('lint') in shown


def test_the_proposal_of_the_manual() -> None:
    (text,) = (each for each in blocks(CONFIGURATION, 'yaml') if '# Seen:' in each)
    proposed = ROOT / 'dyknow_command/test/proposed/nominal.yaml'
    lines = proposed.read_text(encoding='utf-8').splitlines()
    assert set(text.splitlines()) - {'  Uav: [uav1, uav2]'} <= {*lines}

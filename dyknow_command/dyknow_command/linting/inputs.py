"""The files of a check: their texts, formulas and places, and the faults in each by itself."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from dyknow_command.linting.findings import (
    FilePlace,
    Finding,
    FindingLevel,
    error_at,
    robot_error,
)
from dyknow_common import (
    DyKnowError,
    InlineText,
    LanguageError,
    TextPosition,
    position_at,
    read_text,
)
from dyknow_configuration import (
    ConfigurationError,
    RequestedFormula,
    RequestedGuard,
    RobotConfiguration,
    RobotFaults,
    TextSource,
    TopicExpectation,
    Trigger,
    YamlValue,
    find_faults,
    formula_lines,
    is_parameter_file,
    misspelt_nodes,
    parameter_faults,
    read_formulas,
    read_yaml,
)
from dyknow_reasoning import check_types, parse_formula
from dyknow_recordings import MonitoringFiles
from dyknow_stream_processing import parse_specification

MAX_STATEMENT_FAULTS: Final = 50
"""The number of faults in one text after which no more are looked for."""

_PART: Final = re.compile(r'"(?:\\.|[^"\\\n])*"|#[^\n]*|;|[^"#;]+')

ONTOLOGY_ENDINGS: Final = ('.owl', '.ttl', '.rdf', '.xml', '.nt')
_KINDS: Final = {'.ssl': 'annotations', '.streams': 'streams', '.bridges': 'bridges'}
"""The kinds of texts by the endings of their files."""

_SECTIONS: Final = ('sorts', 'objects', 'features', 'constants', 'domains')
YAML_ENDINGS: Final = frozenset({'.yaml', '.yml'})
_PLACE: Final = re.compile(r'(?P<path>.*):(?P<line>\d+):(?P<column>\d+)', re.DOTALL)


@dataclass(frozen=True, slots=True)
class PlacedFormula:
    """A formula, and the place of each of its characters.

    Args:
        requested: the formula.
        place: returns the place of a character, given its index.
    """

    requested: RequestedFormula
    place: Callable[[int], FilePlace]

    def place_of(self, part: str) -> FilePlace:
        """Return the place of a part of the text, or its begin if the part is not in it."""
        return self.place(max(0, self.requested.text.find(part)))


@dataclass(slots=True)
class LintInputs:
    """The content of all files.

    Args:
        files: their texts in the languages.
        formulas: the formulas with their places.
        findings: the faults of single files.
        places: the places of the declarations of a robot.yaml, by section and name.
        consequences: return True for a message that is a consequence of another fault.
        is_complete: False if a text is at fault, so what it declares is not known.
        texts: the texts of the files, by their paths.
        has_robot: True if there is a robot.yaml.
        refused: the texts of formulas at fault: what they name is used.
        expectations: the expectations of a robot.yaml about topics.
        shared: the features that a robot.yaml shares with peers.
        guards: the guards of a robot.yaml.
        triggers: the triggers of a robot.yaml that no formula names.
        has_peers: True if sorts, features, objects and streams may come from peers, too.
    """

    files: MonitoringFiles = field(default_factory=MonitoringFiles)
    formulas: list[PlacedFormula] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    places: dict[tuple[str, str], FilePlace] = field(default_factory=dict)
    consequences: list[Callable[[str], bool]] = field(default_factory=list)
    is_complete: bool = True
    texts: dict[str, str] = field(default_factory=dict)
    has_robot: bool = False
    refused: set[str] = field(default_factory=set)
    expectations: list[TopicExpectation] = field(default_factory=list)
    shared: set[str] = field(default_factory=set)
    guards: list[RequestedGuard] = field(default_factory=list)
    triggers: list[Trigger] = field(default_factory=list)
    has_peers: bool = False

    def is_consequence(self, message: str) -> bool:
        """Return True if a message is due to a fault that is among the findings."""
        return any(each(message) for each in self.consequences)

    def place_of(self, source: TextSource) -> FilePlace:
        """Return where a text begins."""
        if isinstance(source, InlineText):
            return self.placed(str(source))
        return FilePlace(str(source), self.texts.get(str(source), ''), TextPosition(1, 1))

    def placed(self, place: str) -> FilePlace:
        """Return a place that is given as a text: `robot.yaml:3:5`."""
        found = _PLACE.fullmatch(place)
        if found is None:
            return FilePlace(place, self.texts.get(place, ''), TextPosition(1, 1))
        position = TextPosition(int(found['line']), int(found['column']))
        return FilePlace(found['path'], self.texts.get(found['path'], ''), position)


def read_inputs(paths: Iterable[Path]) -> LintInputs:
    """Return the content of files: robot.yaml, texts in the languages, formulas.

    Raises:
        DyKnowError: for a file that cannot be read.
    """
    inputs = LintInputs()
    for path in paths:
        ending = path.suffix.lower()
        if ending in YAML_ENDINGS:
            _read_yaml_file(inputs, path)
        elif ending in ONTOLOGY_ENDINGS:
            if not path.is_file():
                read_text(path, 'ontology', ConfigurationError)  # Raises the error.
            inputs.files = replace(inputs.files, ontologies=(*inputs.files.ontologies, path))
        elif ending in _KINDS:
            _read_statements(inputs, path, _KINDS[ending], _parsers()[_KINDS[ending]])
        else:
            _read_lines(inputs, path)
    return inputs


def _read_yaml_file(inputs: LintInputs, path: Path) -> None:
    document = read_yaml(path)
    inputs.texts[str(path)] = document.document.text
    inputs.findings += [robot_error(each, str(path)) for each in parameter_faults(document)]
    if is_parameter_file(document):
        misspelt = [robot_error(each, str(path)) for each in misspelt_nodes(document)]
        # Nodes that are not DyKnow's may share the file.
        inputs.findings += [replace(each, level=FindingLevel.WARNING) for each in misspelt]
        return
    if document.is_list:
        try:
            formulas = read_formulas(path)
        except ConfigurationError as error:
            faults = [error]
            if not any(each.is_mapping for each in document.items()):
                text = (
                    'this is a list, so its texts name files of formulas; a robot.yaml is a mapping'
                )
                faults.insert(0, document.error(f'{text}, with keys such as formulas'))
            inputs.findings += [robot_error(each, str(path)) for each in faults]
            return
        inputs.formulas += _placed(formulas, document)
        return
    found = find_faults(path)
    inputs.has_robot = True
    inputs.findings += [robot_error(each, str(path)) for each in found.faults]
    inputs.consequences.append(found.is_consequence)
    inputs.refused |= found.refused
    inputs.is_complete &= found.robot is not None and not found.lacks_texts
    _add_robot(inputs, found)


def _add_robot(inputs: LintInputs, found: RobotFaults) -> None:
    robot, files = found.robot, inputs.files
    if robot is None:
        return
    for kind, parse in _parsers().items():
        for source in getattr(robot, kind):
            if isinstance(source, Path):
                _read_statements(inputs, source, kind, parse, is_added=False)
    inputs.files = MonitoringFiles(
        (*files.ontologies, *robot.ontologies),
        (*files.annotations, *robot.annotations),
        (*files.streams, *robot.streams),
        (*files.bridges, *robot.bridges),
        {**files.domains, **robot.domains},
    )
    inputs.formulas += _placed(robot.formulas, found.document)
    inputs.formulas += _placed_of_guards(robot, found.document)
    inputs.expectations += robot.topics
    inputs.guards += robot.guards
    named = {id(each) for formula in robot.formulas for _, each in formula.on}
    # A formula that is at fault may name any.
    triggers = () if found.refused else robot.triggers
    inputs.triggers += [each for each in triggers if id(each) not in named]
    if robot.federation is not None:
        inputs.has_peers = True
        inputs.shared |= {each.name for each in robot.federation.share}
    for section, key in (*_entries(found.document), *_shared(found.document)):
        place = FilePlace(str(key.document.path), key.document.text, key.position(0))
        inputs.places[section, key.text().strip()] = place


def _parsers() -> Mapping[str, Callable[[str], object]]:
    from dyknow_semantics import parse_annotations, parse_bridges  # noqa: PLC0415 - takes a second

    return {
        'annotations': parse_annotations,
        'streams': parse_specification,
        'bridges': parse_bridges,
    }


def _entries(document: YamlValue) -> Iterator[tuple[str, YamlValue]]:
    """Yield the names that a robot.yaml declares, each with its section."""
    for section, value in _keys_of(document):
        if section in _SECTIONS and value.is_mapping:
            yield from ((section, key) for key, _ in value.entries('a mapping'))


def _shared(document: YamlValue) -> Iterator[tuple[str, YamlValue]]:
    """Yield the features and objects of this host that a federation names."""
    stated = dict(_keys_of(document)).get('federation')
    for key, value in _keys_of(stated) if stated else ():
        for each in value.one_or_more() if key in {'share', 'same'} else ():
            yield key, dict(_keys_of(each))['feature'] if each.is_mapping else each


def _keys_of(value: YamlValue) -> Iterator[tuple[str, YamlValue]]:
    return ((key.word(), each) for key, each in value.entries('a mapping'))


def _placed(formulas: Iterable[RequestedFormula], document: YamlValue) -> Iterator[PlacedFormula]:
    """Yield formulas with their places in a document; formulas of other files with the document."""
    values = dict(_formula_values(document))
    for each in formulas:
        yield PlacedFormula(each, _place_in(values.get(each.name, document)))


def _placed_of_guards(robot: RobotConfiguration, document: YamlValue) -> Iterator[PlacedFormula]:
    """Yield the formulas that guards state themselves, with their places."""
    guards = dict(_keys_of(document)).get('guards')
    stated = {
        each.line(): each
        for guard in (guards.items() if guards else ())
        for each in dict(_keys_of(guard))['formulas'].one_or_more()
    }
    for formula in (each for guard in robot.guards for each in guard.formulas):
        if formula not in robot.formulas:
            yield PlacedFormula(formula, _place_in(stated[formula.name]))


def _place_in(value: YamlValue) -> Callable[[int], FilePlace]:
    document = value.document
    return lambda index: FilePlace(str(document.path), document.text, value.position(index))


def _formula_values(document: YamlValue) -> Iterator[tuple[str, YamlValue]]:
    formulas = dict(_keys_of(document)).get('formulas') if document.is_mapping else document
    for each in formulas.one_or_more() if formulas else ():
        if each.is_mapping:
            stated = dict(_keys_of(each))
            if 'name' in stated and 'formula' in stated:
                yield stated['name'].line(), stated['formula']


def _read_statements(
    inputs: LintInputs,
    path: Path,
    kind: str,
    parse: Callable[[str], object],
    *,
    is_added: bool = True,
) -> None:
    text = read_text(path, kind, ConfigurationError)
    inputs.texts[str(path)] = text
    found = list(syntax_findings(parse, text, FilePlace(str(path), text, TextPosition(1, 1))))
    inputs.findings += found
    inputs.is_complete &= not found
    if is_added:
        changed: dict[str, Any] = {kind: (*getattr(inputs.files, kind), path)}
        inputs.files = replace(inputs.files, **changed)


def _read_lines(inputs: LintInputs, path: Path) -> None:
    """Read a file with a formula in each line."""
    text = read_text(path, 'formulas', ConfigurationError)
    for position, formula in formula_lines(text):
        place = FilePlace(str(path), text, position)
        try:
            check_types(parse_formula(formula), formula)
        except (LanguageError, DyKnowError) as error:
            inputs.findings.append(error_at(place, error))
            inputs.refused.add(formula)
            continue
        inputs.formulas.append(PlacedFormula(RequestedFormula(formula), _place_after(place)))


def _place_after(place: FilePlace) -> Callable[[int], FilePlace]:
    return lambda index: place.moved(TextPosition(1, index + 1))


def syntax_findings(
    parse: Callable[[str], object], text: str, place: FilePlace
) -> Iterator[Finding]:
    """Yield the syntax errors of a text; of each statement the first.

    Args:
        parse: raises LanguageError.
        text: the text.
        place: where it begins.
    """
    try:
        parse(text)
    except LanguageError as error:
        whole = error
    else:
        return
    count = 0
    for offset, statement in _statements(text):
        try:
            parse(statement)
        except LanguageError as error:
            count += 1
            yield error_at(place.moved(position_at(text, offset)), error)
        if count >= MAX_STATEMENT_FAULTS:
            return
    if not count:
        yield error_at(place, whole)


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield each statement that has more than space and comments, with its offset."""
    begin = position = 0
    is_empty = True
    while found := _PART.match(text, position):
        position = found.end()
        if found[0] != ';':
            is_empty = is_empty and (found[0][0] == '#' or found[0].isspace())
            continue
        if not is_empty:
            yield begin, text[begin:position]
        begin, is_empty = position, True
    if not is_empty or position < len(text):
        yield begin, text[begin:]

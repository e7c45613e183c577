"""Configuration of a check: a YAML file that names all others, and files of formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from reprlib import Repr
from typing import Any, Final

import yaml

from dyknow_common import DyKnowError, read_text
from dyknow_reasoning import Constants, parse_constants
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.evaluation.results import RequestedFormula
from dyknow_recordings.evaluation.vocabulary import MonitoringFiles

_FILES: Final = ('ontology', 'annotations', 'streams', 'bridges')
_KEYS: Final = (*_FILES, 'domains', 'constants', 'formulas')
_SHORT: Final = Repr()
_SHORT.maxlevel = 3
_SHORT.maxstring = _SHORT.maxother = 100


def read_configuration(path: Path) -> tuple[MonitoringFiles, tuple[RequestedFormula, ...]]:
    """Return the files and the formulas that a YAML file names.

    Its keys are `ontology`, `annotations`, `streams` and `bridges` (a path or a list of paths,
    relative to the folder of the file), `domains` (lists of objects by sort), `constants` (values
    by name: numbers, or texts such as `150 W`), and `formulas` (such a list as `read_formulas`
    reads, or paths of files with formulas).

    Raises:
        RecordingError: naming the file, the key and the mend.
    """
    content = _read_yaml(path)
    if not isinstance(content, dict):
        raise _error(path, '', 'write a mapping with some of the keys', content)
    for key in content:
        if key not in _KEYS:
            raise RecordingError(f'{path}: unknown key {key!r}; the keys are {", ".join(_KEYS)}')
    ontologies, annotations, streams, bridges = (
        tuple(path.parent / each for each in _texts(path, key, content.get(key, [])))
        for key in _FILES
    )
    domains = content.get('domains', {})
    if not isinstance(domains, dict) or not all(isinstance(key, str) for key in domains):
        raise _error(path, 'domains', 'write a mapping from sorts to lists of objects', domains)
    files = MonitoringFiles(
        ontologies,
        annotations,
        streams,
        bridges,
        {sort: _texts(path, f'domains.{sort}', found) for sort, found in domains.items()},
    )
    constants = _constants(path, content.get('constants', {}))
    formulas = _configured_formulas(path, content.get('formulas', []))
    return files, tuple(replace(each, constants=constants) for each in formulas)


def read_formulas(path: Path) -> tuple[RequestedFormula, ...]:
    """Return the formulas of a file.

    A file with the ending `.yaml` or `.yml` has a list of mappings with the keys `name` and
    `formula`, and perhaps `description`. Any other has one formula a line; # begins a comment line.

    Raises:
        RecordingError: naming the file, the key and the mend.
    """
    if path.suffix in {'.yaml', '.yml'}:
        return _named_formulas(path, _read_yaml(path))
    lines = read_text(path, 'formulas', RecordingError).splitlines()
    stripped = [line.strip() for line in lines]
    return tuple(RequestedFormula(line) for line in stripped if line and line[0] != '#')


def _constants(path: Path, content: Any) -> Constants:
    if not isinstance(content, dict):
        raise _error(path, 'constants', 'write a mapping from names to values', content)
    found: Constants = ()
    for name, value in content.items():
        key = f'constants.{name}'
        if not isinstance(name, str) or not isinstance(value, bool | int | float | str):
            raise _error(path, key, 'write a number, or a text such as 150 W,', value)
        text = str(value).lower() if isinstance(value, bool) else str(value)
        try:
            found += parse_constants({name: text})
        except DyKnowError as error:
            raise RecordingError(f'{path}: {key}: {error.message}') from None
    return found


def _configured_formulas(path: Path, value: Any) -> tuple[RequestedFormula, ...]:
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        return _named_formulas(path, value, 'formulas')
    paths = [path.parent / each for each in _texts(path, 'formulas', value)]
    return tuple(formula for each in paths for formula in read_formulas(each))


def _named_formulas(path: Path, value: Any, key: str = '') -> tuple[RequestedFormula, ...]:
    if not isinstance(value, list):
        raise _error(path, key, 'write a list of formulas', value)
    found: dict[str, RequestedFormula] = {}
    for index, each in enumerate(value):
        place = f'{key}[{index}]'
        if not isinstance(each, dict) or not {*each} <= {'name', 'formula', 'description'}:
            raise _error(path, place, 'write a mapping with name and formula', each)
        texts: dict[str, Any] = {name: each.get(name) for name in ('name', 'formula')}
        for name, text in texts.items():
            if not isinstance(text, str) or not text.strip():
                raise _error(path, f'{place}.{name}', 'write a text', text)
        formula = RequestedFormula(texts['formula'], texts['name'])
        if formula.name in found:
            raise RecordingError(
                f"{path}: {place}: the name '{formula.name}' is taken; use another"
            )
        found[formula.name] = formula
    return tuple(found.values())


def _texts(path: Path, key: str, value: Any) -> tuple[str, ...]:
    texts: Sequence[Any] = [value] if isinstance(value, str) else value
    if not isinstance(texts, list) or not all(isinstance(each, str) and each for each in texts):
        raise _error(path, key, 'write a text or a list of texts', value)
    return tuple(texts)


def _read_yaml(path: Path) -> Any:
    text = read_text(path, 'configuration', RecordingError)
    try:
        return yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        position = f':{mark.line + 1}:{mark.column + 1}' if mark else ''
        raise RecordingError(f'{path}{position}: not YAML: {error.problem}') from None
    # Control characters, a day that does not exist, thousands of brackets.
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise RecordingError(f'{path}: not YAML: {error}') from None


def _error(path: Path, key: str, correction: str, value: Any) -> RecordingError:
    place = f'{path}: {key}' if key else str(path)
    return RecordingError(f'{place}: {correction} instead of {_SHORT.repr(value)}')


def merged(first: MonitoringFiles, second: MonitoringFiles) -> MonitoringFiles:
    """Return the files of both; domains of the second take precedence."""
    domains: Mapping[str, tuple[str, ...]] = {**first.domains, **second.domains}
    return MonitoringFiles(
        first.ontologies + second.ontologies,
        first.annotations + second.annotations,
        first.streams + second.streams,
        first.bridges + second.bridges,
        domains,
    )

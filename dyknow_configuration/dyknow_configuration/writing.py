"""The texts of a robot.yaml as files, which other tools and the nodes of DyKnow read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from dyknow_common import BlackBoxOptions, ExitCode, InlineText, format_duration
from dyknow_configuration.errors import ConfigurationError, write_errors
from dyknow_configuration.robot import RequestedFormula, RobotConfiguration, Severity, TextSource
from dyknow_configuration.triggers import FormulaTriggers, trigger_document


def write_texts(
    robot: RobotConfiguration, folder: Path, name: str = 'robot', *, with_places: bool = False
) -> RobotConfiguration:
    """Write the texts of a configuration to a folder that exists.

    Args:
        robot: the configuration.
        folder: the folder.
        name: of the files, without their endings.
        with_places: True to write the place of each annotation in the robot.yaml as a comment; the
            nodes name it in errors.

    Returns:
        The configuration with absolute paths only.

    Raises:
        ConfigurationError: if a file exists or cannot be written.
    """

    def files(sources: Iterable[TextSource], ending: str) -> tuple[Path, ...]:
        are_placed = with_places and ending == 'ssl'
        texts = [
            f'# {each}\n{each.text.rstrip()}' if are_placed else each.text.rstrip()
            for each in sources
            if isinstance(each, InlineText)
        ]
        given = tuple(each.absolute() for each in sources if isinstance(each, Path))
        return (*given, *_write_parts(folder.absolute() / f'{name}.{ending}', texts))

    return replace(
        robot,
        ontologies=files(robot.ontologies, 'owl'),
        annotations=files(robot.annotations, 'ssl'),
        streams=files(robot.streams, 'streams'),
        bridges=files(robot.bridges, 'bridges'),
    )


def _write_parts(path: Path, texts: Sequence[str]) -> Iterator[Path]:
    """Write texts to one file, but texts of streams to one each: their units may differ."""
    parts = [[each] for each in texts] if path.suffix == '.streams' else [texts] if texts else []
    for number, each in enumerate(parts, start=1):
        part = path if number == 1 else path.with_stem(f'{path.stem}_{number}')
        _write(part, '\n'.join([*each, '']))
        yield part


def export(robot: RobotConfiguration, folder: Path, name: str) -> Path:
    """Write the files of a configuration, and a YAML file that names them; return its path.

    Args:
        robot: the configuration.
        folder: the folder, which is made if it does not exist.
        name: of the files, without their endings.

    Raises:
        ConfigurationError: if a file exists or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'cannot make the folder {folder}: {error.strerror}') from None
    written = write_texts(robot, folder, name)
    path = folder / f'{name}.yaml'
    _write(path, _yaml_text(_document(written, folder)))
    return path


def _document(robot: RobotConfiguration, folder: Path) -> dict[str, Any]:
    """Return the content of the YAML file, with paths relative to its folder."""

    def relative(files: Iterable[TextSource]) -> list[str]:
        return [os.path.relpath(str(each), folder.absolute()) for each in files]

    triggers = {each.name: each for formula in robot.formulas for _, each in formula.on}
    parts = {
        'ontology': relative(robot.ontologies),
        'annotations': relative(robot.annotations),
        'streams': relative(robot.streams),
        'bridges': relative(robot.bridges),
        'domains': {sort: list(objects) for sort, objects in robot.domains.items()},
        'triggers': {
            name: trigger_document(each) for name, each in triggers.items() if each.is_named
        },
        'formulas': [_formula(each) for each in robot.formulas],
        'topics': {each.topic: dict(each.document) for each in robot.topics},
        'nodes': {node: dict(given) for node, given in robot.parameters.items()},
    }
    return {key: part for key, part in parts.items() if part}


def _formula(formula: RequestedFormula) -> Mapping[str, Any]:
    description = {'description': formula.description} if formula.description else {}
    severity = {} if formula.severity is Severity.WARNING else {'severity': str(formula.severity)}
    name = formula.name or formula.text
    flags = {key: True for key in ('every_state', 'margin') if getattr(formula, key)}
    on = {'on': _events(formula.on)} if formula.on else {}
    record = {} if formula.record is None else {'record': _record(formula.record)}
    stated = {**description, **severity, **flags, **on, **record}
    return {'name': name, 'formula': formula.text, **stated}


def _events(triggers: FormulaTriggers) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for event, each in triggers:
        written = each.name if each.is_named else trigger_document(each)
        found.setdefault(str(event), []).append(written)
    return found


def _record(options: BlackBoxOptions) -> Mapping[str, Any]:
    topics = {'topics': list(options.topics)} if options.topics else {}
    times = {'before': options.before, 'after': options.after}
    return {**topics, **{name: format_duration(time) for name, time in times.items()}}


def _yaml_text(document: Mapping[str, Any]) -> str:
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100)


def _write(path: Path, text: str) -> None:
    with write_errors(path):
        try:
            with path.open('x', encoding='utf-8') as file:
                file.write(text)
        except FileExistsError:
            raise ConfigurationError(
                f'{path} exists; remove it, or choose another folder', ExitCode.ALREADY_EXISTS
            ) from None

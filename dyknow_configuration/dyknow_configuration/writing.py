"""The texts of a robot.yaml as files, which other tools and the nodes of DyKnow read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import yaml

from dyknow_common import ExitCode, InlineText
from dyknow_configuration.errors import ConfigurationError, write_errors
from dyknow_configuration.federation import FEDERATION_KEYS
from dyknow_configuration.reading import robot_of
from dyknow_configuration.robot import RobotConfiguration, TextSource
from dyknow_configuration.yaml_values import YamlValue, read_yaml

_MEND: Final = 'remove it, or choose another folder'

_KEPT: Final = frozenset(
    {
        'constants', 'domains', 'federation', 'formulas', 'guards', 'nodes', 'topics', 'triggers',
    }
)  # fmt: skip
"""The keys that an exported file has as the robot.yaml has them."""


def write_texts(
    robot: RobotConfiguration, folder: Path, name: str = 'robot', *, with_places: bool = False
) -> RobotConfiguration:
    """Write the texts of a configuration to a folder that exists.

    Args:
        robot: the configuration.
        folder: the folder.
        name: the name of the files, without their endings.
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
        write_new(part, '\n'.join([*each, '']), _MEND)
        yield part


def export(path: Path, folder: Path) -> Path:
    """Write the files that a robot.yaml is made of, and a YAML file that names them.

    All else of the robot.yaml stays as it is, but for its comments.

    Args:
        path: the path of the robot.yaml, whose name the files get.
        folder: the folder, which is made if it does not exist.

    Returns:
        The path of the YAML file.

    Raises:
        ConfigurationError: if a file exists or cannot be written; as `read_robot`.
    """
    document = read_yaml(path)
    robot = robot_of(document)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'cannot make the folder {folder}: {error.strerror}') from None
    written = write_texts(robot, folder, path.stem)
    exported = folder / f'{path.stem}.yaml'
    write_new(exported, _yaml_text(written, document, folder), _MEND)
    return exported


def _yaml_text(robot: RobotConfiguration, document: YamlValue, folder: Path) -> str:
    """Return the text of the YAML file, with paths relative to its folder."""

    def relative(path: object) -> str:
        return os.path.relpath(str(path), folder.absolute())

    files = {
        'ontology': robot.ontologies,
        'annotations': robot.annotations,
        'streams': robot.streams,
        'bridges': robot.bridges,
    }
    named = {kind: list(map(relative, paths)) for kind, paths in files.items() if paths}
    stated = document.entries('a robot.yaml')
    kept = {key.text(): (key.node, value) for key, value in stated if key.text() in _KEPT}
    for node in _paths({key: value for key, (_, value) in kept.items()}):
        node.value = relative(document.document.path.absolute().parent / node.value.strip())
    nodes = [(key, value.node) for key, value in kept.values()]
    others = yaml.MappingNode('tag:yaml.org,2002:map', nodes, flow_style=False)
    options: Any = {'allow_unicode': True, 'width': 100}
    text: str = yaml.safe_dump(named, sort_keys=False, **options) if named else ''
    text += yaml.serialize(others, Dumper=yaml.SafeDumper, **options) if kept else ''
    return text


def _paths(kept: Mapping[str, YamlValue]) -> Iterator[yaml.Node]:
    """Yield the values that name files."""
    formulas = kept['formulas'].one_or_more() if 'formulas' in kept else []
    yield from (each.node for each in formulas if each.is_text)
    if 'federation' in kept:
        stated = kept['federation'].mapping(FEDERATION_KEYS)
        yield from [stated['zenoh'].node] if 'zenoh' in stated else []


def write_new(path: Path, text: str, mend: str) -> None:
    """Write a file that does not exist.

    Raises:
        ConfigurationError: if it cannot be written; ALREADY_EXISTS with a mend if it exists.
    """
    with write_errors(path):
        try:
            with path.open('x', encoding='utf-8') as file:
                file.write(text)
        except FileExistsError:
            raise ConfigurationError(f'{path} exists; {mend}', ExitCode.ALREADY_EXISTS) from None

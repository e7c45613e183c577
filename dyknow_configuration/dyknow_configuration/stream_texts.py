"""The streams of a robot.yaml: texts in the stream language, for each object of a sort if wanted.

streams:
  - compunit power: float electrical_power((voltage: float, current: float));
  - for: {r: Rover}
    text: |
      stream {r}_power = electrical_power("/{r}/battery");
      sink {r}_power;
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from math import prod
from typing import Final

from dyknow_common import MAX_CHARACTERS, InlineText, unknown
from dyknow_configuration.documents.composed_text import ComposedText
from dyknow_configuration.documents.yaml_values import YamlValue
from dyknow_configuration.robot import RobotVocabulary, choices
from dyknow_configuration.topics import MAX_TEXTS
from dyknow_stream_processing import parse_specification, specifications_by_sink

TEMPLATE_KEYS: Final = ('for', 'text')

_DECLARATION: Final = re.compile(r'\s*(#|(source|compunit|stream|sink)\s)')


def is_stream_text(value: YamlValue) -> bool:
    """Return True if a value is a text in the stream language, and not the name of a file."""
    return value.is_mapping or bool(_DECLARATION.match(value.text('streams or a file')))


def read_streams(
    values: Iterable[YamlValue], vocabulary: RobotVocabulary
) -> tuple[InlineText, ...]:
    """Return the text of all streams, empty if there are none.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    text = ComposedText()
    place = ''
    for value in values:
        place = place or value.place
        _add(text, value, vocabulary)
    if not text:
        return ()
    with text.errors():
        specifications_by_sink(parse_specification(str(text)))
    return (InlineText(place, str(text)),)


def _add(text: ComposedText, value: YamlValue, vocabulary: RobotVocabulary) -> None:
    if not value.is_mapping:
        text.add_value(value).add(_separator(value), value)
        return
    stated = value.mapping(TEMPLATE_KEYS, TEMPLATE_KEYS)
    sorts: dict[str, str] = {}
    for variable, sort in stated['for'].entries('a mapping from variables to sorts'):
        name = sort.text('the name of a sort').strip()
        if name not in vocabulary.sorts:
            raise sort.error(unknown('sort', name, vocabulary.sorts))
        sorts[variable.text().strip()] = name
    domains = {variable: vocabulary.objects(sort) for variable, sort in sorts.items()}
    if prod(map(len, domains.values())) > MAX_TEXTS:
        raise value.error(f'this makes more than {MAX_TEXTS} copies; split it')
    for objects in choices(domains):
        text.add_template(stated['text'], objects)
        text.add(_separator(stated['text']), stated['text'])
        if len(text) > MAX_CHARACTERS:
            raise value.error(f'the streams have more than {MAX_CHARACTERS} characters; split them')


def _separator(value: YamlValue) -> str:
    """Return what separates a text from the next one."""
    lines = [line.partition('#')[0] for line in value.text().splitlines()]
    # Its last line may end in a comment.
    return '\n' if ''.join(lines).rstrip().endswith(';') else '\n;\n'

"""The topics and streams that carry the features of a robot.yaml, as annotations.

    features:
      Speed:
        of: {r: Rover}
        unit: m/s
        from: {topic: '/{r}/odom', field: twist.twist.linear.x, max_delay: 500 ms}

For the objects rover1 and rover2, this makes two annotations. The first annotation is

    stream "/rover1/odom" contains Speed[rover1] = twist.twist.linear.x with max_delay = 500 ms;
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from math import prod
from typing import TYPE_CHECKING, Final

from dyknow_common import (
    CONSTRAINT_KINDS,
    DyKnowError,
    InlineText,
    ValueType,
    check_unit,
    quoted,
    unit_conversion,
)
from dyknow_configuration.composed_text import (
    ComposedText,
    constraint_parts,
    constraint_texts,
    variables,
)
from dyknow_configuration.robot import RobotFeature, RobotVocabulary, choices
from dyknow_configuration.yaml_values import YamlValue

if TYPE_CHECKING:
    from dyknow_semantics import Annotation

SOURCE_KEYS: Final = ('topic', 'stream', 'field', 'unit', 'only', 'where', *CONSTRAINT_KINDS)

_STREAM: Final = re.compile(r'[A-Za-z][A-Za-z0-9_]*')

MAX_TEXTS: Final = 10_000
"""The number of annotations that a file makes, and of the copies of one of its texts."""


def read_topics(
    feature: RobotFeature,
    value: YamlValue,
    vocabulary: RobotVocabulary,
    uncertainty: YamlValue | None = None,
    unless: YamlValue | None = None,
) -> list[InlineText]:
    """Return the annotations of a feature, given the value of its key `from`.

    Args:
        feature: the feature.
        value: the value of the key.
        vocabulary: the vocabulary of the robot.
        uncertainty: if this is about the uncertainty of a feature, the field that holds it.
        unless: the condition of messages in which the value is unknown.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found = value.one_or_more()
    if uncertainty is not None and len(found) > 1:
        raise uncertainty.error(
            'it would not be known of which topic the uncertainty is; give the feature one topic'
        )
    sources = [FeatureCarrier(feature, each, vocabulary, uncertainty, unless) for each in found]
    return [annotation for each in sources for annotation in each.annotations()]


class FeatureCarrier:
    """A topic or stream with the field that holds a feature.

    Raises:
        ConfigurationError: with the place of the fault.
    """

    def __init__(
        self,
        feature: RobotFeature,
        value: YamlValue,
        vocabulary: RobotVocabulary,
        uncertainty: YamlValue | None = None,
        unless: YamlValue | None = None,
    ) -> None:
        self._unless = unless
        self._feature = feature
        self._value = value
        self._is_of_samples = uncertainty is not None and feature.value_type is ValueType.STRING
        self.stated = value.mapping(SOURCE_KEYS, ('field',))
        if uncertainty is not None:
            if 'unit' in self.stated:
                message = 'the uncertainty is in the unit of the field; give that to the feature'
                raise self.stated['unit'].error(message)
            self.stated = {**self.stated, 'field': uncertainty}
            if self._expires():
                # The last uncertainty stays, as nothing depends on it without a value.
                dropped = {'expires', 'max_gap'}
                self.stated = {key: each for key, each in self.stated.items() if key not in dropped}
        if ('topic' in self.stated) == ('stream' in self.stated):
            raise value.error("give either 'topic' or 'stream'")
        self._stream = self.stated['topic' if 'topic' in self.stated else 'stream']
        self._keys = self._read_keys()
        self.unit = self._read_unit()
        if self._expires() and not vocabulary.may_be_unknown(feature):
            raise self.stated['expires'].error(
                f"a value that expires is unknown; add 'missing: unknown' to '{feature.name}'"
            )
        self._constraints = constraint_texts(self.stated)
        self._objects = self._read_objects(vocabulary)

    def annotations(self) -> Iterator[InlineText]:
        """Yield an annotation for each choice of objects."""
        for objects in self.choices():
            yield InlineText(self.stated['field'].place, self._annotation(objects))

    @property
    def is_topic(self) -> bool:
        """True for a topic, False for a stream."""
        return 'topic' in self.stated

    def choices(self) -> Iterator[dict[str, str]]:
        """Yield each choice of objects."""
        return choices(self._objects)

    def stream_of(self, objects: Mapping[str, str]) -> tuple[str, str]:
        """Return the topic or stream of some objects, and its constraints in the languages."""
        stream = str(ComposedText().add_template(self._stream, objects)).strip()
        if not self.is_topic and not _STREAM.fullmatch(stream):
            raise self._stream.error(
                f"'{stream}' is no name of a stream; use letters, digits and _"
            )
        return stream, ', '.join(f'{name} = {text}' for name, text in self._constraints.items())

    def _annotation(self, objects: Mapping[str, str]) -> str:
        stream, _ = self.stream_of(objects)
        name = quoted(stream) if self.is_topic else stream
        arguments = ', '.join(objects.get(each, each) for each in self._feature.arguments)
        feature = f'{self._feature.name}[{arguments}]' if arguments else self._feature.name
        text = ComposedText()
        text.add(f'stream {name} ', self._stream).add(f'contains {feature} = ', self._value)
        opening, closing = ('samples(', ')') if self._is_of_samples else ('', '')
        text.add(opening, self.stated['field']).add_template(self.stated['field'], objects)
        text.add(closing, self.stated['field'])
        if self.unit:
            text.add(f' [{self.unit}]', self.stated['unit'])
        if self._unless is not None:
            text.add(' unless ', self._unless).add_template(self._unless, objects)
        if self._keys:
            ranges = ', '.join(f'{each} in {self._feature.arguments[each]}' for each in self._keys)
            text.add(f' for every {ranges} where ', self.stated['where'])
            for index, (variable, key) in enumerate(self._keys.items()):
                text.add(f'{", " if index else ""}{variable} = ', key).add_value(key)
        text.add_parts(constraint_parts(self.stated, self._stream))
        text.add(';', self._value)
        with text.errors():
            self._check(str(text))
        return str(text)

    def _check(self, text: str) -> None:
        # The library for ontologies, which this imports, takes a second to load.
        from dyknow_semantics import parse_annotations  # noqa: PLC0415

        found = parse_annotations(text)
        if len(found) != 1 or not self._is_expected(found[0]):
            raise self.stated['field'].error('write the path of one field, such as pose.position.x')

    def _is_expected(self, found: Annotation) -> bool:
        """Return False if a part of the annotation has the syntax of several parts."""
        return (
            len(found.contents) == 1
            and found.contents[0].feature.name == self._feature.name
            and (found.contents[0].unit or '') == self.unit
            and (found.contents[0].unless is not None) == (self._unless is not None)
            and {each.variable for each in found.ranges} == set(self._keys)
            and set(found.constraints.given()) == set(self._constraints)
        )

    def _read_keys(self) -> dict[str, YamlValue]:
        """Return the fields that name objects, by their variables."""
        if 'where' not in self.stated:
            return {}
        entries = self.stated['where'].entries('a mapping from variables to fields')
        found: dict[str, YamlValue] = {}
        for variable, key in entries:
            found[self._variable(variable)] = key
            key.text('a field')
        return found

    def _read_unit(self) -> str:
        if 'unit' not in self.stated:
            return ''
        value = self.stated['unit']
        unit = value.text().strip()
        value.read(check_unit, unit)
        if not self._feature.unit:
            raise value.error(f"'{self._feature.name}' has no unit; remove it, or give one there")
        try:
            unit_conversion(unit, self._feature.unit)
        except DyKnowError as error:
            raise value.error(error.message) from None
        return unit

    def _expires(self) -> bool:
        return 'expires' in self.stated and self.stated['expires'].truth()

    def _read_objects(self, vocabulary: RobotVocabulary) -> dict[str, tuple[str, ...]]:
        """Return the objects of each variable that the message does not name."""
        chosen = self._read_choice(vocabulary)
        known = tuple(self._feature.arguments)
        named = variables(self._stream, known) | variables(self.stated['field'], known)
        found: dict[str, tuple[str, ...]] = {}
        for variable, sort in self._feature.arguments.items():
            objects = chosen.get(variable, vocabulary.objects(sort))
            if variable in self._keys:
                continue
            if len(objects) > 1 and variable not in named:
                raise self._stream.error(
                    f'this is the same for {objects[0]} and {objects[1]}; write {{{variable}}} in '
                    f"it, or add 'where: {{{variable}: FIELD}}' if a field names the {sort}"
                )
            found[variable] = objects
        if prod(map(len, found.values())) > MAX_TEXTS:
            raise self._value.error(f'this makes more than {MAX_TEXTS} annotations; split it')
        return found

    def _read_choice(self, vocabulary: RobotVocabulary) -> dict[str, tuple[str, ...]]:
        """Return the objects of the variables for which they are given."""
        if 'only' not in self.stated:
            return {}
        found: dict[str, tuple[str, ...]] = {}
        for variable, value in self.stated['only'].entries('a mapping from variables to objects'):
            sort = self._feature.arguments[self._variable(variable)]
            if variable.text() in self._keys:
                raise variable.error("'where' names its objects; remove one of the two")
            known = vocabulary.objects(sort)
            found[variable.text()] = tuple(
                each.choice('object', known) for each in value.one_or_more()
            )
        return found

    def _variable(self, value: YamlValue) -> str:
        return value.choice('variable', tuple(self._feature.arguments))

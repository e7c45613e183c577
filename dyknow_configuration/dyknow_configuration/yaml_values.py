"""YAML documents, read with errors that show the place in the file.

    robot.yaml:3:5: unknown key 'object'; did you mean 'objects'?
      object: {Rover: [rover1]}
      ^

YAML folds lines, removes indentation and resolves escapes, but it never changes the order of
characters, and except in escapes it changes only whitespace. So the n-th character of a value that
is not whitespace is the n-th such character of its source:

    formula: >-          the value 'always p',
      always             whose 'p' is the seventh character that is not whitespace,
      p                  and so is the 'p' in the source
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import yaml

from dyknow_common import (
    MAX_CHARACTERS,
    DyKnowError,
    TextPosition,
    file_fault,
    parse_duration,
    position_at,
    read_text,
    replace_text,
    shortened,
    unknown,
)
from dyknow_configuration.errors import ConfigurationError, write_errors

Read = TypeVar('Read')

MAX_VALUES: Final = 50_000
"""The number of values of a file: keys, texts, lists and mappings."""

MAX_QUOTED: Final = 100
"""The number of values that get quotes at once."""

_TAG: Final = 'tag:yaml.org,2002:'
_MERGE: Final = _TAG + 'merge'
_CONTROL: Final = re.compile('[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]')
_KINDS: Final = {
    'bool': 'a boolean',
    'float': 'a number',
    'int': 'a number',
    'map': 'a mapping',
    'null': 'nothing',
    'seq': 'a list',
    'timestamp': 'a date',
}

_ESCAPE: Final = re.compile(
    r'\\(?:x(?P<x>[0-9a-fA-F]{2})|u(?P<u>[0-9a-fA-F]{4})|U(?P<U>[0-9a-fA-F]{8})|(?P<one>.))',
    re.DOTALL,
)
_SPECIAL: Final = {
    '0': '\0', 'a': '\a', 'b': '\b', 'e': '\x1b', '"': '"', '/': '/', '\\': '\\',
    # These stand for whitespace.
    't': ' ', 'n': ' ', 'v': ' ', 'f': ' ', 'r': ' ', ' ': ' ', '\t': ' ', '\n': ' ', '_': ' ',
    'N': ' ', 'L': ' ', 'P': ' ',
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class YamlDocument:
    """A text in YAML.

    Args:
        path: the path of its file.
        text: the text.
    """

    path: Path
    text: str

    def error(self, message: str, position: TextPosition) -> ConfigurationError:
        """Return an error at a position of the text."""
        return ConfigurationError.at(message, self.path, self.text, position)


@dataclass(frozen=True, slots=True)
class YamlValue:
    """A value in a YAML document.

    Each method that reads the value raises ConfigurationError if it is something else.

    Args:
        document: the document.
        node: the node of PyYAML.
    """

    document: YamlDocument
    node: yaml.Node

    def error(self, message: str, character: int = 0) -> ConfigurationError:
        """Return an error about this value, or about a character of a text."""
        return self.document.error(message, self.position(character))

    def position(self, character: int) -> TextPosition:
        """Return the position of a character of a text in the document."""
        begin, end = self.node.start_mark.index, self.node.end_mark.index
        if isinstance(self.node, yaml.ScalarNode):
            source = self.document.text[begin:end]
            offsets = source_offsets(self.node.value, source, self.node.style)
            begin += 0 if offsets is None else offsets[min(character, len(offsets) - 1)]
        return position_at(self.document.text, begin)

    @property
    def end(self) -> int:
        """The index of the line after the last line of this value, in the text of the document."""
        node, text = self.node, self.document.text
        while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
            *_, last = node.value
            node = last[1] if isinstance(node, yaml.MappingNode) else last
        end = node.end_mark.index
        if not text[:end].endswith('\n'):
            return text.find('\n', end) + 1 or len(text)
        # A block of text ends after the empty lines that follow it; they are in it only on request.
        is_kept = isinstance(node.value, str) and node.value.endswith('\n\n')
        return end if is_kept else len(text[:end].rstrip('\n')) + 1

    @property
    def place(self) -> str:
        """The file with the line and the column."""
        return f'{self.document.path}:{self.position(0)}'

    @property
    def is_text(self) -> bool:
        """True if this is a text."""
        return self.node.tag == _TAG + 'str'

    @property
    def is_empty(self) -> bool:
        """True if there is no value, as after a key whose elements are all comments."""
        return self.node.tag == _TAG + 'null'

    @property
    def is_mapping(self) -> bool:
        """True if this is a mapping."""
        return isinstance(self.node, yaml.MappingNode)

    @property
    def is_list(self) -> bool:
        """True if this is a list."""
        return isinstance(self.node, yaml.SequenceNode)

    def expected(self, description: str, hint: str = '') -> ConfigurationError:
        """Return the error that this value is something else than what is expected."""
        kind = self.node.tag.removeprefix(_TAG)
        found = _KINDS.get(kind, 'an empty text' if self.is_text else kind)
        if isinstance(self.node, yaml.ScalarNode) and self.node.value.strip():
            shown = f"'{shortened(self.node.value)}'"
            found = shown if self.is_text else f'{shown}, which is {found} in YAML{hint}'
        return self.error(f'write {description} instead of {found}')

    def entries(self, description: str) -> list[tuple[YamlValue, YamlValue]]:
        """Return the keys and values of a mapping with names for keys, each key once."""
        if self.is_empty:
            return []
        if not isinstance(self.node, yaml.MappingNode):
            raise self.expected(description)
        own: dict[str, tuple[YamlValue, YamlValue]] = {}
        merged: dict[str, tuple[YamlValue, YamlValue]] = {}
        for key_node, value_node in self.node.value:
            key, value = YamlValue(self.document, key_node), YamlValue(self.document, value_node)
            if key_node.tag == _MERGE:
                merged |= {each[0].word(): each for each in value.entries('a mapping')}
            elif key.word() in own:
                raise key.error(f"'{key.word()}' is given twice; keep one")
            else:
                own[key.word()] = key, value
        return list({**merged, **own}.values())

    def mapping(
        self, known: Collection[str], required: Collection[str] = ()
    ) -> dict[str, YamlValue]:
        """Return the values of a mapping whose keys are known.

        Args:
            known: the keys that it may have.
            required: the keys that it must have.
        """
        found: dict[str, YamlValue] = {}
        for key, value in self.entries(f'a mapping with some of the keys {", ".join(known)}'):
            if key.word() not in known:
                raise key.error(unknown('key', key.word(), known))
            found[key.word()] = value
        for name in required:
            if name not in found:
                raise self.error(f"add the key '{name}'")
        return found

    def items(self, description: str = 'a list') -> list[YamlValue]:
        """Return the elements of a list."""
        if self.is_empty:
            return []
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.expected(description)
        return [YamlValue(self.document, each) for each in self.node.value]

    def one_or_more(self) -> list[YamlValue]:
        """Return the elements of a list, or this value alone."""
        return self.items() if self.is_list or self.is_empty else [self]

    def text(self, description: str = 'a text') -> str:
        """Return a text that is not blank."""
        if not self.is_text or not self.node.value.strip():
            raise self.expected(description, '; quotes make it a text')
        value = str(self.node.value)
        if found := _CONTROL.search(value):
            raise self.error(f'a text cannot hold the character {found[0]!r}; remove it')
        return value

    def matched(self, pattern: re.Pattern[str], description: str) -> str:
        """Return the text without space around it, which is to match a pattern."""
        text = self.text(description).strip()
        if not pattern.fullmatch(text):
            raise self.error(f"'{shortened(text)}' is not {description}")
        return text

    def word(self) -> str:
        """Return a name as it is written, even if YAML 1.1 reads a boolean, such as `on`."""
        is_boolean = self.node.tag == _TAG + 'bool'
        return str(self.node.value) if is_boolean else self.text('a name')

    def line(self) -> str:
        """Return a text with single spaces for its line breaks and other whitespace."""
        return ' '.join(self.text().split())

    def duration(self) -> int:
        """Return a duration with a unit, in nanoseconds."""
        if not self.is_text or self.text().strip()[-1].isdigit():
            raise self.expected('a duration with a unit, such as 500 ms,')
        return self.read(parse_duration, self.text())

    def non_negative_duration(self) -> int:
        """Return a duration with a unit that is not negative, in nanoseconds."""
        found = self.duration()
        if found < 0:
            raise self.error(f"'{self.text()}' is negative; write a duration from 0 s on")
        return found

    def truth(self) -> bool:
        """Return true or false."""
        found = self.plain()
        if not isinstance(found, bool):
            raise self.expected('true or false')
        return found

    def file(self) -> Path:
        """Return the file that this names, as seen from the folder of the document."""
        return self.document.path.parent / self.text('the name of a file').strip()

    def existing_file(self, hint: str = '') -> Path:
        """Return the file that this names, which must exist; `hint` ends the error."""
        path = self.file()
        if fault := file_fault(path):
            raise self.error(f'{fault}{hint}')
        return path

    def number(self) -> float:
        """Return a number."""
        if not self.is_number:
            raise self.expected('a number')
        try:
            return float(self.plain())
        except OverflowError:
            raise self.expected('a number that a float can hold') from None

    @property
    def is_number(self) -> bool:
        """True for a number, which a truth value is not."""
        found = self.plain()
        return isinstance(found, int | float) and not isinstance(found, bool)

    def choice(self, kind: str, known: Collection[str]) -> str:
        """Return one of some texts of a kind."""
        text = self.text(f'a {kind}').strip()
        if text not in known:
            raise self.error(unknown(kind, text, known))
        return text

    def plain(self) -> Any:
        """Return the value as PyYAML reads it."""
        try:
            return yaml.SafeLoader('').construct_document(self.node)
        except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
            raise self.error(f'a value that cannot be read: {error}') from None

    def read(self, function: Callable[[str], Read], text: str) -> Read:
        """Return the result of a function for a text of this value; its error shows the value."""
        try:
            return function(text)
        except (DyKnowError, ValueError) as error:
            raise self.error(str(error)) from None


def read_yaml(path: Path) -> YamlValue:
    """Return the whole of a YAML file.

    Raises:
        ConfigurationError: if it cannot be read (NOT_FOUND), is too large, or is not YAML.
    """
    return parse_yaml(path, read_text(path, 'configuration', ConfigurationError))


def parse_yaml(path: Path, text: str) -> YamlValue:
    """Return the whole of a text in YAML; as `read_yaml`, but for the path, which messages name."""
    document = YamlDocument(path, text)
    if len(text) > MAX_CHARACTERS:
        message = f'more than {MAX_CHARACTERS} characters; split it'
        raise document.error(message, position_at(text, MAX_CHARACTERS))
    with _yaml_errors(document):
        node = yaml.compose(text, Loader=_BoundedLoader)
    if node is None:
        mark = yaml.Mark(str(path), 0, 0, 0, None, 0)
        node = yaml.ScalarNode(_TAG + 'null', '', mark, mark)
    return YamlValue(document, node)


class _TooManyValuesError(yaml.MarkedYAMLError):
    pass


class _BoundedLoader(yaml.SafeLoader):
    """Composes at most MAX_VALUES values, which takes a second."""

    _count = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._count += 1
        if self._count > MAX_VALUES:
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise _TooManyValuesError(problem_mark=event.start_mark)
        return super().compose_node(parent, index)


@contextmanager
def _yaml_errors(document: YamlDocument) -> Iterator[None]:
    try:
        yield
    except _TooManyValuesError as error:
        position = position_at(document.text, error.problem_mark.index if error.problem_mark else 0)
        raise document.error(f'more than {MAX_VALUES} values; split it', position) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        index = mark.index if mark else 0
        reason = error.problem or error.context
        if unquoted := _unquoted(document.text, index):
            quoted = unquoted.quoted
            example = f': {shortened(quoted)} ("dyknow lint --fix" adds them)' if quoted else ''
            reason = f'a text with a colon needs quotes{example}'
        raise document.error(f'not YAML: {reason}', position_at(document.text, index)) from None
    except yaml.reader.ReaderError as error:
        position = position_at(document.text, error.position)
        raise document.error(f'not YAML: {error.reason}', position) from None
    except RecursionError:
        raise document.error('not YAML: it nests too deep', TextPosition(1, 1)) from None


def add_quotes(path: Path) -> bool:
    """Put quotes around the values of a YAML file that lack them and contain a colon.

    For example, `formula: forall r in Rover: always Speed[r] < 2` becomes
    `formula: "forall r in Rover: always Speed[r] < 2"`. Returns True if the file was changed.

    Raises:
        ConfigurationError: if it cannot be read (NOT_FOUND) or written, or is too large.
    """
    text = read_text(path, 'configuration', ConfigurationError)
    quoted = _with_quotes(text)
    if quoted != text:
        with write_errors(path):
            replace_text(path, quoted)
    return quoted != text


def _with_quotes(text: str) -> str:
    """Return a YAML text with quotes around at most MAX_QUOTED values that need them."""
    for _ in range(MAX_QUOTED if len(text) <= MAX_CHARACTERS else 0):
        try:
            deque(yaml.parse(text, yaml.SafeLoader), maxlen=0)
        except yaml.MarkedYAMLError as error:
            value = _unquoted(text, error.problem_mark.index if error.problem_mark else 0)
            if value is None or not value.quoted:
                break
            text = f'{text[: value.start]}{value.quoted}{text[value.end :]}'
        except (yaml.reader.ReaderError, RecursionError):
            break
        else:
            break
    return text


class _Unquoted(NamedTuple):
    """A value that lacks quotes: its place, and how it should be written; empty if unknown."""

    start: int
    end: int
    quoted: str


def _unquoted(text: str, index: int) -> _Unquoted | None:
    """Return the value without quotes that ends at a colon in it, which YAML does not allow."""
    begin = text.rfind('\n', 0, index) + 1
    key, colon, rest = text[begin:].partition('\n')[0].partition(': ')
    value = rest.partition(' #')[0].strip()
    if text[index : index + 1] != ':' or not colon or ':' not in value or value[0] in '"\'':
        return None
    start = begin + len(key) + len(colon) + len(rest) - len(rest.lstrip())
    quote = next((each for each in ('"', "'") if each not in value), '')
    # What begins like this is no text, and a backslash means something else in quotes.
    is_plain = value[0] not in '[{&*!|>%@`' and '\\' not in value
    return _Unquoted(start, start + len(value), f'{quote}{value}{quote}' * bool(quote and is_plain))


def texts(values: Mapping[str, YamlValue], key: str) -> list[YamlValue]:
    """Return the texts of a key that may be missing, have one text or a list of texts."""
    found = values[key].one_or_more() if key in values else []
    for each in found:
        each.text('a text or a list of texts')
    return found


def source_offsets(value: str, source: str, style: str | None) -> list[int] | None:
    """Return the offset in the source of each character of a value, and of its end.

    A character of whitespace is placed after the character before it.

    Args:
        value: the value of the scalar.
        source: its text in the document, with quotes or the header of a block.
        style: `'`, `"`, `|`, `>`, or None for a plain scalar.

    Returns:
        None if the two do not correspond.
    """
    visible = [(each, place) for each, place in _characters(source, style) if not each.isspace()]
    if ''.join(each for each, _ in visible) != ''.join(value.split()):
        return None
    offsets: list[int] = []
    places = (place for _, place in visible)
    after = visible[0][1] if visible else 0
    for each in value:
        if each.isspace():
            offsets.append(after)
        else:
            offsets.append(next(places))
            after = offsets[-1] + 1
    return [*offsets, after]


def _characters(source: str, style: str | None) -> Iterator[tuple[str, int]]:
    """Yield the characters of the value with their offsets in the source."""
    if style == "'":
        for found in re.finditer("''|[^']", source[1:-1]):
            yield found[0][0], found.start() + 1
    elif style == '"':
        for found in re.finditer(_ESCAPE.pattern + r'|[^\\]', source[1:-1], re.DOTALL):
            yield _resolved(found), found.start() + 1
    else:
        # The first line of a block is its header.
        begin = source.find('\n') + 1 if style in {'|', '>'} else 0
        yield from ((each, begin + place) for place, each in enumerate(source[begin:]))


def _resolved(found: re.Match[str]) -> str:
    code = found['x'] or found['u'] or found['U']
    if code:
        return chr(int(code, 16))
    return found[0] if found['one'] is None else _SPECIAL.get(found['one'], found['one'])

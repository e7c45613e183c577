"""Parsers from the cache read all languages as those that are made of the grammars."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import lark
import pytest

from dyknow_common import Language, LanguageError
from dyknow_reasoning import parse_formula
from dyknow_reasoning.language.grammar import LANGUAGE as FORMULA
from dyknow_semantics import parse_annotations, parse_bridges, parse_concept
from dyknow_semantics.annotations.annotation import ANNOTATION, CONCEPT
from dyknow_semantics.ontology.bridges import LANGUAGE as BRIDGES
from dyknow_stream_processing import parse_specification
from dyknow_stream_processing.language.specification import LANGUAGE as STREAM

Texts = tuple[str, ...]

LANGUAGES: dict[str, tuple[Language, Callable[[str], object], Texts]] = {
    'formula': (
        FORMULA,
        parse_formula,
        (
            'forall u in UAV: always (Power[u] > 9 W -> eventually[0 s, 5 s) min("/a".b[1:]) < 2)',
            'a.b until[0 s, 1 s] not "/x".y = "text" and ¬ c(d)',
            'always x.y >',
            'forall u UAV: P[u]',
            'a.b && c.d',
        ),
    ),
    'stream': (
        STREAM,
        parse_specification,
        (
            'stream a = select b[name = "x"].c as d from each e as f in "/g" where d >= 1; sink a',
            'sync(a, merge(b, c)) with sample_period = 100 ms, approximation = linear',
            'select where b = 1',
            'sync(a, b',
        ),
    ),
    'annotation': (
        ANNOTATION,
        parse_annotations,
        (
            'stream fleet contains Altitude[u] = pose.z for every u in UAV where u = id;',
            'stream fleet contain Altitude[u] = z;',
        ),
    ),
    'concept': (CONCEPT, parse_concept, ('Power[u] for every u in UAV', 'Power[u for')),
    'bridges': (BRIDGES, parse_bridges, ('a:height equivalent b:Altitude', 'a:height like b:c')),
}


@pytest.mark.parametrize('name', LANGUAGES)
def test_texts_are_read_alike(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    language, parse, texts = LANGUAGES[name]
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    vars(language).pop('_parser', None)
    made = [outcome(parse, text) for text in texts]
    assert len([*tmp_path.rglob('*-*')]) == 1

    def fail(*_: object, **__: object) -> None:
        raise AssertionError('the parser has been made again')

    monkeypatch.setattr(lark.Lark, '__init__', fail)
    del language._parser
    assert [outcome(parse, text) for text in texts] == made
    assert {each.startswith(language.name) for each in made} == {True, False}


def outcome(parse: Callable[[str], object], text: str) -> str:
    """The syntax tree of a text, or the message that refuses it."""
    try:
        # A parser may keep what it has read by the text.
        return repr(getattr(parse, '__wrapped__', parse)(text))
    except LanguageError as error:
        return str(error)

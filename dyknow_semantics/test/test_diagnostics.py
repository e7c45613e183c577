"""Error messages: a folder of bad inputs, each beside the message that it must give."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_common import LanguageError
from dyknow_semantics import (
    Knowledge,
    Ontology,
    SemanticsError,
    check_annotation,
    check_concept,
    parse_annotations,
    parse_concept,
)

HERE = Path(__file__).parent


def inputs(folder: str, ending: str) -> list[Path]:
    """The bad inputs of a folder."""
    found = sorted((HERE / folder).glob(f'*{ending}'))
    assert found
    return found


def expected(path: Path) -> str:
    """The message beside a bad input."""
    return path.with_suffix('.expected').read_text(encoding='utf-8').rstrip('\n')


def check_all(ssl: str, knowledge: Knowledge) -> None:
    """Parse and check all annotations of a text."""
    for annotation in parse_annotations(ssl):
        check_annotation(annotation, knowledge)


@pytest.mark.parametrize('path', inputs('bad_annotations', '.ssl'), ids=lambda path: path.stem)
def test_bad_annotations(path: Path, knowledge: Knowledge) -> None:
    with pytest.raises(LanguageError) as error:
        check_all(path.read_text(encoding='utf-8'), knowledge)
    assert error.value.message == expected(path)


@pytest.mark.parametrize('path', inputs('bad_concepts', '.concept'), ids=lambda path: path.stem)
def test_bad_concepts(path: Path, knowledge: Knowledge) -> None:
    with pytest.raises(LanguageError) as error:
        check_concept(parse_concept(path.read_text(encoding='utf-8')), knowledge)
    assert error.value.message == expected(path)


@pytest.mark.parametrize('path', inputs('bad_ontologies', '.owl'), ids=lambda path: path.stem)
def test_bad_ontologies(path: Path) -> None:
    with Ontology() as ontology:
        with pytest.raises(SemanticsError) as error:
            ontology.load(path)
        assert error.value.message == expected(path)
        assert 'Vehicle' not in ontology.knowledge.concept_names

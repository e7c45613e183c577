"""A fleet of vehicles, read from ontologies as Protege writes them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from dyknow_semantics import Knowledge, Ontology

sys.path.insert(0, str(Path(__file__).parent))

ONTOLOGIES = Path(__file__).parent / 'ontologies'


@pytest.fixture
def ontologies() -> Path:
    """The folder of the ontologies of the fleet."""
    return ONTOLOGIES


@pytest.fixture
def fleet() -> Iterator[Ontology]:
    """The ontology of a fleet: two UAVs, a rover and a camera."""
    with Ontology() as ontology:
        ontology.load(ONTOLOGIES / 'fleet.owl')
        yield ontology


@pytest.fixture(scope='session')
def knowledge() -> Knowledge:
    """The contents of the ontology of the fleet."""
    with Ontology() as ontology:
        ontology.load(ONTOLOGIES / 'fleet.owl')
        return ontology.knowledge

"""The page about limits takes its numbers from the constants that are enforced."""

from __future__ import annotations

from pathlib import Path

from dyknow_dashboard.model import requests
from dyknow_dashboard.model.typed_formulas import MAX_FORMULA
from dyknow_semantics.ontology.documents import access
from dyknow_semantics.ontology.taxonomy import MAX_PAIRS
from dyknow_stream_processing.dataflow import constraint_checks, synchronisation
from dyknow_stream_processing.language import term_sizes
from dyknow_stream_processing.ros.topics import node_topics, topic_sources

TEMPLATE = Path(__file__).parent.parent / 'tools' / 'reference' / 'limits.md'

UNNAMED = (
    'elements of an array that `each`',
    'time for which messages wait in an engine',
    'requests of all pages',
)
"""Rows whose numbers are no constants."""


def test_each_row_names_constants() -> None:
    rows = [line[2:] for line in TEMPLATE.read_text().splitlines() if line.startswith('| ')]
    literal = [each for each in rows if '{' not in each and not each.startswith('limit')]
    assert [each for each in literal if not each.startswith(UNNAMED)] == []


def test_numbers_that_are_one_limit_are_equal() -> None:
    assert synchronisation.MAX_TICKS == term_sizes.MAX_TICK_RATE
    assert synchronisation.MAX_VALUES == term_sizes.MAX_VALUE_RATE
    assert synchronisation.MAX_WAITING == constraint_checks.MAX_HELD
    assert access.MAX_STATEMENTS == MAX_PAIRS
    assert requests.MAX_NAME == MAX_FORMULA
    assert topic_sources.MAX_HELD == node_topics.MAX_TAKEN

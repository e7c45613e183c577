"""The page about limits has the numbers of the code."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import pytest

import dyknow_common.limits as texts
from dyknow_common import MAX_DURATION_NS, MAX_RECORDED_NS, MAX_RECORDED_TOPICS, SECOND_NS
from dyknow_common.durations import MAX_DIGITS
from dyknow_common.errors import _MAX_LISTED
from dyknow_common.text_files import MAX_LINE
from dyknow_configuration import yaml_values
from dyknow_configuration.topics import MAX_TEXTS
from dyknow_configuration.vocabulary import MAX_OBJECTS
from dyknow_coordinator.ros.reporting.evaluation_messages import _MAX_TEXT
from dyknow_dashboard.model import (
    board,
    collector,
    formulas,
    health,
    history,
    live_signals,
    requests,
)
from dyknow_dashboard.model import streams as shown_streams
from dyknow_dashboard.model.typed_formulas import MAX_FORMULA
from dyknow_dashboard.ros import dashboard as served
from dyknow_dashboard.server import serving
from dyknow_reasoning.execution.automata.automaton import MAX_SLOTS
from dyknow_reasoning.execution.past.past_comparisons import MAX_COUNTED
from dyknow_reasoning.execution.standing.standing_monitor import MAX_RUNS
from dyknow_reasoning.language.constants import MAX_TERM_PARTS
from dyknow_reasoning.language.sugar import _MAX_PARTS
from dyknow_reasoning.ros.group_evaluation import MAX_QUEUED_STATES
from dyknow_recordings.evaluation.observation import MAX_SIGNALS
from dyknow_recordings.reading import recording
from dyknow_semantics.ontology import new_entities, queries
from dyknow_semantics.ontology.documents import access, sources
from dyknow_semantics.ontology.taxonomy import MAX_PAIRS
from dyknow_semantics.ros import ontology_manager
from dyknow_stream_processing.dataflow import constraint_checks, synchronisation
from dyknow_stream_processing.dataflow.built_in import transform_tree
from dyknow_stream_processing.language import term_sizes
from dyknow_stream_processing.ros import stream_limits
from dyknow_stream_processing.ros.messages import sample_messages, writing
from dyknow_stream_processing.ros.topics import node_topics, topic_sources

PAGE = Path(__file__).parent.parent / 'docs' / 'limits.md'
KIB, MIB = 1024, 1024**2
DAY_S = 86_400

ROWS = {
    'length of a text;': (texts.MAX_CHARACTERS, texts.MAX_WORDS),
    'nesting:': (texts.MAX_DEPTH,),
    'parts of the streams of a text': (texts.MAX_STREAM_PARTS,),
    'parts of a formula, for all': (texts.MAX_FORMULA_PARTS,),
    'length of a number': (MAX_DIGITS,),
    'durations, and times': (
        MAX_DURATION_NS // SECOND_NS,
        MAX_DURATION_NS // SECOND_NS // DAY_S // 365,
    ),
    'a `robot.yaml`': (texts.MAX_CHARACTERS, yaml_values.MAX_VALUES, MAX_OBJECTS),
    'a file that is read as a whole': (texts.MAX_FILE_BYTES // MIB,),
    'a line of a trace': (MAX_LINE,),
    'annotations that a `robot.yaml`': (MAX_TEXTS,),
    'specifications of all streams': (stream_limits.MAX_CHARACTERS,),
    'inputs of a `merge`': (term_sizes.MAX_INPUTS,),
    'parts of one stream': (term_sizes.MAX_PARTS,),
    'fields of a stream': (term_sizes.MAX_FIELDS,),
    'samples that merges make': (term_sizes.MAX_COPIES,),
    'elements of the arrays of a message of a sink': (writing.MAX_FILLED,),
    'samples that wait to be put in order': (constraint_checks.MAX_HELD,),
    'ticks of `sync` at once': (synchronisation.MAX_TICKS, synchronisation.MAX_VALUES),
    'messages of a topic that wait for the node': (node_topics.MAX_TAKEN,),
    'transforms that are kept': (
        transform_tree.MAX_AGE_NS // SECOND_NS,
        transform_tree.MAX_TRANSFORMS,
        transform_tree.MAX_FRAMES,
    ),
    'digits of an integer in a Sample': (sample_messages.MAX_DIGITS,),
    'absolute name of a topic': (texts.MAX_TOPIC_LENGTH,),
    'pages that are open': (serving.MAX_PAGES,),
    'formula and name in a request': (MAX_FORMULA, requests.MAX_TIMEOUT_S / DAY_S),
    'request; its headers': (
        serving.MAX_BODY // KIB,
        serving.MAX_HEADERS // KIB,
        serving.MAX_FRAME // KIB,
    ),
    'formulas that one page has open': (requests.MAX_OPEN, served.MAX_ASKED),
    'formulas that are shown': (formulas.MAX_SHOWN, formulas.MAX_ENDED),
    'signals of a formula': (live_signals.WINDOW_NS // SECOND_NS // 60, MAX_SIGNALS),
    'formulas whose signals are kept': (board.MAX_KEPT, board.MAX_KEPT_SIGNALS, 50),
    'streams, topics, nodes of the graph': (
        shown_streams.MAX_STREAMS,
        shown_streams.MAX_STREAMS,
        shown_streams.MAX_NODES,
        health.MAX_DIAGNOSES,
        board.MAX_CONCEPTS,
        board.MAX_ANNOTATIONS,
    ),
    'failures in the history;': (
        history.MAX_FAILURES,
        history.MAX_AGE_NS // SECOND_NS // DAY_S,
    ),
    'failures in an answer or a request;': (requests.MAX_IDS, history.MAX_FAILURES),
    'text that says who has acknowledged': (requests.MAX_OPERATOR,),
    'failures that wait for the file': (history.MAX_WAITING, collector.MAX_WAITING),
    'time in which the collector': (collector.TIMEOUT_S,),
    'time between two messages to a page': (Fraction(str(serving.PERIOD_S)),),
    'parts that `holds until`': (_MAX_PARTS,),
    'runs of states': (MAX_RUNS,),
    'comparisons of a formula that [keeps': (MAX_SLOTS, MAX_TERM_PARTS),
    'states at which F held': (MAX_COUNTED,),
    'states that wait for the progression': (MAX_QUEUED_STATES,),
    'length of the name of a formula': (texts.MAX_NAME,),
    'texts in the status of an evaluation': (_MAX_TEXT, 100),
    'names that a message lists': (_MAX_LISTED,),
    'text of an ontology in a request': (sources._MAX_TEXT // MIB,),
    'statements of an ontology': (access.MAX_STATEMENTS,),
    'characters of a query': (queries.MAX_QUERY, queries._MAX_ANSWER),
    'queries at once': (
        ontology_manager._QUERIES,
        ontology_manager._WAITING,
        ontology_manager._WAITING,
    ),
    'length of the name of a concept': (texts.MAX_NAME,),
    'parents or argument sorts': (new_entities._MAX_CONCEPTS,),
    'times': (recording.MAX_TIME - 1,),
    'time without a message': (recording.MAX_SILENCE_NS // SECOND_NS // 3600,),
    'step back of the log time': (recording.MAX_STEP_BACK_NS // SECOND_NS,),
}
"""The numbers of each row of the page, by the beginning of its first cell."""

UNNAMED = (
    'elements of an array that `each`',
    'time for which messages wait in an engine',
    'requests of all pages',
)
"""Rows whose numbers are no constants."""


def numbers(cell: str) -> list[Fraction]:
    found = re.findall(r'\d{1,3}(?:[ ,\u202f]\d{3})+|\d+(?:\.\d+)?', cell)
    return [Fraction(re.sub('[ ,\u202f]', '', each)) for each in found]


def rows() -> dict[str, list[Fraction]]:
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith('| ')]
    cells = [[cell.strip() for cell in line.strip('|').split('|')] for line in lines]
    return {name: numbers(value) for name, value in cells if not name.startswith('limit')}


@pytest.mark.parametrize('beginning', ROWS)
def test_a_row(beginning: str) -> None:
    (found,) = (value for name, value in rows().items() if name.startswith(beginning))
    assert tuple(found) == ROWS[beginning]


def test_all_rows_are_known() -> None:
    others = [each for each in rows() if not each.startswith((*ROWS, *UNNAMED))]
    assert not others


def test_other_constants() -> None:
    """Numbers outside of the tables."""
    assert MAX_RECORDED_NS == 10 * 60 * SECOND_NS
    assert f'at most {MAX_RECORDED_TOPICS} topics' in PAGE.read_text().replace('\n', ' ')
    assert synchronisation.MAX_TICKS == term_sizes.MAX_TICK_RATE
    assert synchronisation.MAX_VALUES == term_sizes.MAX_VALUE_RATE
    assert synchronisation.MAX_WAITING == constraint_checks.MAX_HELD
    assert access.MAX_STATEMENTS == MAX_PAIRS
    assert requests.MAX_NAME == MAX_FORMULA
    assert topic_sources.MAX_HELD == node_topics.MAX_TAKEN

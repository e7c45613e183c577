"""Annotations are checked again when the type of their topic becomes known."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces.msg import ExitStatus
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    ConceptCreate,
    ConceptDestroy,
    FindAllMatchingStreams,
    ListSemanticSpecifications,
)
from nav_msgs.msg import Odometry

from commands import command, output_of
from dyknow_semantics.ros.stream_semantics_manager import CHECK_PERIOD_S
from services import LATCHED, Nodes

ONTOLOGY = Path(__file__).parent.parent / 'docs' / 'examples' / 'rover.owl'
STATEMENT = 'stream "/rover1/odom" contains Speed[rover1] = twist.twist.linear.vx;'
SPEED = 'Speed[rover1]'
FAULT = "nav_msgs/msg/Odometry has no field 'twist.twist.linear.vx'"


def test_a_field_that_the_type_lacks_is_found_when_the_type_is_known(tmp_path: Path) -> None:
    annotations = tmp_path / 'bot.ssl'
    annotations.write_text(f'# The robot.\n{STATEMENT}\n')
    with Nodes(
        tmp_path,
        ontology_manager={'ontologies': [str(ONTOLOGY)]},
        stream_semantics_manager={'annotations': [str(annotations)]},
        semantic_matching_engine={},
    ) as nodes:
        statuses = nodes.collect(DiagnosticStatus, '/stream_semantics_manager/_status', LATCHED)

        def listed() -> Any:
            return nodes.obtain('stream_semantics_manager', ListSemanticSpecifications)

        def matching() -> Any:
            return nodes.call('semantic_matching_engine', FindAllMatchingStreams, concept=SPEED)

        assert list(listed().faults) == ['']
        assert matching().exit_status.code == ExitStatus.SUCCESS
        publisher = nodes.client.node.create_publisher(Odometry, '/rover1/odom', 10)
        nodes.client.spin_until(
            lambda: bool(statuses) and statuses[-1].level == DiagnosticStatus.ERROR, 'the fault'
        )
        assert statuses[-1].message.startswith(f'{annotations}: annotation:2:')
        assert FAULT in statuses[-1].message
        assert FAULT in next(each.value for each in statuses[-1].values if each.key == 'faults')
        logged = [each for each in nodes.log('stream_semantics_manager') if FAULT in each]
        assert len(logged) == 1
        assert logged[0].startswith('[ERROR]')
        assert f'{annotations}: annotation:2:' in logged[0]
        assert FAULT in listed().faults[0]
        refused = matching().exit_status
        assert refused.code == ExitStatus.NOT_FOUND
        assert refused.message.startswith(
            f'no stream carries {SPEED}; the annotation of /rover1/odom'
        )
        assert FAULT in refused.message
        line = command('semantics', '--json')
        shown = json.loads(output_of(line, nodes.environment).stdout)
        assert FAULT in shown['faults'][STATEMENT]
        assert not any(each['streams'] for each in shown['concepts'])
        nodes.client.node.destroy_publisher(publisher)


def test_a_feature_that_gets_another_type(tmp_path: Path) -> None:
    """Also an annotation that fitted the ontology before is checked again."""
    semantics = 'stream_semantics_manager'
    with Nodes(
        tmp_path, ontology_manager={'ontologies': [str(ONTOLOGY)]}, stream_semantics_manager={}
    ) as nodes:
        publisher = nodes.client.node.create_publisher(Odometry, '/rover1/odom', 10)
        statuses = nodes.collect(DiagnosticStatus, f'/{semantics}/_status', LATCHED)

        def create(value_type: str) -> None:
            nodes.obtain(
                'ontology_manager', ConceptCreate, concept_name='Lean', parent_concepts=['Feature'],
                argument_sorts=['Rover'], value_type=value_type,
            )  # fmt: skip

        create('float')
        statement = 'stream "/rover1/odom" contains Lean[rover1] = pose.pose.orientation.x;'
        nodes.obtain(semantics, AddSemanticSpecification, ssl_statement=statement)
        checked = time.monotonic() + 3 * CHECK_PERIOD_S
        nodes.client.spin_until(lambda: time.monotonic() > checked, 'the first check')
        assert statuses[-1].level == DiagnosticStatus.OK
        nodes.obtain('ontology_manager', ConceptDestroy, concept_name='Lean')
        create('string')
        nodes.client.spin_until(
            lambda: "feature 'Lean' has values of the type string" in statuses[-1].message,
            'the fault',
        )
        (fault,) = nodes.obtain(semantics, ListSemanticSpecifications).faults
        assert "feature 'Lean' has values of the type string" in fault
        nodes.client.node.destroy_publisher(publisher)

"""Duties of every node: the documented services, a status, a clean end, clear errors."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, StreamSpec

from commands import command, output_of
from services import LATCHED, PACKAGES, SERVICES, Nodes, assert_refused, service_name
from system import NOTICED, private_environment


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """All nodes, which have been told of nothing."""
    folder = tmp_path_factory.mktemp('all')
    with Nodes(folder, **{node: {} for node in PACKAGES}) as nodes:  # SIGTERM ends them.
        yield nodes
    assert_without_traceback(folder)


def assert_without_traceback(folder: Path) -> None:
    for node in PACKAGES:
        assert 'Traceback' not in (folder / f'{node}.log').read_text(), node


@pytest.mark.parametrize('node', PACKAGES)
def test_the_services_are_those_documented(nodes: Nodes, node: str) -> None:
    def offered() -> set[tuple[str, str]]:
        found = nodes.client.node.get_service_names_and_types()
        own = [(name, kind) for name, (kind, *_) in found if name.startswith(f'/{node}/')]
        return {(name, kind) for name, kind in own if kind.startswith('dyknow_interfaces/srv')}

    documented = {
        (service_name(node, kind), f'dyknow_interfaces/srv/{kind}') for kind in SERVICES[node]
    }
    nodes.client.spin_until(lambda: offered() >= documented, 'all services')
    assert offered() == documented


@pytest.mark.parametrize('node', PACKAGES)
def test_the_status_is_kept_for_those_who_come_late(nodes: Nodes, node: str) -> None:
    # The node is up, and has said so before.
    statuses = nodes.collect(DiagnosticStatus, f'/{node}/_status', LATCHED)
    nodes.client.spin_until(lambda: bool(statuses), 'the status')
    assert statuses[0].name == f'/{node}'
    assert statuses[0].message
    nodes.client.spin_until(lambda: statuses[-1].level == DiagnosticStatus.OK, 'all is well')


def test_ctrl_c_ends_every_node_cleanly(tmp_path: Path) -> None:
    with Nodes(tmp_path, **{node: {} for node in PACKAGES}) as nodes:
        assert nodes.stop(signal.SIGINT) == dict.fromkeys(PACKAGES, 0)
    assert_without_traceback(tmp_path)


@pytest.mark.parametrize(
    ('node', 'parameter', 'text', 'complaint'),
    [
        ('ontology_manager', 'ontologies', None, 'cannot read the ontology'),
        ('ontology_manager', 'ontologies', '<rdf:RDF', 'parsing error'),
        ('stream_manager', 'streams', None, 'cannot read the streams'),
        (
            'stream_manager',
            'streams',
            'stream a = select from',
            "expected ',', 'as', 'from' or 'unless'",
        ),
        ('stream_manager', 'streams', '\xff', 'not in UTF-8'),
        ('stream_semantics_manager', 'annotations', None, 'cannot read the annotations'),
        ('stream_semantics_manager', 'annotations', 'stream a contain', "expected 'contains'"),
        ('stream_semantics_manager', 'annotations', '\xff', 'not in UTF-8'),
    ],
)
def test_a_bad_file_ends_a_node_with_one_clear_complaint(
    tmp_path: Path, node: str, parameter: str, text: str | None, complaint: str
) -> None:
    file = tmp_path / 'input.owl'
    if text is not None:
        file.write_text(text, encoding='latin-1')
    line = command(node, '--ros-args', '-p', f'{parameter}:=["{file}"]')
    ended = output_of(line, private_environment())
    first, *place = ended.stderr.splitlines()
    assert ended.returncode == 1
    assert complaint in first
    assert str(file) in first
    # A language shows the place under its complaint.
    assert not place or (place[0] == f'  {text}' and place[1].strip() == '^')


def test_the_caller_is_told_which_node_is_absent(tmp_path: Path) -> None:
    spec = StreamSpec(name='a', specification='select b from "/b"')
    annotation = 'stream a contains Power[uav1] = b'
    needy = {
        'stream_manager': (srv.StreamCreateFromSpec, {'spec': spec}),
        'stream_semantics_manager': (srv.AddSemanticSpecification, {'ssl_statement': annotation}),
        'semantic_matching_engine': (srv.FindAllMatchingStreams, {'concept': 'Power[uav1]'}),
        'stream_reasoning_coordinator': (srv.EvaluateFormula, {'formula': 'always Power[a] < 1'}),
    }
    with Nodes(tmp_path, **{node: {} for node in needy}) as nodes:
        answers = {
            node: nodes.request(node, service, **fields)
            for node, (service, fields) in needy.items()
        }
        for node, answer in answers.items():
            nodes.client.spin_until(answer.done, f'answer of {node}', NOTICED)
    for node, absent in {
        'stream_manager': 'stream processing engine',
        'stream_semantics_manager': 'ontology_manager',
        'semantic_matching_engine': 'ontology_manager',
        'stream_reasoning_coordinator': 'stream_reasoning_engine',
    }.items():
        assert_refused(answers[node].result().exit_status, ExitStatus.UNAVAILABLE, absent)

"""Diagnostics and log of the nodes that the coordinator depends on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from services import SERVICES, Nodes

EXAMPLES = Path(__file__).parent.parent / 'docs' / 'examples'
ENGINE = '/stream_processing_engine: node'


def test_a_killed_node_is_an_error_until_it_is_back(tmp_path: Path) -> None:
    present = set(SERVICES) - {'semantic_matching_engine'}
    with Nodes(tmp_path, **{node: {} for node in present}) as nodes:
        heard = nodes.collect(DiagnosticArray, '/diagnostics')

        def status(name: str) -> Any:
            found = heard[-1].status if heard else ()
            return next((each for each in found if each.name == name), DiagnosticStatus())

        def level(name: str) -> Any:
            return status(name).level if status(name).name else None

        def wait_for(name: str, expected: bytes) -> None:
            nodes.client.spin_until(
                lambda: level(name) == expected, f'{name}: {expected!r}', instead=lambda: heard[-1:]
            )

        for node in present - {'stream_reasoning_coordinator'}:
            wait_for(f'/{node}: node', DiagnosticStatus.OK)
        assert status(ENGINE).hardware_id == 'none'
        values = {each.key: each.value for each in status(ENGINE).values}
        assert int(values['computational units']) > 0
        wait_for('/semantic_matching_engine: node', DiagnosticStatus.ERROR)
        absent = status('/semantic_matching_engine: node').message
        assert absent.startswith('not found within ')
        for node in ('stream_processing_engine', 'stream_semantics_manager'):
            nodes.kill(node)
            wait_for(f'/{node}: node', DiagnosticStatus.ERROR)
            assert status(f'/{node}: node').message.startswith('gone for ')
            (line,) = (
                each
                for each in nodes.log('stream_reasoning_coordinator')
                if f'node /{node} is gone' in each
            )
            assert line.startswith('[ERROR]')
            nodes.start(node)
            wait_for(f'/{node}: node', DiagnosticStatus.OK)
        nodes.start('semantic_matching_engine')
        wait_for('/semantic_matching_engine: node', DiagnosticStatus.OK)


def test_each_node_logs_what_it_has_loaded(tmp_path: Path) -> None:
    streams = tmp_path / 'a.streams'
    streams.write_text(
        'stream a = select x from "/a"; stream b = select x from "/b"; sink a; sink b'
    )
    ontology, annotations = EXAMPLES / 'rover.owl', EXAMPLES / 'rover.ssl'
    with Nodes(
        tmp_path,
        stream_manager={'streams': [str(streams)]},
        ontology_manager={'ontologies': [str(ontology)]},
        stream_semantics_manager={'annotations': [str(annotations)]},
        stream_reasoning_engine={},
    ) as nodes:
        expected = {
            'ontology_manager': 'ready: 3 concepts, 2 features, 1 object from 1 file',
            'stream_semantics_manager': 'ready: 2 annotations from 1 file',
            'stream_reasoning_engine': 'ready',
        }
        assert not any('ready' in line for line in nodes.log('stream_manager')), 'no engine'
        nodes.start('stream_processing_engine')
        expected['stream_manager'] = 'ready: 2 streams from 1 file'
        nodes.client.spin_until(
            lambda: any('ready' in line for line in nodes.log('stream_manager')), 'its streams'
        )
        for node, text in expected.items():
            lines = [line for line in nodes.log(node) if 'ready' in line]
            assert [line.partition(']: ')[2] for line in lines] == [text]
            assert lines[0].startswith('[INFO]')

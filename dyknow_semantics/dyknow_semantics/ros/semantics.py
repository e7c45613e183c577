"""Show ontologies, the streams that carry their features, and why streams match a concept."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery

from dyknow_common import SECOND_NS, ExitCode, duration_option
from dyknow_common.executables import describe
from dyknow_common.ros import SERVICE, CommandNode, command_main, run_with_node, snake_case
from dyknow_common.tables import Terminal
from dyknow_semantics.annotations.parsing import parse_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.matching.bridges import bridged
from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.ontology.knowledge import ALL_TRIPLES
from dyknow_semantics.reporting.hierarchy import (
    explanation_tree,
    hierarchy_entries,
    hierarchy_tree,
)
from dyknow_semantics.ros.mirrors import annotations_by_text, faults_of, read_bridges, triples_of


def show(options: argparse.Namespace, command: CommandNode) -> None:
    """Print the hierarchies, or the reasons why streams match a concept.

    Raises:
        DyKnowError: if a node does not answer, or the concept or a file of bridges is invalid.
    """
    matcher = _fetch_matcher(options, command)
    console = Terminal(highlight=False)
    if options.explain:
        concept = parse_concept(options.explain)
        explanations = matcher.explain(concept)
        if options.json:
            print(json.dumps([asdict(each) for each in explanations]))  # noqa: T201 - a command
        else:
            console.print(explanation_tree(str(concept), explanations))
        return
    entries = hierarchy_entries(matcher)
    if options.json:
        concepts = [asdict(each) for each in entries]
        print(json.dumps({'concepts': concepts, 'faults': dict(matcher.faults)}))  # noqa: T201
        return
    console.print(hierarchy_tree(entries))
    for text, fault in matcher.faults.items():
        console.out(f'invalid annotation: {text}\n  {fault}')


def add_semantics_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(
        command=lambda options: run_with_node('semantics', lambda node: show(options, node))
    )
    describe(
        parser,
        'Show ontologies, the streams that carry their features, and why streams match a concept.',
        (
            'dyknow semantics',
            'dyknow semantics --explain Power[uav1]',
        ),
        '0 if it was shown, 2 if there is no such concept, or no answer',
    )
    parser.add_argument(
        '--explain', metavar='CONCEPT', help='explain which streams match it and which do not'
    )
    parser.add_argument(
        '--bridges', metavar='FILE', action='append', default=[], help='bridges to follow'
    )
    parser.add_argument('--json', action='store_true', help='print a line of JSON')
    parser.add_argument(
        '--timeout',
        type=duration_option,
        default='5 s',
        help='to wait for an answer (default: 5 s)',
    )
    for role, default in (
        ('ontology-manager', 'ontology_manager'),
        ('semantics-manager', 'stream_semantics_manager'),
    ):
        parser.add_argument(
            f'--{role}', default=default, help=f'the name of the node (default: {default})'
        )


def _fetch_matcher(options: argparse.Namespace, command: CommandNode) -> Matcher:
    """Return a matcher with the ontologies and annotations of the nodes."""
    bridges = read_bridges(options.bridges)
    timeout_ns = options.timeout
    ontology = _call(
        command, timeout_ns, OntologyQuery, options.ontology_manager, sparql=ALL_TRIPLES
    )
    listed = _call(command, timeout_ns, ListSemanticSpecifications, options.semantics_manager)
    ontologies = bridged(triples_of(ontology), bridges)
    if ontologies.faults:
        raise SemanticsError('\n'.join(ontologies.faults))
    matcher = Matcher(ontologies.known, ontologies.stated)
    matcher.set_annotations(annotations_by_text(listed.ssl_statements), faults_of(listed))
    return matcher


def _call(
    command: CommandNode, timeout_ns: int, service_type: Any, node: str, **fields: Any
) -> Any:
    """Return the response of a service.

    Raises:
        SemanticsError: UNAVAILABLE, if there is none in time; the error of a refusal.
    """

    def no_answer() -> SemanticsError:
        return SemanticsError(
            f'{command.node.resolve_service_name(node)} has not answered within '
            f'{timeout_ns / SECOND_NS:g} s; is DyKnow running, in this namespace and ROS domain?',
            ExitCode.UNAVAILABLE,
        )

    name = f'{node}/{snake_case(service_type.__name__)}'
    client = command.node.create_client(service_type, name, qos_profile=SERVICE)
    end = command.deadline(timeout_ns)
    command.spin_until(client.service_is_ready, end, no_answer)
    future = client.call_async(service_type.Request(**fields))
    command.spin_until(future.done, end, no_answer)
    response = future.result()
    if response.exit_status.code != ExitCode.SUCCESS:
        raise SemanticsError(response.exit_status.message, ExitCode(response.exit_status.code))
    return response


def main() -> int:
    """Run the executable semantics."""
    return command_main('semantics', add_semantics_options)

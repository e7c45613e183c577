"""Show ontologies, the streams that carry their features, and why streams match a concept."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery

from dyknow_common import duration_option
from dyknow_common.executables import describe
from dyknow_common.ros import CommandNode, command_main, run_with_node
from dyknow_common.tables import Terminal
from dyknow_semantics.annotations.parsing import parse_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.hierarchy import (
    explanation_tree,
    hierarchy_entries,
    hierarchy_tree,
)
from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.ontology.bridges import bridged
from dyknow_semantics.ontology.knowledge import ALL_TRIPLES
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
        '--bridges',
        metavar='FILE',
        action='append',
        default=[],
        help='bridges to follow, beside the bridges of the system',
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
    ontology = command.call(OntologyQuery, options.ontology_manager, timeout_ns, sparql=ALL_TRIPLES)
    listed = command.call(ListSemanticSpecifications, options.semantics_manager, timeout_ns)
    ontologies = bridged(triples_of(ontology), bridges)
    if options.bridges and ontologies.faults:
        raise SemanticsError('\n'.join(ontologies.faults))
    matcher = Matcher(ontologies.known)
    matcher.set_annotations(annotations_by_text(listed.ssl_statements), faults_of(listed))
    return matcher


def main() -> int:
    """Run the executable semantics."""
    return command_main('semantics', add_semantics_options)

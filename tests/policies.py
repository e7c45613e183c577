"""SROS2 policies, and what the nodes of a running system use, in the same terms."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase

from rclpy.node import Node

ACTION_SERVICES = ('cancel_goal', 'get_result', 'send_goal')
ACTION_TOPICS = ('feedback', 'status')

OF_ACTIONS = {'execute': ('reply', 'publish'), 'call': ('request', 'subscribe')}
"""The uses of an action's services and topics by its server and its client."""


@dataclass(frozen=True, order=True)
class Use:
    """One use of a topic or service by the nodes of an enclave; in a policy, a pattern of names."""

    enclave: str
    permission: str
    name: str

    def permits(self, use: Use) -> bool:
        """True if a rule permits a use; `*` stands for any text, as in DDS."""
        same = (self.enclave, self.permission) == (use.enclave, use.permission)
        return same and fnmatchcase(use.name, self.name)


def rules(policy: str) -> set[Use]:
    """The permissions of a policy."""
    return {
        rule
        for enclave in ET.fromstring(policy).iter('enclave')  # noqa: S314 - our own file
        for names in enclave.findall('profiles/profile/*')
        for permission, qualifier in names.attrib.items()
        if qualifier == 'ALLOW'
        for name in names
        for rule in _expanded(enclave.attrib['path'], permission, name.text or '')
    }


def _expanded(enclave: str, permission: str, name: str) -> Iterator[Use]:
    if permission not in OF_ACTIONS:
        yield Use(enclave, permission, name)
        return
    of_services, of_topics = OF_ACTIONS[permission]
    for each in ACTION_SERVICES:
        yield Use(enclave, of_services, f'{name}/_action/{each}')
    for each in ACTION_TOPICS:
        yield Use(enclave, of_topics, f'{name}/_action/{each}')


class GraphRecorder:
    """Everything that nodes are seen to use, by their enclaves.

    Args:
        node: that looks at the ROS graph; what it uses itself is left out.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.uses: set[Use] = set()
        self.names: defaultdict[str, set[str]] = defaultdict(set)
        """The names of the nodes in each enclave."""
        self.without_enclave: set[str] = set()
        """The names of the nodes that are on the graph now, and whose enclave was never known."""

    def look(self) -> None:
        """Note what is on the graph now.

        The middleware hears of a participant and of its nodes by different topics: a node of which
        it hears before its participant, or after its end, has an empty enclave.
        """
        own = self._node.get_name()
        nodes: defaultdict[str, set[str]] = defaultdict(set)
        for name, namespace, enclave in self._node.get_node_names_and_namespaces_with_enclaves():
            if name != own:
                nodes[enclave].add(f'{namespace.rstrip("/")}/{name}')
                if enclave:
                    self.uses.update(self._uses(name, namespace, enclave))
        self.without_enclave = nodes.pop('', set())
        for enclave, names in nodes.items():
            self.names[enclave] |= names
        self.without_enclave.difference_update(*self.names.values())

    def _uses(self, name: str, namespace: str, enclave: str) -> Iterator[Use]:
        for permission, names_and_types in (
            ('publish', self._node.get_publisher_names_and_types_by_node),
            ('subscribe', self._node.get_subscriber_names_and_types_by_node),
            ('reply', self._node.get_service_names_and_types_by_node),
            ('request', self._node.get_client_names_and_types_by_node),
        ):
            try:
                found = names_and_types(name, namespace)
            except RuntimeError:
                continue  # The node has just left the graph.
            for used, _ in found:
                yield Use(enclave, permission, used)


__all__ = ['GraphRecorder', 'Use', 'rules']

"""Policies of SROS2: what the nodes of a system may do, as `ros2 security` reads it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from dyknow_bringup.security.interfaces import Interfaces

_RULES = (
    # The field of Interfaces, and how a policy calls it: the list, its attribute, an entry.
    ('serves', 'services', 'reply', 'service'),
    ('requests', 'services', 'request', 'service'),
    ('publishes', 'topics', 'publish', 'topic'),
    ('subscribes', 'topics', 'subscribe', 'topic'),
    ('executes', 'actions', 'execute', 'action'),
    ('calls', 'actions', 'call', 'action'),
)


@dataclass(frozen=True, slots=True)
class Enclave:
    """A set of permissions with keys of its own, for one process.

    Args:
        path: its name, which is the node's name where it is for one node.
        nodes: the interfaces of its nodes with absolute names, by the absolute names of the nodes.
    """

    path: str
    nodes: Mapping[str, Interfaces]


def policy_text(enclaves: Iterable[Enclave], comment: str) -> str:
    """Return a policy that permits what the interfaces of enclaves name, and nothing else."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<!-- {comment} -->',
        '<policy version="0.2.0">',
        '  <enclaves>',
        *(line for enclave in enclaves for line in _enclave(enclave)),
        '  </enclaves>',
        '</policy>',
    ]
    return '\n'.join(lines) + '\n'


def _enclave(enclave: Enclave) -> Iterator[str]:
    yield f'    <enclave path={quoteattr(enclave.path)}>'
    yield '      <profiles>'
    for node, interfaces in enclave.nodes.items():
        namespace, _, name = node.rpartition('/')
        yield f'        <profile ns={quoteattr(namespace or "/")} node={quoteattr(name)}>'
        yield from _rules(interfaces)
        yield '        </profile>'
    yield '      </profiles>'
    yield '    </enclave>'


def _rules(interfaces: Interfaces) -> Iterator[str]:
    for field, kind, permission, entry in _RULES:
        names = getattr(interfaces, field)
        if names:
            yield f'          <{kind} {permission}="ALLOW">'
            for name in sorted(names):
                yield f'            <{entry}>{escape(name)}</{entry}>'
            yield f'          </{kind}>'

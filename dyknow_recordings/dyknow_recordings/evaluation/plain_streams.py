"""Streams that are plain enough for their states to be made as columns.

A state stream is plain if it synchronises fields that are selected from topics, by their latest
values, and has no constraints. Its states are then a function of the messages alone: at each valid
time of a message, the latest values of all topics.
"""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_common import NO_CONSTRAINTS
from dyknow_stream_processing import Approximation, Select, StreamReference, Sync, Term

PlainInputs = Mapping[str, Mapping[str, str]]
"""For each topic, the field of each feature."""


def plain_inputs(term: Term) -> PlainInputs | None:
    """Return the topics of a plain state stream, with their fields by feature; None for others."""
    if not isinstance(term, Sync) or term.constraints != NO_CONSTRAINTS:
        return None
    if term.approximation is not Approximation.LATEST:
        return None
    topics: dict[str, dict[str, str]] = {}
    features: set[str] = set()
    for each in term.inputs:
        found = selected_fields(each)
        if found is None or features & found[1].keys():
            return None
        features |= found[1].keys()
        topics.setdefault(found[0], {}).update(found[1])
    return topics


def selected_fields(term: Term) -> tuple[str, Mapping[str, str]] | None:
    """Return the topic of a plain selection, and its fields by their new names; None for others."""
    if not isinstance(term, Select) or term.constraints != NO_CONSTRAINTS or term.conditions:
        return None
    if any(each.embedded_fields for each in term.selections):
        return None
    fields = {each.name: each.field for each in term.selections}
    if len(fields) < len(term.selections):
        return None
    if isinstance(term.source, StreamReference):
        is_plain = term.source.is_topic and term.source.constraints == NO_CONSTRAINTS
        return (term.source.name, fields) if is_plain else None
    inner = selected_fields(term.source)
    if inner is None or not inner[1].keys() >= set(fields.values()):
        return None
    return inner[0], {name: inner[1][path] for name, path in fields.items()}

"""Objects and matching streams: from an ontology with annotations, or without any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from dyknow_common import NO_CONSTRAINTS, ExitCode, StreamConstraints
from dyknow_configuration import TextSource
from dyknow_coordinator import SILENCE_LIMIT_NS
from dyknow_recordings.errors import RecordingError

if TYPE_CHECKING:
    from dyknow_semantics import Knowledge


@dataclass(frozen=True, slots=True)
class MonitoringFiles:
    """The files that `dyknow up` is started with, or their texts.

    Args:
        ontologies: OWL files.
        annotations: files in SSL.
        streams: files in the stream language.
        bridges: files of bridge rules between the ontologies.
        domains: the objects of sorts, which take precedence over the ontologies.
        states: the specification of the states of the only formula; empty: it is grounded.
        constraints: the constraints of the states of all formulas.
        missing_is_unknown: True if NaN or an absent field is an unknown value of any feature, not
            only of features that the ontologies allow to be unknown.
        silence_limit: the time without a message after which a topic is silent, in nanoseconds.
    """

    ontologies: tuple[TextSource, ...] = ()
    annotations: tuple[TextSource, ...] = ()
    streams: tuple[TextSource, ...] = ()
    bridges: tuple[TextSource, ...] = ()
    domains: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    states: str = ''
    constraints: StreamConstraints = NO_CONSTRAINTS
    missing_is_unknown: bool = False
    silence_limit: int = SILENCE_LIMIT_NS


NO_FILES: Final = MonitoringFiles()


class Vocabulary:
    """The answers of the semantic nodes; here, without an ontology or annotations.

    Formulas then name their streams, and sorts have domains. All methods but `close` raise
    DyKnowError.

    Args:
        domains: the objects of each sort.
    """

    knowledge: Knowledge | None = None
    """The ontologies with the bridges between them; None if there are none."""

    notes: Sequence[str] = ()
    """Annotations and bridges that are not used, with the reasons."""

    def __init__(self, domains: Mapping[str, tuple[str, ...]]) -> None:
        self._domains = domains

    def instances(self, sort: str) -> tuple[str, ...]:
        """Return the objects of a sort."""
        if sort not in self._domains:
            raise RecordingError(
                f"the objects of the sort '{sort}' are unknown; give an ontology, or the objects: "
                f'objects: {{{sort}: [object1, object2]}} in robot.yaml, or for a check, '
                f'--domain {sort}=object1,object2',
                ExitCode.NOT_FOUND,
            )
        return self._domains[sort]

    def query(self, sparql: str) -> Sequence[tuple[str, ...]]:  # noqa: ARG002
        """Return the solutions of a query of the ontologies."""
        return ()

    def matching_streams(self, concept: str) -> tuple[str, ...]:
        """Return the specifications of the streams that match a concept, best first."""
        raise RecordingError(
            f'no annotations are given; name a topic and a field instead of {concept}, such as '
            '"/uav1/battery".voltage',
            ExitCode.NOT_FOUND,
        )

    def close(self) -> None:
        """Free all files."""

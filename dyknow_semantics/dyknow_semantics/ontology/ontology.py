"""The shared ontology: loading, changing and storing it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from dyknow_common import listed, shortened
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.bridges import Bridge, bridged
from dyknow_semantics.ontology.documents.access import MAX_STATEMENTS, Access
from dyknow_semantics.ontology.documents.documents import Document, read_documents, read_text
from dyknow_semantics.ontology.features import INHERITED, StatedSignature
from dyknow_semantics.ontology.knowledge import Knowledge, Triple
from dyknow_semantics.ontology.names import split_iri
from dyknow_semantics.ontology.new_entities import (
    check_concept_name,
    check_number,
    checked_parents,
    checked_signature,
    new_iri,
)
from dyknow_semantics.ontology.queries import MAX_SOLUTIONS, Solutions, answer_query, check_query
from dyknow_semantics.ontology.reasoner import Draft
from dyknow_semantics.ontology.store import Store
from dyknow_semantics.ontology.vocabulary import (
    BRIDGES_ONTOLOGY,
    ENTAILED_ONTOLOGY,
    RUNTIME_ONTOLOGY,
    UPPER_ONTOLOGY,
)

Row = tuple[str, ...]
"""The values of a query's variables in one solution."""


class Ontology:
    """The concepts, instances and features that the nodes of a system share.

    Each change is atomic: it is checked against the upper ontology and stored before the method
    returns, or it is refused and has no effect. Loading an ontology again replaces its previous
    contents and keeps what was created at run time.

    Methods accept short names (`Altitude`), prefixed names (`uav:Altitude`, with the last part of
    the ontology's IRI) and IRIs; they return the shortest unambiguous names. The methods that
    create or destroy something return the concepts whose instances or matches may have changed;
    an empty tuple stands for all concepts.

    Args:
        store: the file that keeps the ontology over restarts; `None` keeps nothing.
        bridges: the rules between the ontologies; a rule with unknown names waits for the names.

    Raises:
        SemanticsError: if the store cannot be opened; from the methods that load or draft, if a
            document cannot be read or the result contradicts the upper ontology or is too large.
    """

    knowledge: Knowledge
    """The present contents with the consequences of bridges; each change replaces them."""

    triples: tuple[Triple, ...]
    """The solutions of `ALL_TRIPLES`; each change replaces them."""

    bridge_faults: tuple[str, ...] = ()
    """Why some bridges have no effect at present."""

    revision = 0
    """The number of changes, without entailed statements."""

    def __init__(self, store: str | Path | None = None, bridges: Iterable[Bridge] = ()) -> None:
        self._bridges = tuple(bridges)
        self._max_statements = MAX_STATEMENTS
        self._copies = 0
        with ExitStack() as resources:
            # A temporary ontology needs a file too: a change is undone by opening the store again.
            folder = TemporaryDirectory(prefix='dyknow_', ignore_cleanup_errors=True)
            self._folder = Path(resources.enter_context(folder))
            self._latest = self._folder / 'latest'
            self._store = Store(Path(store or self._folder / 'store'))
            resources.callback(self._store.close)
            self.load(UPPER_ONTOLOGY)
            self._resources = resources.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the store."""
        self._resources.close()

    def load(self, path_or_iri: str | Path) -> None:
        """Add an ontology with its imports that are not loaded yet.

        The imports of a file lie beside it, under the last part of their IRI (`uav.owl` for
        `http://www.dyknow.org/uav`). The imports of an ontology from the web are downloaded.
        """
        self.add(read_documents(str(path_or_iri), self.ontologies, Access()))

    def load_text(self, text: str) -> None:
        """Add the ontology in a text, whose imports are loaded."""
        self.add(read_text(text, '', self.ontologies, Access()))

    @property
    def ontologies(self) -> frozenset[str]:
        """The IRIs of the ontologies that are loaded."""
        return self._store.ontologies

    def add(self, documents: Iterable[Document]) -> None:
        """Add ontologies that were read; each replaces its previous contents."""
        self._change(lambda: self._store.put(documents))
        # The caches of owlready2 may hold the previous contents.
        self._store.reopen()

    def draft(self, documents: Iterable[Document] = ()) -> Draft:
        """Return the contents after adding documents, without adding them."""
        try:
            self._store.put(documents)
            knowledge = Knowledge(self._store.triples())
            return Draft(self.revision, self._store.text(), knowledge.name)
        finally:
            self._store.reopen()

    def set_entailed(self, entailed: Iterable[Triple], revision: int) -> bool:
        """Replace the entailed statements by statements that a reasoner derived from a revision.

        Returns:
            False if the ontology has another revision; then nothing is replaced.
        """
        if revision != self.revision:
            return False
        self._change(lambda: self._store.put_derived(ENTAILED_ONTOLOGY, entailed))
        self.revision = revision
        self._store.reopen()
        return True

    def create_concept(
        self,
        name: str,
        parents: Collection[str] = (),
        signature: StatedSignature = INHERITED,
    ) -> tuple[str, ...]:
        """Add a concept below others.

        Args:
            name: its name.
            parents: the concepts directly above; if empty, the concept is a sort, or with a
                signature a feature directly below `Feature`.
            signature: the signature of a feature, with the names of its argument sorts.

        Raises:
            SemanticsError: if the name exists or is reserved, a parent or an argument sort is
                unknown, or the signature is invalid, incomplete or contradicts a parent's.
        """
        above = checked_parents(name, parents, signature, self.knowledge)
        stated = checked_signature(name, above, signature, self.knowledge)
        iri = self._new_iri(name)
        check_concept_name(iri)
        self._change(lambda: self._store.add_class(iri, above, stated))
        return self._affected(iri, self.knowledge.superconcepts(iri))

    def destroy_concept(self, name: str) -> tuple[str, ...]:
        """Remove a concept that nothing depends on.

        Raises:
            SemanticsError: if it is unknown, has subconcepts or instances, is the sort of an
                argument, or belongs to the upper ontology.
        """
        iri = self.knowledge.concept_names.iri(name)
        obstacles = '; '.join(self._dependencies(iri))
        if obstacles:
            raise SemanticsError(f"the concept '{name}' cannot be destroyed: {obstacles}")
        affected = self._affected(iri, self.knowledge.superconcepts(iri))
        self._change(lambda: self._store.remove(iri))
        return affected

    def create_instance(self, name: str, concepts: Collection[str]) -> tuple[str, ...]:
        """Add an instance of one or more concepts.

        Raises:
            SemanticsError: if the name exists, a concept is unknown or a feature, or `concepts` is
                empty.
        """
        check_number(concepts, 'concepts')
        kinds = tuple(map(self._sort, concepts))
        if not kinds:
            raise SemanticsError(
                f"the instance '{shortened(name)}' needs a concept to be an instance of"
            )
        iri = self._new_iri(name)
        self._change(lambda: self._store.add_individual(iri, kinds))
        return self._affected(iri, self.knowledge.concepts(iri))

    def destroy_instance(self, name: str) -> tuple[str, ...]:
        """Remove an instance.

        Raises:
            SemanticsError: if it is unknown, or also a concept.
        """
        iri = self.knowledge.instance_names.iri(name)
        if iri in self.knowledge.concept_names:
            raise SemanticsError(f"the instance '{name}' is a concept too; destroy that")
        affected = self._affected(iri, self.knowledge.concepts(iri))
        self._change(lambda: self._store.remove(iri))
        return affected

    def query(self, sparql: str) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        """Return the variables and the solutions of a SPARQL SELECT query for owlready2.

        Concepts and instances are returned by name, other resources by IRI, a blank node as a
        negative number, an unbound variable as an empty string. The query may take for ever; to
        limit it, let a worker process answer it from a copy.

        Raises:
            SemanticsError: if the query is malformed, changes something or has too many solutions.
        """
        check_query(sparql)
        copy = self.write_copy()
        try:
            return self.rows(answer_query(copy, sparql, MAX_SOLUTIONS))
        finally:
            copy.unlink()

    def write_copy(self) -> Path:
        """Return a new file with a copy of the contents, which the caller removes."""
        if not self._latest.exists():
            self._store.copy(self._latest)
        self._copies += 1
        copy = self._folder / f'copy_{self._copies}'
        copy.hardlink_to(self._latest)
        return copy

    def rows(self, solutions: Solutions) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        """Return the variables and the rows of solutions, with the names of resources."""
        name = self.knowledge.name
        values = [
            name(value) if is_resource else value
            for value, is_resource in zip(solutions.values, solutions.resources, strict=True)
        ]
        width = len(solutions.variables)
        return solutions.variables, tuple(zip(*[iter(values)] * width, strict=True))

    def _change(self, change: Callable[[], None]) -> None:
        """Make a change, and commit it if the result is valid."""
        try:
            change()
            has_rules = bool(self._bridges) or BRIDGES_ONTOLOGY in self._store.ontologies
            if has_rules:  # What they state about names that have changed is no longer true.
                self._store.put_derived(BRIDGES_ONTOLOGY, ())
            triples = self._store.triples()
            self._check_size(triples)
            found = bridged(triples, self._bridges)
            if has_rules:
                self._store.put_derived(BRIDGES_ONTOLOGY, found.statements)
            self._store.commit()
            self._latest.unlink(missing_ok=True)
        except Exception:
            self._store.reopen()
            raise
        self.revision += 1
        self.knowledge, self.bridge_faults = found.known, found.faults
        self.triples = (*triples, *found.statements)

    def limit_growth(self, statements: int) -> None:
        """Limit the number of statements that are added to the present ones."""
        self._max_statements = len(self.triples) + statements

    def _check_size(self, triples: Collection[Triple]) -> None:
        if len(triples) > self._max_statements:
            raise SemanticsError(
                f'the ontology would have more than {self._max_statements:,} statements; '
                'remove some, or increase max_statements'
            )

    def _affected(self, iri: str, concepts: tuple[str, ...]) -> tuple[str, ...]:
        """Return some concepts, and the features whose arguments have these concepts as sorts."""
        if self.knowledge.name(iri) != split_iri(iri)[1]:
            return ()  # Another entity has the same short name: other names change too.
        features = (
            feature.name
            for feature in self.knowledge.features
            if set(concepts) & set(feature.argument_sorts)
        )
        return tuple(sorted({*concepts, *features}))

    def _dependencies(self, iri: str) -> Iterator[str]:
        """Yield the reasons why a concept cannot be destroyed."""
        knowledge = self.knowledge.stated
        name = knowledge.name(iri)
        below = [other for other in knowledge.subconcepts(name) if other != name]
        features = [each.name for each in knowledge.features if name in each.argument_sorts]
        if iri.startswith(UPPER_ONTOLOGY):
            yield 'it belongs to the upper ontology'
        for relation, names in (
            ('has the subconcepts', below),
            ('has the instances', knowledge.instances(name)),
            ('is an argument of the features', features),
        ):
            if names:
                yield f'it {relation} {listed(names)}'

    def _sort(self, name: str) -> str:
        iri = self.knowledge.concept_names.iri(name)
        if self.knowledge.name(iri) not in self.knowledge.sorts:
            raise SemanticsError(f"the concept '{name}' is a feature; features have no instances")
        return iri

    def _new_iri(self, name: str) -> str:
        return new_iri(name, self.knowledge, self._store.ontologies, RUNTIME_ONTOLOGY)

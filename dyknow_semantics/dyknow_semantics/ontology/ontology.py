"""The shared ontology: loading, changing and storing it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.knowledge import Knowledge, Triple
from dyknow_semantics.ontology.names import split_iri
from dyknow_semantics.ontology.reasoner import Draft
from dyknow_semantics.ontology.sources import read_source
from dyknow_semantics.ontology.store import (
    RUNTIME_ONTOLOGY,
    Document,
    Row,
    Store,
    read_with_imports,
)
from dyknow_semantics.ontology.vocabulary import UPPER_ONTOLOGY


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

    Raises:
        SemanticsError: if the store cannot be opened; from the methods that load or draft, if a
            document cannot be read or the result contradicts the upper ontology.
    """

    knowledge: Knowledge
    """The present contents; each change replaces them."""

    revision = 0
    """The number of changes, except those of entailed statements."""

    def __init__(self, store: str | Path | None = None) -> None:
        with ExitStack() as resources:
            # A temporary ontology needs a file too: a change is undone by opening the store again.
            folder = resources.enter_context(TemporaryDirectory(prefix='dyknow_'))
            self._store = Store(Path(store or Path(folder, 'store')))
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
        `http://www.dyknow.org/uav`); those of an ontology from the web are downloaded.
        """
        self.add(self.read(path_or_iri))

    def read(self, path_or_iri: str | Path) -> tuple[Document, ...]:
        """Return the documents that `load` adds."""
        return read_with_imports(read_source(str(path_or_iri)), self._store.ontologies)

    def add(self, documents: Iterable[Document]) -> None:
        """Add ontologies; each replaces its previous contents."""
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
        """Replace the entailed statements by those that a reasoner derived from a revision.

        Returns:
            False if the ontology has another revision; then nothing is replaced.
        """
        if revision != self.revision:
            return False
        self._change(lambda: self._store.put_entailed(entailed))
        self.revision = revision
        self._store.reopen()
        return True

    def create_concept(self, name: str, parents: Iterable[str] = ()) -> tuple[str, ...]:
        """Add a concept below others.

        Raises:
            SemanticsError: if the name exists, a parent is unknown, or the concept is a feature
                that inherits no signature.
        """
        above = tuple(map(self.knowledge.concept_names.iri, parents))
        iri = self._new_iri(name)
        self._change(lambda: self._store.add_class(iri, above))
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

    def create_instance(self, name: str, concepts: Iterable[str]) -> tuple[str, ...]:
        """Add an instance of one or more concepts.

        Raises:
            SemanticsError: if the name exists, a concept is unknown or a feature, or `concepts` is
                empty.
        """
        kinds = tuple(map(self._sort, concepts))
        if not kinds:
            raise SemanticsError(f"the instance '{name}' needs a concept to be an instance of")
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
        negative number, an unbound variable as an empty string.

        Raises:
            SemanticsError: if the query is malformed, changes something or takes too long.
        """
        return self._store.select(sparql, self.knowledge.name)

    def _change(self, change: Callable[[], None]) -> None:
        """Make a change, and commit it if the result is valid."""
        try:
            change()
            knowledge = Knowledge(self._store.triples())
        except Exception:
            self._store.reopen()
            raise
        self._store.commit()
        self.revision += 1
        self.knowledge = knowledge

    def _affected(self, iri: str, concepts: tuple[str, ...]) -> tuple[str, ...]:
        """Return some concepts and the features with arguments of these sorts."""
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
        knowledge = self.knowledge
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
                yield f'it {relation} {", ".join(names)}'

    def _sort(self, name: str) -> str:
        iri = self.knowledge.concept_names.iri(name)
        if self.knowledge.name(iri) not in self.knowledge.sorts:
            raise SemanticsError(f"the concept '{name}' is a feature; features have no instances")
        return iri

    def _new_iri(self, name: str) -> str:
        """Return the IRI of a new entity."""
        knowledge = self.knowledge
        if name in knowledge.concept_names or name in knowledge.instance_names:
            raise SemanticsError(f"'{name}' already exists", ExitCode.ALREADY_EXISTS)
        if '/' in name:
            namespace, local = split_iri(name)
        else:
            namespace = RUNTIME_ONTOLOGY
            prefix, colon, local = name.rpartition(':')
            if colon:
                namespace = knowledge.prefixes.namespace(prefix, self._store.ontologies)
        if not re.fullmatch(r'[A-Za-z_][\w.-]*', local):
            raise SemanticsError(
                f"'{name}' is not a valid name; it must begin with a letter or _, "
                'followed by letters, digits, _ . or -'
            )
        return namespace + local

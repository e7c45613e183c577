"""The ontology that a system shares: read, changed as a whole, and kept."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Self

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import FeatureSignature
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
    """The concepts, instances and features that a system shares.

    A change is made as a whole: it is checked against the upper ontology and stored before the
    method returns, or refused and nothing has changed. Loading an ontology again replaces what was
    loaded of it before and leaves alone what was created at run time.

    Names are short (`Altitude`), prefixed (`uav:Altitude`, with the last part of the ontology's
    IRI) or IRIs; those given back are as short as they are unambiguous.

    Args:
        store: the file that keeps the ontology from one run to the next; none to forget it.

    Raises:
        SemanticsError: if the store cannot be opened.
    """

    def __init__(self, store: str | Path | None = None) -> None:
        with ExitStack() as resources:
            # Even a store to be forgotten is a file: to undo a change is to open it again.
            folder = resources.enter_context(TemporaryDirectory(prefix='dyknow_'))
            self._store = Store(Path(store or Path(folder, 'store')))
            resources.callback(self._store.close)
            self._revision = 0
            self.load(UPPER_ONTOLOGY)
            self._resources = resources.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Lets go of the store."""
        self._resources.close()

    @property
    def revision(self) -> int:
        """How many changes there have been, apart from what a reasoner has added."""
        return self._revision

    @property
    def knowledge(self) -> Knowledge:
        """All that the ontology says at this moment."""
        return self._knowledge

    def load(self, path_or_iri: str | Path) -> None:
        """Adds an ontology, and all that it imports and that is not loaded yet.

        Imports are looked for beside the file that imports them, under the last part of their
        IRI (`uav.owl` for `http://www.dyknow.org/uav`); those of an ontology on the web there too.

        Raises:
            SemanticsError: if something cannot be read or is not as the upper ontology wants it.
        """
        self.add(self.read(path_or_iri))

    def read(self, path_or_iri: str | Path) -> tuple[Document, ...]:
        """What `load` would add.

        Raises:
            SemanticsError: if something cannot be read.
        """
        return read_with_imports(read_source(str(path_or_iri)), self._store.ontologies)

    def add(self, documents: Iterable[Document]) -> None:
        """Adds ontologies, each in place of what it said before.

        Raises:
            SemanticsError: if something is not as the upper ontology wants it.
        """
        self._change(lambda: self._put(documents))
        # owlready2 may have cached what the text says otherwise now.
        self._store.reopen()

    def draft(self, documents: Iterable[Document] = ()) -> Draft:
        """What there would be for a reasoner with some more ontologies; nothing is changed.

        Raises:
            SemanticsError: if something is not as the upper ontology wants it.
        """
        try:
            self._put(documents)
            knowledge = Knowledge(self._store.triples())
            return Draft(self._revision, self._store.text(), knowledge.name)
        finally:
            self._store.reopen()

    def entail(self, entailed: Iterable[Triple], revision: int) -> bool:
        """Adds what a reasoner found in a draft; returns whether it still holds.

        Args:
            entailed: it takes the place of what was entailed before.
            revision: of the ontology when nothing but this is new since the draft.
        """
        if revision != self._revision:
            return False
        self._change(lambda: self._store.put_entailed(entailed))
        self._revision = revision
        self._store.reopen()
        return True

    def create_concept(self, name: str, parents: Iterable[str] = ()) -> tuple[str, ...]:
        """Adds a concept below others. Returns the concepts concerned; none if any may be.

        Raises:
            SemanticsError: if the name is taken, a parent is unknown, or the concept is a feature
                that takes no signature from those above it.
        """
        above = tuple(map(self._knowledge.concept_names.iri, parents))
        iri = self._new_iri(name)
        self._change(lambda: self._store.add_class(iri, above))
        return self._concerned(iri, self.superconcepts(iri))

    def destroy_concept(self, name: str) -> tuple[str, ...]:
        """Removes a concept that nothing rests on. Returns the concepts concerned, as above.

        Raises:
            SemanticsError: if it is unknown, has subconcepts or instances, is the sort of an
                argument, or belongs to the upper ontology.
        """
        iri = self._knowledge.concept_names.iri(name)
        obstacles = '; '.join(self._obstacles(iri))
        if obstacles:
            raise SemanticsError(f"the concept '{name}' cannot be destroyed: {obstacles}")
        concerned = self._concerned(iri, self.superconcepts(iri))
        self._change(lambda: self._store.remove(iri))
        return concerned

    def create_instance(self, name: str, concepts: Iterable[str]) -> tuple[str, ...]:
        """Adds an instance of one or more concepts. Returns the concepts concerned, as above.

        Raises:
            SemanticsError: if the name is taken, a concept is unknown or a feature, or there is
                none.
        """
        kinds = tuple(map(self._sort, concepts))
        if not kinds:
            raise SemanticsError(f"the instance '{name}' needs a concept to be an instance of")
        iri = self._new_iri(name)
        self._change(lambda: self._store.add_individual(iri, kinds))
        return self._concerned(iri, self.concepts(iri))

    def destroy_instance(self, name: str) -> tuple[str, ...]:
        """Removes an instance. Returns the concepts concerned, as above.

        Raises:
            SemanticsError: if it is unknown, or a concept too.
        """
        iri = self._knowledge.instance_names.iri(name)
        if iri in self._knowledge.concept_names:
            raise SemanticsError(f"the instance '{name}' is a concept too; destroy that")
        concerned = self._concerned(iri, self.concepts(iri))
        self._change(lambda: self._store.remove(iri))
        return concerned

    def instances(self, concept: str) -> tuple[str, ...]:
        """See `Knowledge.instances`."""
        return self._knowledge.instances(concept)

    def concepts(self, instance: str) -> tuple[str, ...]:
        """See `Knowledge.concepts`."""
        return self._knowledge.concepts(instance)

    def subconcepts(self, concept: str) -> tuple[str, ...]:
        """See `Knowledge.subconcepts`."""
        return self._knowledge.subconcepts(concept)

    def superconcepts(self, concept: str) -> tuple[str, ...]:
        """See `Knowledge.superconcepts`."""
        return self._knowledge.superconcepts(concept)

    def feature(self, name: str) -> FeatureSignature:
        """See `Knowledge.feature`."""
        return self._knowledge.feature(name)

    def query(self, sparql: str) -> tuple[tuple[str, ...], tuple[Row, ...]]:
        """The variables and the solutions of a SPARQL SELECT query, in the dialect of owlready2.

        Concepts and instances are given back by name and other resources by IRI; a blank node is a
        negative number, an unbound variable empty.

        Raises:
            SemanticsError: if the query is malformed, would change something or does not end.
        """
        return self._store.select(sparql, self._knowledge.name)

    def _put(self, documents: Iterable[Document]) -> None:
        for document in documents:
            self._store.put(document)

    def _change(self, change: Callable[[], None]) -> None:
        """Makes a change and keeps it if what comes of it makes sense."""
        try:
            change()
            knowledge = Knowledge(self._store.triples())
        except Exception:
            self._store.reopen()
            raise
        self._store.commit()
        self._revision += 1
        self._knowledge = knowledge

    def _concerned(self, iri: str, concepts: tuple[str, ...]) -> tuple[str, ...]:
        """Concepts that something belongs to, and the features that take those for arguments."""
        if self._knowledge.name(iri) != split_iri(iri)[1]:
            return ()  # Something else has the same short name: then names are concerned too.
        features = (
            feature.name
            for feature in self._knowledge.features
            if set(concepts) & set(feature.argument_sorts)
        )
        return tuple(sorted({*concepts, *features}))

    def _obstacles(self, iri: str) -> Iterator[str]:
        """What rests on a concept."""
        knowledge = self._knowledge
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
        iri = self._knowledge.concept_names.iri(name)
        if self._knowledge.name(iri) not in self._knowledge.sorts:
            raise SemanticsError(f"the concept '{name}' is a feature; features have no instances")
        return iri

    def _new_iri(self, name: str) -> str:
        """The IRI of what is to be created under a name."""
        knowledge = self._knowledge
        if name in knowledge.concept_names or name in knowledge.instance_names:
            raise SemanticsError(f"there is already a '{name}'", ExitCode.ALREADY_EXISTS)
        namespace, local = split_iri(name) if '/' in name else self._split(name)
        if not re.fullmatch(r'[A-Za-z_][\w.-]*', local):
            raise SemanticsError(
                f"'{name}' is no name; it needs a letter first, then letters, digits, _ . or -"
            )
        return namespace + local

    def _split(self, name: str) -> tuple[str, str]:
        prefix, colon, local = name.rpartition(':')
        if not colon:
            return RUNTIME_ONTOLOGY, local
        return self._knowledge.prefixes.namespace(prefix, self._store.ontologies), local

"""What follows from an ontology, kept in step with it while the node answers others."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from dyknow_common import ExitCode
from dyknow_common.ros import DyKnowNode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.ontology import Ontology
from dyknow_semantics.ontology.reasoner import ReasonerProcess
from dyknow_semantics.ros.worker import Worker


class Inference:
    """Changes an ontology in a thread, and adds what a reasoner finds to follow.

    What is loaded is given to the reasoner first, and refused if it is inconsistent. A small change
    holds at once; what follows from it is added when the reasoner is done with it.

    Args:
        node: the node whose callbacks wait.
        ontology: from now on it is changed by this alone.
        reasoner: none where the order of the concepts is all that is followed.
        report: is told after each change what is wrong, if anything, and which concepts are
            concerned; none if any may be.

    Raises:
        SemanticsError: if the reasoner cannot run.
    """

    def __init__(
        self,
        node: DyKnowNode,
        ontology: Ontology,
        reasoner: ReasonerProcess | None,
        report: Callable[[str, Iterable[str]], None],
    ) -> None:
        self._node = node
        self._ontology = ontology
        self._reasoner = reasoner
        self._report = report
        self._worker = Worker(node, 'ontology')
        self._waiter = Worker(node, 'reasoner')
        self._is_reasoning = False
        self._fault = ''
        self._begin()

    def close(self) -> None:
        """Ends the reasoner, and waits until the ontology is left alone."""
        if self._reasoner is not None:
            self._reasoner.stop()
        self._waiter.close()
        self._worker.close()

    async def load(self, path_or_iri: str) -> None:
        """Loads an ontology, if what it says is consistent with all else.

        Raises:
            SemanticsError: if it cannot be read, or is refused.
        """
        documents = await self._worker.run(self._ontology.read, path_or_iri)
        if self._reasoner is None:
            await self._worker.run(self._ontology.add, documents)
            self._report('', ())
            return
        draft = await self._worker.run(self._ontology.draft, documents)
        entailed = await self._waiter.run(self._reasoner.entailed, draft)
        await self._worker.run(self._ontology.add, documents)
        if await self._worker.run(self._ontology.entail, entailed, draft.revision + 1):
            self._fault = ''
        else:
            self._follow()
        self._report(self._fault, ())

    async def change(self, change: Callable[..., Iterable[str]], *arguments: object) -> None:
        """Makes a small change, which returns the concepts that are concerned."""
        concerned = await self._worker.run(change, *arguments)
        self._report(self._fault, concerned)
        self._follow()

    async def query(self, sparql: str) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
        """See `Ontology.query`."""
        return await self._worker.run(self._ontology.query, sparql)

    def _begin(self) -> None:
        if self._reasoner is None:
            # Another run may have had a reasoner.
            self._ontology.entail((), self._ontology.revision)
        else:
            draft = self._ontology.draft()
            try:
                self._ontology.entail(self._reasoner.entailed(draft), draft.revision)
            except SemanticsError as error:
                if error.code is not ExitCode.INVALID_ARGUMENT:
                    raise
                self._fault = error.message
        self._report(self._fault, ())

    def _follow(self) -> None:
        if self._reasoner is not None and not self._is_reasoning:
            self._is_reasoning = True
            self._node.spawn(self._reason, self._reasoner)

    async def _reason(self, reasoner: ReasonerProcess) -> None:
        try:
            while not await self._keeps_up(reasoner):
                pass
        finally:
            self._is_reasoning = False

    async def _keeps_up(self, reasoner: ReasonerProcess) -> bool:
        """Reasons once; returns whether the ontology has not changed meanwhile."""
        draft = await self._worker.run(self._ontology.draft)
        fault = ''
        try:
            entailed = await self._waiter.run(reasoner.entailed, draft)
            await self._worker.run(self._ontology.entail, entailed, draft.revision)
        except SemanticsError as error:
            fault = error.message
        if draft.revision != self._ontology.revision:
            return False
        self._fault = fault
        self._report(fault, ())
        return True

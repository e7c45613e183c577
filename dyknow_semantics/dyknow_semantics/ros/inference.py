"""Changes of an ontology while a reasoner runs, and the threads for long work.

A reasoner takes seconds to minutes. Meanwhile the node answers requests, also changes. Example:

    0 s   create `x`: stored and answered (revision 5); the reasoner starts with revision 5
    1 s   create `y`: stored and answered (revision 6)
    8 s   the reasoner finishes; revision 5 is outdated: its result is dropped, and it starts again
    16 s  the reasoner finishes; revision 6 is the present one: the entailed statements are stored

An ontology that is loaded is different: the reasoner checks a draft first, and the request is
answered when the ontology is stored or refused.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from dyknow_common import ExitCode
from dyknow_common.ros import Background, DyKnowNode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.documents import Document
from dyknow_semantics.ontology.ontology import Ontology
from dyknow_semantics.ontology.reasoner import ReasonerProcess

Result = TypeVar('Result')

STOP_LIMIT_S: Final = 0.5
"""The longest wait for a running function when a node stops."""


class Worker:
    """Threads that run functions in their order, while the node serves other requests.

    Args:
        node: the node.
        name: the name of the threads.
        threads: their number.
        max_waiting: the number of functions that may wait for a thread; `None` for any.
    """

    def __init__(
        self, node: DyKnowNode, name: str, threads: int = 1, max_waiting: int | None = None
    ) -> None:
        self._name = name
        self._unfinished = 0
        self._limit = None if max_waiting is None else threads + max_waiting
        self._background = Background(node, threads, name)

    def close(self) -> bool:
        """Cancel the waiting functions; return True if the running ones end within a short time."""
        return self._background.close(STOP_LIMIT_S)

    async def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Run a function in a thread; return its result or raise its error.

        Raises:
            SemanticsError: UNAVAILABLE, if too many functions wait.
        """
        if self._limit is not None and self._unfinished >= self._limit:
            raise SemanticsError(
                f'{self._unfinished} {self._name} are running or waiting already; try again later',
                ExitCode.UNAVAILABLE,
            )
        self._unfinished += 1
        try:
            return await self._background.run(partial(function, *arguments))
        finally:
            self._unfinished -= 1


class Inference:
    """Changes an ontology in a thread, and adds the statements that a reasoner derives.

    Args:
        node: the node whose callbacks wait.
        ontology: must not be changed by others.
        reasoner: `None` if only the order of concepts is followed.
        report: called after each change with the fault of the ontology, or '', and the affected
            concepts (empty: any concept).

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
        self._ontology_thread = Worker(node, 'ontology')
        self._reasoner_thread = Worker(node, 'reasoner')
        self._is_reasoning = False
        self._fault = ''
        if reasoner is None:
            # The store may hold statements that were entailed before a restart.
            ontology.set_entailed((), ontology.revision)
        else:
            draft = ontology.draft()
            try:
                ontology.set_entailed(reasoner.infer(draft), draft.revision)
            except SemanticsError as error:
                if error.code is not ExitCode.INVALID_ARGUMENT:
                    raise
                self._fault = error.message
        report(self._fault, ())

    def close(self) -> bool:
        """Stop the reasoner; return True if the running change ends within a short time."""
        if self._reasoner is not None:
            self._reasoner.stop()
        self._reasoner_thread.close()
        return self._ontology_thread.close()

    async def load(self, reading: Awaitable[tuple[Document, ...]]) -> None:
        """Load documents that are being read, if they are consistent with the others.

        Raises:
            SemanticsError: if they cannot be read, or are inconsistent.
        """
        documents = await reading
        if self._reasoner is None:
            await self._ontology_thread.run(self._ontology.add, documents)
        else:
            draft = await self._ontology_thread.run(self._ontology.draft, documents)
            entailed = await self._reasoner_thread.run(self._reasoner.infer, draft)
            await self._ontology_thread.run(self._ontology.add, documents)
            if await self._ontology_thread.run(
                self._ontology.set_entailed, entailed, draft.revision + 1
            ):
                self._fault = ''
            else:
                self._start_reasoning()
        self._report(self._fault, ())

    async def change(self, change: Callable[..., Iterable[str]], *arguments: object) -> None:
        """Call a method that makes a small change and returns the affected concepts."""
        affected = await self._ontology_thread.run(change, *arguments)
        self._report(self._fault, affected)
        self._start_reasoning()

    async def copy(self) -> Path:
        """Return a file with a copy of the ontology, which the caller removes."""
        return await self._ontology_thread.run(self._ontology.write_copy)

    def _start_reasoning(self) -> None:
        if self._reasoner is not None and not self._is_reasoning:
            self._is_reasoning = True
            self._node.spawn(self._reason, self._reasoner)

    async def _reason(self, reasoner: ReasonerProcess) -> None:
        """Run the reasoner until its result is about the present ontology."""
        try:
            while True:
                draft = await self._ontology_thread.run(self._ontology.draft)
                fault = ''
                try:
                    entailed = await self._reasoner_thread.run(reasoner.infer, draft)
                    await self._ontology_thread.run(
                        self._ontology.set_entailed, entailed, draft.revision
                    )
                except SemanticsError as error:
                    fault = error.message
                if draft.revision == self._ontology.revision:
                    break
            self._fault = fault
            self._report(fault, ())
        finally:
            self._is_reasoning = False

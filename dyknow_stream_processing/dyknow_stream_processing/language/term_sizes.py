"""The size of resolved streams, which is bounded.

A resolved stream contains the streams that it is made of, each as often as it refers to them. So
its size may double with each declaration, and the number of its samples, too:
`stream b = merge(a, a); stream c = merge(b, b); ...`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Final

from dyknow_common import (
    MAX_DEPTH,
    MAX_STREAM_PARTS,
    SECOND_NS,
    StreamConstraints,
    round_duration,
)
from dyknow_stream_processing.language.sinks import made
from dyknow_stream_processing.language.specification import (
    Merge,
    Select,
    Specification,
    StreamDeclaration,
    StreamReference,
    Sync,
    Term,
)

MAX_PARTS: Final = 20_000
"""The number of parts of one stream, with all streams that it is made of."""

MAX_INPUTS: Final = 1000
"""The number of inputs of a merge, a sync or a computational unit."""

MAX_COPIES: Final = 100
"""The number of samples of a stream that merges make of one sample of a topic."""

MAX_FIELDS: Final = 10_000
"""The number of fields of a stream."""

MAX_TICK_RATE: Final = 10_000
"""The number of samples of a sync with a `sample_period`, per second."""

MAX_VALUE_RATE: Final = 100_000
"""The number of values of all inputs in these samples."""


@dataclass(frozen=True, slots=True)
class _Extent:
    """The size of a term: its terms, the most inputs of one, and the samples for each origin.

    `expires` is True if values of one of its terms expire.
    """

    term: Term
    depth: int
    parts: int
    inputs: int
    copies: Mapping[Hashable, int]
    expires: bool


def check_rates(specification: Specification, constraints: StreamConstraints) -> None:
    """Check how many samples the synchronisations with a `sample_period` make.

    Args:
        specification: the specification of a stream.
        constraints: the constraints of the stream; they apply to the last of its operators.

    Raises:
        DyKnowError: for constraints that no stream can keep.
        LanguageError: for too many samples or values per second, with the position.
    """
    constraints.validate()
    last = made(specification)
    declared = {each.name: each.stream for each in specification.declared(StreamDeclaration)}
    waiting = [last, *declared.values()]
    while isinstance(last, StreamReference) and last.name in declared:
        last = declared.pop(last.name)
    while waiting:
        term = waiting.pop()
        waiting += term.inputs
        period = term.constraints.sample_period
        if term is last:
            period = period or constraints.sample_period
        if isinstance(term, Sync) and period is not None:
            _check_rate(specification, term, period)


def _check_rate(specification: Specification, sync: Sync, period: int) -> None:
    count = len(sync.inputs)
    if max(count, MAX_VALUE_RATE // MAX_TICK_RATE) * SECOND_NS > MAX_VALUE_RATE * period:
        raise specification.error(
            f'a sync of {count} inputs each {round_duration(period)} is too fast: the limits are '
            f'{MAX_TICK_RATE} samples and {MAX_VALUE_RATE} values of inputs per second; use a '
            'longer sample_period',
            sync.position,
        )


class TermSizes:
    """Counts the parts of resolved streams; a part that several share is visited once."""

    def __init__(self) -> None:
        self._total = 0
        # The terms are kept, so that their identities stay theirs.
        self._known: dict[int, _Extent] = {}

    def excess(self, term: Term) -> str:
        """Add a resolved stream, and return what is too large; empty if nothing is."""
        extent = self._extent(term)
        self._total += extent.parts
        if extent.depth > MAX_DEPTH:
            return f'it is made through more than {MAX_DEPTH} streams, one from the other'
        if max(extent.copies.values()) > MAX_COPIES:
            return f'its merges repeat each sample of a stream more than {MAX_COPIES} times'
        if extent.inputs > MAX_INPUTS:
            return f'a merge, sync or unit has {extent.inputs} inputs, more than {MAX_INPUTS}'
        if extent.parts > MAX_PARTS:
            return f'it has more than {MAX_PARTS} parts, with all streams that it is made of'
        if self._total > MAX_STREAM_PARTS:
            return f'the streams that it is made of have more than {MAX_STREAM_PARTS} parts'
        return ''

    def expires(self, term: Term) -> bool:
        """Return True if values expire in a resolved stream, or in one that it is made of."""
        return self._extent(term).expires

    def _extent(self, term: Term) -> _Extent:
        if id(term) not in self._known:
            extents = [self._extent(each) for each in term.inputs]
            depth = 1 + max((each.depth for each in extents), default=0)
            parts = 1 + sum(each.parts for each in extents)
            inputs = max([len(extents), *(each.inputs for each in extents)])
            copies: Mapping[Hashable, int] = {id(term): 1}
            match term:
                case StreamReference():
                    copies = {term.name: 1}
                case Select():
                    copies = extents[0].copies
                case Merge():
                    counter: Counter[Hashable] = Counter()
                    for each in extents:
                        counter.update(each.copies)
                    copies = counter
                # A sync and a unit emit once for each valid time.
            expires = bool(term.constraints.expires) or any(each.expires for each in extents)
            self._known[id(term)] = _Extent(term, depth, parts, inputs, copies, expires)
        return self._known[id(term)]

"""RCC-8: eight exclusive relations between two regions, and their composition.

Sets of relations are flags: TPP | NTPP is "one of both". Definitions as in
D. Randell, Z. Cui, A. Cohn, "A spatial logic based on regions and connection" (KR 1992).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import IntFlag
from functools import cache, lru_cache
from typing import Final


class RegionRelation(IntFlag):
    """A relation of a region to another one, or a set of relations, one of them true."""

    DC = 1
    """They have no point in common."""
    EC = 2
    """They touch: their boundaries have a point in common, their insides none."""
    PO = 4
    """The regions overlap, and neither is a part of the other."""
    TPP = 8
    """The first is a part of the second, and touches its boundary."""
    NTPP = 16
    """The first is a part of the second, and does not touch its boundary."""
    TPPI = 32
    """The second is a TPP of the first."""
    NTPPI = 64
    """The second is an NTPP of the first."""
    EQ = 128
    """They are equal."""

    def __str__(self) -> str:
        named = [name for name, each in RELATION_NAMES.items() if each == self]
        return named[0] if named else f'{{{", ".join(str(each.name) for each in bases(self))}}}'


ANY: Final = RegionRelation(255)
"""Nothing is known."""

RELATION_NAMES: Final[Mapping[str, RegionRelation]] = {
    **{str(each.name): each for each in RegionRelation},
    'part_of': RegionRelation.TPP | RegionRelation.NTPP | RegionRelation.EQ,
    'touches': RegionRelation.EC,
    'overlaps': ANY & ~(RegionRelation.DC | RegionRelation.EC),
    'apart': RegionRelation.DC,
}
"""Relations by their names in statements."""

_CONVERSES: Final = {
    RegionRelation.TPP: RegionRelation.TPPI,
    RegionRelation.NTPP: RegionRelation.NTPPI,
    RegionRelation.TPPI: RegionRelation.TPP,
    RegionRelation.NTPPI: RegionRelation.NTPP,
}
"""The converse of each relation that is not symmetric."""

# Rows are relations of a to b, columns are relations of b to c, in the order of the flags. An entry
# has the possible relations of a to c; `*` are all, `<` DC EC PO TPP NTPP, `>` DC EC PO TPPI NTPPI.
_TABLE: Final = """
DC    | * | < | < | < | < | DC | DC | DC
EC    | > | DC EC PO TPP TPPI EQ | < | EC PO TPP NTPP | PO TPP NTPP | DC EC | DC | EC
PO    | > | > | * | PO TPP NTPP | PO TPP NTPP | > | > | PO
TPP   | DC | DC EC | < | TPP NTPP | NTPP | DC EC PO TPP TPPI EQ | > | TPP
NTPP  | DC | DC | < | NTPP | NTPP | < | * | NTPP
TPPI  | > | EC PO TPPI NTPPI | PO TPPI NTPPI | PO TPP TPPI EQ | PO TPP NTPP | TPPI NTPPI | NTPPI | TPPI
NTPPI | > | PO TPPI NTPPI | PO TPPI NTPPI | PO TPPI NTPPI | PO TPP NTPP TPPI NTPPI EQ | NTPPI | NTPPI | NTPPI
EQ    | DC | EC | PO | TPP | NTPP | TPPI | NTPPI | EQ
"""  # noqa: E501 - a table
_SHORT: Final = {
    '*': ' '.join(RegionRelation.__members__),
    '<': 'DC EC PO TPP NTPP',
    '>': 'DC EC PO TPPI NTPPI',
}


def bases(relation: RegionRelation) -> Iterator[RegionRelation]:
    """Yield the single relations of a set."""
    return (each for each in RegionRelation if each & relation)


@cache
def converse(relation: RegionRelation) -> RegionRelation:
    """Return the relation of the second region to the first."""
    return RegionRelation(sum(_CONVERSES.get(each, each) for each in bases(relation)))


def _entries() -> Iterator[tuple[tuple[RegionRelation, RegionRelation], RegionRelation]]:
    for row in _TABLE.strip().splitlines():
        first, *cells = (each.strip() for each in row.split('|'))
        for second, cell in zip(RegionRelation, cells, strict=True):
            found = sum(RegionRelation[name] for name in _SHORT.get(cell, cell).split())
            yield (RegionRelation[first], second), RegionRelation(found)


_COMPOSITIONS: Final = dict(_entries())


@lru_cache(1 << 16)
def compose(first: RegionRelation, second: RegionRelation) -> RegionRelation:
    """Return what a may be to c, given what a is to b and b is to c."""
    found = 0
    for one in bases(first):
        for other in bases(second):
            found |= _COMPOSITIONS[one, other]
    return RegionRelation(found)

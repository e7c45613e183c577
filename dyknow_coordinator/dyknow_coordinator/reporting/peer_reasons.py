"""Explanations of verdicts that peers have reached, in their words.

    "/dyknow/federation/c1/_verdict_5f_1".value = "false: Charge[c1] = 0.05 at 3 s is not > 0.2"
    at 4.000 s starts with "false"

The fact is that a text has come. Its reader wants what it says:

    Charge[c1] = 0.05 at 3 s is not > 0.2
"""

from __future__ import annotations

import re
from typing import Final

PEER_VERDICT: Final = '_verdict_'
"""The first part of the names of streams of verdicts; see `dyknow_federation.push_down`."""

_TEXT: Final = r'"(?:[^"\\]|\\.)*"'
_FACT: Final = (
    rf'"[^"]*/{PEER_VERDICT}\w+"\.value = "(?:true|false): (?:[^"\\]|\\.)*" at \S+ s '
    rf'(?:is not|is equal to|starts with|does not start with) {_TEXT}'
)
_FACTS: Final = re.compile(rf'(; )?({_FACT}(?: and {_FACT})*)(?: \([^()]*\))?', re.DOTALL)
_REASON: Final = re.compile(r'"\.value = "(?:true|false): ((?:[^"\\]|\\.)*)"', re.DOTALL)


def with_reasons_of_peers(explanation: str) -> str:
    """Return an explanation in which each verdict of a peer is its reason, once."""
    known: set[str] = set()

    def reasons(facts: re.Match[str]) -> str:
        found = dict.fromkeys(_REASON.findall(facts[2]))
        new = [re.sub(r'\\(["\\])', r'\1', each) for each in found if each not in known]
        known.update(found)
        return (facts[1] or '') + '; '.join(new) if new else ''

    return _FACTS.sub(reasons, explanation)

"""Draw the pictures of docs/operators_in_pictures.md; their verdicts are computed, not written.

Each picture shows a formula at one state (now), the window that its operator looks at, and two
traces: one from which it is true, and one from which it is false. A dot is a state; it is filled
where the atom is true. The ring is around the state that decides the formula.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

from dyknow_common import SECOND_NS
from dyknow_reasoning import FormulaGroup

FOLDER = Path(__file__).parent.parent / 'docs' / 'images' / 'operators'

STATES = 8
LEFT, STEP, TOP, ROW, WIDTH = 34, 36, 58, 24, 420

STYLE = """\
<style>
svg { color: #24292f; font: 13px sans-serif } text { fill: currentColor }
.code { font-family: monospace } .now { stroke: currentColor; stroke-dasharray: 3 3 }
.window { fill: #4c6ef5; fill-opacity: .2 } .dot { stroke: currentColor; stroke-width: 1.5 }
.true { fill: currentColor } .false { fill: none }
.ring { fill: none; stroke: #e8590c; stroke-width: 2 }
@media (prefers-color-scheme: dark) { svg { color: #e6edf3 } .window { fill-opacity: .4 } }
</style>"""


@dataclass(frozen=True)
class Picture:
    """A formula at a state, and its traces: for each atom, a digit for each state.

    Args:
        formula: over the atoms p and q.
        now: the number of the state, which is also its time in seconds.
        window: its first and last second.
        traces: from which the formula is true and false.
    """

    formula: str
    now: int
    window: tuple[int, int]
    traces: tuple[dict[str, str], dict[str, str]]


PICTURES = {
    'always': Picture('always[1 s, 4 s] p', 1, (2, 5), ({'p': '00111100'}, {'p': '11110111'})),
    'eventually': Picture(
        'eventually[1 s, 4 s] p', 1, (2, 5), ({'p': '11001000'}, {'p': '11000011'})
    ),
    'until': Picture(
        'p until[1 s, 4 s] q',
        1,
        (2, 5),
        ({'p': '00111000', 'q': '00000100'}, {'p': '00110110', 'q': '00000100'}),
    ),
    'holds_until': Picture(
        'p holds until[1 s, 4 s] q',
        1,
        (2, 5),
        ({'p': '01111000', 'q': '00000100'}, {'p': '00111000', 'q': '00000100'}),
    ),
    'unless': Picture(
        'p unless[0 s, 4 s] q',
        1,
        (1, 5),
        ({'p': '01111100', 'q': '00000000'}, {'p': '01110111', 'q': '00000011'}),
    ),
    'release': Picture(
        'p release[0 s, 4 s] q',
        1,
        (1, 5),
        ({'p': '00010000', 'q': '01110000'}, {'p': '00001000', 'q': '01100111'}),
    ),
    'once': Picture('once[1 s, 4 s] p', 6, (2, 5), ({'p': '00010000'}, {'p': '11000011'})),
    'historically': Picture(
        'historically[1 s, 4 s] p', 6, (2, 5), ({'p': '00111100'}, {'p': '11101111'})
    ),
    'since': Picture(
        'p since[1 s, 4 s] q',
        6,
        (2, 5),
        ({'p': '00001100', 'q': '00010000'}, {'p': '00001000', 'q': '00010000'}),
    ),
    'previous': Picture('previous p', 6, (5, 5), ({'p': '00000100'}, {'p': '11111011'})),
}


def main():
    """Write all pictures; with --check, return 1 if one is out of date."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    outdated = []
    for name, picture in PICTURES.items():
        path, text = FOLDER / f'{name}.svg', drawn(picture)
        if not path.exists() or path.read_text(encoding='utf-8') != text:
            outdated.append(name)
        if '--check' not in sys.argv:
            path.write_text(text, encoding='utf-8')
    if outdated and '--check' in sys.argv:
        print(f'run python tools/make_pictures.py: {", ".join(outdated)} out of date')
        return 1
    return 0


def decided(picture, trace):
    """Return the verdict at the state of the picture, and the second at which it is known."""
    group = FormulaGroup()
    now = f'{picture.now} s'
    # A window of one state moves the formula there; the past begins with the first state.
    group.add_formula('picture', f'eventually[{now}, {now}] ({picture.formula})')
    group.begin({})
    for second in range(STATES):
        state = {atom: digits[second] == '1' for atom, digits in trace.items()}
        for result in group.progress(second * SECOND_NS, state):
            return result.verdict.name.lower(), result.decided_at // SECOND_NS
    raise AssertionError(f'{picture.formula} is not decided')


def drawn(picture):
    """Return a picture in SVG."""
    rows = [row for number in range(2) for row in _trace(picture, number)]
    bottom = TOP + 2 * (len(picture.traces[0]) * ROW + 12)
    first, last = picture.window
    parts = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{bottom + 28}"'
            f' viewBox="0 0 {WIDTH} {bottom + 28}" role="img">'
        ),
        f'<title>{picture.formula}</title>',
        STYLE,
        f'<text class="code" x="{LEFT - 26}" y="18" font-weight="bold">{picture.formula}</text>',
        (
            f'<rect class="window" x="{_x(first) - 12}" y="{TOP - 16}" rx="4"'
            f' width="{_x(last) - _x(first) + 24}" height="{bottom - TOP + 8}"/>'
        ),
        (
            f'<line class="now" x1="{_x(picture.now)}" x2="{_x(picture.now)}" y1="{TOP - 16}"'
            f' y2="{bottom - 6}"/>'
        ),
        f'<text x="{_x(picture.now)}" y="{TOP - 22}" text-anchor="middle">now</text>',
        *rows,
        *(
            f'<text x="{_x(second)}" y="{bottom + 14}" text-anchor="middle">{second} s</text>'
            for second in range(STATES)
        ),
        '</svg>',
    ]
    return '\n'.join(parts) + '\n'


def _trace(picture, number):
    trace = picture.traces[number]
    verdict, known = decided(picture, trace)
    if verdict != ('true', 'false')[number]:
        raise AssertionError(f'{picture.formula}: trace {number} is {verdict}')
    top = TOP + number * (len(trace) * ROW + 12)
    for row, (atom, digits) in enumerate(trace.items()):
        y = top + row * ROW
        yield f'<text class="code" x="{LEFT - 26}" y="{y + 4}">{atom}</text>'
        for second, digit in enumerate(digits):
            kind = 'true' if digit == '1' else 'false'
            yield f'<circle class="dot {kind}" cx="{_x(second)}" cy="{y}" r="5"/>'
        yield f'<circle class="ring" cx="{_x(known)}" cy="{y}" r="9"/>'
    y = top + (len(trace) - 1) * ROW / 2 + 4
    yield f'<text x="{_x(STATES) - 8}" y="{y:g}">{verdict}, at {known} s</text>'


def _x(second):
    return LEFT + 4 + second * STEP


if __name__ == '__main__':
    sys.exit(main())

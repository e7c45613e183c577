"""Draw a sequence diagram of Mermaid as SVG, as its own program would come from the network."""

import html
import re

TIP = """\
<defs><marker id="tip" orient="auto" markerWidth="8" markerHeight="8" refX="7" refY="4">
<path d="M0,0 L8,4 L0,8 Z" fill="currentColor"/></marker></defs>"""

STEP, ROW, LEFT = 150, 34, 70

_PARTICIPANT = re.compile(r'participant (\w+) as (.+)')
_MESSAGE = re.compile(r'(\w+)(-?->>)(\w+): (.+)')
_NOTE = re.compile(r'Note over (\w+): (.+)')


def drawn(text):
    """Return a diagram, given its text: participants, messages and notes."""
    participants, rows = {}, []
    for line in filter(None, map(str.strip, text.splitlines()[1:])):
        if found := _PARTICIPANT.fullmatch(line):
            participants[found[1]] = (LEFT + len(participants) * STEP, found[2])
        elif found := _MESSAGE.fullmatch(line):
            ends = participants[found[1]][0], participants[found[3]][0]
            rows.append(_message(ends, found[2] == '-->>', found[4], len(rows)))
        elif found := _NOTE.fullmatch(line):
            rows.append(_note(participants[found[1]][0], found[2], len(rows)))
        else:
            raise ValueError(f'not drawn: {line}')
    height = 50 + ROW * len(rows)
    lines = (_lifeline(x, name, height) for x, name in participants.values())
    width = 2 * LEFT + (len(participants) - 1) * STEP
    return '\n'.join(
        (
            f'<svg class="sequence" viewBox="0 0 {width} {height}" role="img">',
            TIP,
            *lines,
            *rows,
            '</svg>',
        )
    )


def _lifeline(x, name, height):
    return (
        f'<text x="{x}" y="18" font-weight="bold">{html.escape(name)}</text>'
        f'<line x1="{x}" x2="{x}" y1="28" y2="{height}" stroke-opacity=".4"/>'
    )


def _message(ends, is_reply, text, row):
    first, last = ends
    y = 60 + ROW * row
    dashes = ' stroke-dasharray="5 4"' if is_reply else ''
    return (
        f'<line x1="{first}" x2="{last}" y1="{y}" y2="{y}" marker-end="url(#tip)"{dashes}/>'
        f'<text x="{(first + last) / 2:g}" y="{y - 6}">{html.escape(text)}</text>'
    )


def _note(x, text, row):
    return f'<text x="{x}" y="{56 + ROW * row}" font-style="italic">{html.escape(text)}</text>'

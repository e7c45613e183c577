"""The verb `parse`: check a formula, a stream or an annotation, and print its canonical form."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Final

from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import warn_of_notes
from dyknow_reasoning import check_types, parse_formula
from dyknow_semantics import parse_annotations
from dyknow_stream_processing import parse_specification


def formula_text(text: str) -> str:
    """Return a formula with all brackets and units; print the notes on it as warnings."""
    formula = parse_formula(text)
    check_types(formula, text)
    warn_of_notes([text])
    return str(formula)


LANGUAGES: Final[Mapping[str, Callable[[str], str]]] = {
    'formula': formula_text,
    'stream': lambda text: str(parse_specification(text)),
    'annotation': lambda text: '\n'.join(map(str, parse_annotations(text))),
}


def parse(options: argparse.Namespace) -> int:
    """Print the canonical form of a text; return the exit code."""
    print(LANGUAGES[options.language](options.text))  # noqa: T201 - this is a command
    return SUCCESS


def add_parse_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=parse)
    describe(
        parser,
        'Check the syntax of a text and print its canonical form. Nothing has to run.',
        (
            "dyknow parse 'always Power[uav1] < 150 until[0, 5 s] InAir(uav1)'",
            """dyknow parse --language stream 'select ranges[0] as ahead from "/scan"'""",
        ),
        '0 if the syntax is correct, 2 if it is not',
    )
    parser.add_argument('text', help='a formula, or a text in another language')
    parser.add_argument(
        '--language', choices=LANGUAGES, default='formula', help='(default: formula)'
    )

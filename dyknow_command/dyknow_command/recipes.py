"""The verb `recipes`: search formulas for many robots, and add them to a robot.yaml."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from textwrap import wrap

from dyknow_common import DyKnowError, ExitCode, format_duration, read_text, replace_text, unknown
from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import (
    ConfigurationError,
    Recipe,
    RobotPart,
    add_recipe,
    read_recipes,
    write_errors,
)


def recipes(options: argparse.Namespace) -> int:
    """List, show or add recipes, and return the exit code."""
    known = read_recipes()
    are_names = bool(options.words) and all(each in known for each in options.words)
    if options.add is not None:
        if not options.words:
            raise DyKnowError('--add needs the name of a recipe; "dyknow recipes" lists all')
        for each in options.words:
            if each not in known:
                raise DyKnowError(unknown('recipe', each, known), ExitCode.NOT_FOUND)
        return _add(options, [known[each] for each in options.words])
    if options.rename:
        raise DyKnowError('--rename needs --add FILE')
    words = [each.lower() for each in options.words]
    found = [known[each] for each in options.words] if are_names else list(known.values())
    if not are_names:
        found = [each for each in found if all(word in _searched(each) for word in words)]
    if not found:
        text = f'no recipe has {" and ".join(words)}; "dyknow recipes" lists all'
        raise DyKnowError(text, ExitCode.NOT_FOUND)
    if options.json:
        print('\n'.join(json.dumps(_document(each)) for each in found))  # noqa: T201 - a command
    elif are_names:
        print('\n'.join(line for each in found for line in _shown(each)))  # noqa: T201
    else:
        _print_list(found)
    return SUCCESS


def add_recipes_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=recipes)
    describe(
        parser,
        'Search formulas that many robots must keep. Without words, list all; with words, those '
        'that contain all of them. With the names of recipes, show these as a robot.yaml, whose '
        'comments name the problem, its source, the topics and traces, or add them to one, which '
        'keeps its comments. Nothing has to run.',
        (
            'dyknow recipes',
            'dyknow recipes px4 land',
            'dyknow recipes speed_limit',
            'dyknow recipes speed_limit tilt --add robot.yaml',
            'dyknow recipes speed_limit --add robot.yaml --rename Robot=Rover',
        ),
        '0 if recipes were found or added, 2 if there is none, or for another error',
    )
    parser.add_argument('words', nargs='*', metavar='WORD', help='words, or names of recipes')
    parser.add_argument(
        '--add', type=Path, metavar='FILE', help='add to this robot.yaml, which is made if needed'
    )
    parser.add_argument(
        '--rename',
        action='append',
        default=[],
        metavar='OLD=NEW',
        help='add under other names: of sorts, objects, features, constants, formulas',
    )
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each recipe')


def _add(options: argparse.Namespace, chosen: Iterable[Recipe]) -> int:
    """Add recipes to a file, all or none, and print what the user may have to change."""
    path: Path = options.add
    names = dict(each.partition('=')[::2] for each in options.rename)
    text = read_text(path, 'configuration', ConfigurationError) if path.exists() else ''
    report: list[str] = []
    # The first recipe with a sort gives its objects, so the recipe with the most objects is first.
    renamed = (each.renamed(names) for each in chosen)
    for recipe in sorted(renamed, key=_most_objects, reverse=True):
        result = add_recipe(path, text, recipe)
        text = result.text
        report.append(f'{path}: added {_named(result.added)}')
        report += [f'kept as in the file: {_named(result.kept)}'] if result.kept else []
        differing = [*_differing(recipe, result.added)]
        report += ['change what differs on your robot:', *differing] if differing else []
    with write_errors(path):
        replace_text(path, text)
    print('\n'.join([*report, f'next: dyknow lint {path} --live']))  # noqa: T201
    return SUCCESS


def _most_objects(recipe: Recipe) -> int:
    listed = (each.plain.values() for each in recipe.parts if each.section == 'objects')
    return max((len(objects) for values in listed for objects in values), default=0)


def _named(parts: Iterable[RobotPart]) -> str:
    names: dict[str, list[str]] = {}
    for each in parts:
        names.setdefault(each.section, []).append(each.name.rstrip('('))
    return '; '.join(f'{section} {", ".join(found)}' for section, found in names.items())


def _differing(recipe: Recipe, parts: Iterable[RobotPart]) -> Iterator[str]:
    """Yield the objects, constants and topics in some parts, a line each."""
    found = list(parts)
    for each in found:
        if each.section in {'objects', 'constants'}:
            yield f'  {each.text}'
    for topic, type_ in recipe.topics.items():
        if any(topic in each.text for each in found):
            yield f'  {topic} ({type_})'


def _print_list(found: Iterable[Recipe]) -> None:
    # They are slow to import.
    from dyknow_common.tables import ReportTable, Terminal, fixed, folded  # noqa: PLC0415

    rows = [(each.name, each.area, each.description) for each in found]
    columns = (fixed('recipe'), fixed('for'), folded('what it says'))
    Terminal(highlight=False).print(ReportTable(columns, rows))


def _shown(recipe: Recipe) -> Iterator[str]:
    """Yield the lines of a recipe as a robot.yaml with comments, also for its traces."""
    topics = [f'Topic: {topic} ({type_})' for topic, type_ in recipe.topics.items()]
    yield f'# {recipe.name}, for {recipe.area} robots'
    for text in (recipe.problem, f'Source: {recipe.source}', recipe.url, recipe.note, *topics):
        yield from wrap(
            text, 78, initial_indent='# ', subsequent_indent='#   ', break_on_hyphens=False
        )
    yield recipe.robot.rstrip()
    at = format_duration(recipe.violated_at)
    for title, trace in (
        ('It holds for this trace:', recipe.satisfied),
        (f'It is false at {at} of this one:', recipe.violated),
    ):
        yield from (f'# {title}', *(f'#   {line}' for line in trace.splitlines()))


def _searched(recipe: Recipe) -> str:
    return '\n'.join(map(str, _document(recipe).values())).lower()


def _document(recipe: Recipe) -> Mapping[str, object]:
    found = asdict(recipe)
    del found['parts']
    return {**found, 'violated_at_ns': found.pop('violated_at'), 'robot': recipe.robot}

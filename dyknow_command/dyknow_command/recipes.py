"""The verb `recipes`: search formulas for many robots, and add them to a robot.yaml."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

from dyknow_common import DyKnowError, ExitCode, format_duration, read_text, replace_text, unknown
from dyknow_common.executables import SUCCESS, describe
from dyknow_configuration import (
    AddedRecipe,
    ConfigurationError,
    Recipe,
    RobotPart,
    add_recipe,
    read_recipes,
)

_KINDS: Final = {
    'objects': 'sort',
    'constants': 'constant',
    'features': 'feature',
    'streams': 'stream',
    'formulas': 'formula',
}


def recipes(options: argparse.Namespace) -> int:
    """List, show or add recipes, and return the exit code."""
    known = read_recipes()
    are_names = bool(options.words) and all(each in known for each in options.words)
    if options.add is not None:
        return _add(options, known)
    if options.rename:
        raise DyKnowError('--rename needs --add FILE')
    found = [known[each] for each in options.words] if are_names else _search(options.words, known)
    if options.json:
        print('\n'.join(json.dumps(_document(each)) for each in found))  # noqa: T201 - a command
    elif are_names:
        print('\n\n'.join(map(_shown, found)))  # noqa: T201
    else:
        _print_list(found)
    return SUCCESS


def add_recipes_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=recipes)
    describe(
        parser,
        'Search formulas that many robots must keep, each with its features, topics, source and '
        'traces. Without words, list all; with words, those that contain all of them; with the '
        'names of recipes, show these in full, or add them to a robot.yaml, which keeps its '
        'comments. Nothing has to run.',
        (
            'dyknow recipes',
            'dyknow recipes battery',
            'dyknow recipes px4 land',
            'dyknow recipes speed_limit',
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
        help='add under other names: of sorts, objects, features, constants, the formula',
    )
    parser.add_argument('--json', action='store_true', help='print a line of JSON for each recipe')


def _add(options: argparse.Namespace, known: Mapping[str, Recipe]) -> int:
    path: Path = options.add
    names = _names(options.rename)
    if not options.words:
        raise DyKnowError('--add needs the name of a recipe; "dyknow recipes" lists them')
    for each in options.words:
        if each not in known:
            raise DyKnowError(unknown('recipe', each, known), ExitCode.NOT_FOUND)
    text = read_text(path, 'configuration', ConfigurationError) if path.exists() else ''
    results = []
    for each in options.words:
        recipe = known[each].renamed(names)
        added = add_recipe(path, text, recipe)
        text = added.text
        results.append((recipe, added))
    try:
        replace_text(path, text)
    except OSError as error:
        raise ConfigurationError(f'cannot write {path}: {error.strerror}') from None
    for recipe, added in results:
        if options.json:
            print(json.dumps(_addition(path, recipe, added)))  # noqa: T201
        else:
            _print_addition(path, recipe, added)
    if not options.json:
        print(f'next: dyknow lint {path} --live')  # noqa: T201
    return SUCCESS


def _names(renames: Iterable[str]) -> dict[str, str]:
    for each in renames:
        if '=' not in each:
            raise DyKnowError(f'--rename {each}: write OLD=NEW')
    return dict(each.split('=', 1) for each in renames)


def _search(words: Iterable[str], known: Mapping[str, Recipe]) -> list[Recipe]:
    """Return the recipes that contain all words."""
    wanted = [each.lower() for each in words]
    texts = {each.name: each.searched for each in known.values()}
    found = [known[name] for name, text in texts.items() if all(each in text for each in wanted)]
    if found:
        return found
    missing = [each for each in wanted if not any(each in text for text in texts.values())]
    if not missing:
        raise DyKnowError('no recipe has all of these words; leave some out', ExitCode.NOT_FOUND)
    others = {word for text in texts.values() for word in re.findall(r'[a-z0-9_]{3,}', text)}
    similar = get_close_matches(missing[0], others, n=1)
    hint = f"did you mean '{similar[0]}'?" if similar else '"dyknow recipes" lists all'
    raise DyKnowError(f"no recipe has the word '{missing[0]}'; {hint}", ExitCode.NOT_FOUND)


def _print_list(found: Iterable[Recipe]) -> None:
    from dyknow_common.tables import (  # noqa: PLC0415 - rich is slow to import
        ReportTable,
        Terminal,
        fixed,
        folded,
    )

    rows = [(each.name, each.area, each.description) for each in found]
    columns = (fixed('recipe'), fixed('for'), folded('what it says'))
    Terminal(highlight=False).print(ReportTable(columns, rows))


def _shown(recipe: Recipe) -> str:
    """Return a recipe in full."""
    topics = '\n'.join(f'{topic} ({type_})' for topic, type_ in recipe.topics.items())
    details = {
        'says': recipe.description,
        'problem': recipe.problem,
        'source': '\n'.join(filter(None, (recipe.source, recipe.url))),
        'note': recipe.note,
        'topics': topics,
    }
    at = format_duration(recipe.violated_at)
    return '\n\n'.join(
        (
            f'{recipe.name} ({recipe.area})',
            _table(details),
            f'In robot.yaml:\n\n{recipe.robot.rstrip()}',
            f'Holds over the trace:\n\n{recipe.satisfied.rstrip()}',
            f'Is false at {at} of the trace:\n\n{recipe.violated.rstrip()}',
            f'dyknow recipes {recipe.name} --add robot.yaml',
        )
    )


def _table(details: Mapping[str, str]) -> str:
    """Return names and texts in two columns, as wide as the terminal."""
    from dyknow_common.tables import Terminal, details_table  # noqa: PLC0415

    terminal = Terminal(highlight=False)
    with terminal.capture() as printed:
        terminal.print(details_table(details.items()))
    return '\n'.join(each.rstrip() for each in printed.get().rstrip().split('\n'))


def _print_addition(path: Path, recipe: Recipe, added: AddedRecipe) -> None:
    """Print what was added, and what the user has to look at."""
    print(f'{path}: added {_named(added.added)}')  # noqa: T201
    if added.kept:
        print(f'kept as in the file: {_named(added.kept)}')  # noqa: T201
    values = [each for each in added.added if each.section in {'objects', 'constants'}]
    texts = [each.text for each in added.added]
    details = {each.name: each.text.partition(':')[2].strip() for each in values}
    details |= {
        topic: type_
        for topic, type_ in recipe.topics.items()
        if any(topic in text for text in texts)
    }
    if details:
        print('change what differs on your robot:')  # noqa: T201
        print('\n'.join(f'  {line}' for line in _table(details).split('\n')))  # noqa: T201


def _named(parts: Iterable[RobotPart]) -> str:
    """Return the names of parts, by section: `formula tilt, features OrientationX, OrientationY`."""
    names: dict[str, list[str]] = {}
    for each in parts:
        names.setdefault(each.section, []).append(each.name.rstrip('('))
    return '; '.join(
        f'{_KINDS[section]}{"s" * (len(found) > 1)} {", ".join(found)}'
        for section, found in reversed(names.items())
    )


def _addition(path: Path, recipe: Recipe, added: AddedRecipe) -> dict[str, Any]:
    parts = {'added': added.added, 'kept': added.kept}
    return {
        'file': str(path),
        'recipe': recipe.name,
        **{
            key: [{'section': each.section, 'name': each.name} for each in found]
            for key, found in parts.items()
        },
    }


def _document(recipe: Recipe) -> dict[str, Any]:
    plain = asdict(recipe)
    del plain['parts']
    plain['violated_at_ns'] = plain.pop('violated_at')
    return {**plain, 'robot': recipe.robot}

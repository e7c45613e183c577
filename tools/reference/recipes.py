"""The page of the recipes."""

from itertools import groupby

from reference.markdown import code, page, table

from dyknow_common import format_duration
from dyknow_configuration import read_recipes

INTRODUCTION = """\
Formulas that many robots must keep, each with the problem that it finds, where that comes from,
the topics that it needs, and two traces: one that it holds for, and one that it is false for. The
search of this site finds them; so does the command:

```
dyknow recipes
dyknow recipes px4 land
dyknow recipes speed_limit
```

`--add` copies a recipe into a `robot.yaml`, and keeps the comments of the file. What both have,
such as a feature, stays as it is in the file. Sorts, objects, features, constants and formulas
may get other names:

```
dyknow recipes speed_limit tilt --add robot.yaml
dyknow recipes speed_limit --add robot.yaml --rename Robot=Rover
dyknow lint robot.yaml --live
```

It prints what may differ on your robot: objects, constants, topics and their types. `{r}` in the
name of a topic stands for each object; a robot without a namespace has `/odom` in the place of
`/{r}/odom`. [robot.yaml](configuration.md) explains the rest, [operators in
pictures](operators_in_pictures.md) shows the windows of the operators. The limits are examples:
replace them by the limits of your robot. A formula is no safety function.

A robot *stands* if its forward speed is about zero: for one that turns on the spot or moves
sideways, add these speeds, as `estop_stops` does. A formula begins when each of its topics has
had a message, and a value counts until the next one: publish the first value of a button, a
clearance or a command at the start.

A formula that begins with an unbounded `always` never becomes true, as the next state may break
it: over a recording it *passes* if nothing broke it. It ends at the first state that breaks it.
To be told of each violation, and when it ends, remove the outermost `always`, and add
`every_state: true` ([standing monitors](monitoring.md#standing-monitors))."""

AREAS = {
    'ground': 'Ground robots',
    'safety': 'Safety',
    'fleet': 'Fleets',
    'arm': 'Arms and grippers',
    'air': 'Drones',
    'road': 'Road vehicles',
}


def recipes_page():
    """Return the page."""
    recipes = list(read_recipes().values())
    rows = [(f'[{each.name}](#{each.name})', AREAS[each.area], each.problem) for each in recipes]
    parts = []
    for area, found in groupby(recipes, key=lambda each: each.area):
        parts += [f'## {AREAS[area]}', *map(_recipe, found)]
    return page('Recipes', INTRODUCTION, table(('recipe', 'for', 'problem'), rows), *parts)


def _recipe(recipe):
    topics = [(code(topic), code(type_)) for topic, type_ in recipe.topics.items()]
    at = format_duration(recipe.violated_at)
    source = f'[{recipe.source}]({recipe.url})' if recipe.url else recipe.source
    return '\n\n'.join(
        filter(
            None,
            (
                f'### {recipe.name}',
                f'{recipe.problem} Source: {source}.',
                f'*{recipe.description}*',
                f'```formula\n{recipe.formula}\n```',
                recipe.note,
                table(('topic', 'type'), topics),
                '<details markdown="1">\n<summary>In robot.yaml, and traces</summary>',
                f'```yaml\n{recipe.robot}```',
                f'It holds for\n\n```csv\n{recipe.satisfied}```',
                f'and is false at {at} of\n\n```csv\n{recipe.violated}```',
                '</details>',
            ),
        )
    )

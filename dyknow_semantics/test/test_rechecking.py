"""Annotations are checked again when the fields of their streams become known."""

from pathlib import Path

from dyknow_common import InlineText, ValueType
from dyknow_semantics import Knowledge, parse_annotations
from dyknow_semantics.annotations.checking import Origin, check_annotations, origins_of
from dyknow_semantics.annotations.parsing import parse_concept
from dyknow_semantics.matching.matching import Matcher

TEXT = """\
stream a contains Altitude[uav1] = z;
stream b contains Altitude[uav2] = y;
stream c contains Altitude[uav9] = y;
"""
FIELDS = ('nav/msg/Pose', {'z': ValueType.FLOAT})


def test_a_field_fault_is_located(knowledge: Knowledge) -> None:
    read = {str(each): each for each in parse_annotations(TEXT)}
    # A store keeps the canonical texts.
    stored = {text: each for text in read for each in parse_annotations(text)}
    origins = {text: Origin(Path('/bot.ssl'), each) for text, each in read.items()}
    unchecked = check_annotations(stored, {}, knowledge, origins)
    assert [each.partition(" '")[0] for each in unchecked.messages] == [
        '/bot.ssl: annotation:3:28:'
    ]
    fields = dict.fromkeys(read, FIELDS)
    found = check_annotations(stored, fields, knowledge, origins)
    assert found.messages[0].startswith('/bot.ssl: annotation:2:19: nav/msg/Pose has no field')
    made = {
        text: Origin(InlineText('bot.yaml:5:7', ''), each.annotation)
        for text, each in origins.items()
    }
    found = check_annotations(stored, fields, knowledge, made)
    assert found.messages[0] == "bot.yaml:5:7: nav/msg/Pose has no field 'y' (it has: z)"
    # Matching finds the fault of the third by itself.
    assert found.field_faults == {list(read)[1]: "nav/msg/Pose has no field 'y' (it has: z)"}


def test_an_annotation_that_its_stream_does_not_fit_matches_nothing(knowledge: Knowledge) -> None:
    annotations = {str(each): each for each in parse_annotations(TEXT)[:2]}
    matcher = Matcher(knowledge)
    matcher.set_annotations(annotations)
    concept = parse_concept('Altitude[uav2]')
    assert len(matcher.match(concept)) == 1
    faults = {list(annotations)[1]: 'it has no y'}
    matcher.set_annotations(annotations, faults)
    assert not matcher.match(concept)
    assert matcher.nearest(concept).endswith('; the annotation of b is invalid: it has no y')
    assert matcher.faults == faults
    assert not [each for each in matcher.explain(concept) if each.matches]
    matcher.set_annotations(annotations, {})
    assert len(matcher.match(concept)) == 1


def test_invalid_annotations_are_not_called_none(knowledge: Knowledge) -> None:
    matcher = Matcher(knowledge)
    annotations = {str(each): each for each in parse_annotations(TEXT)[:1]}
    matcher.set_annotations(annotations, dict.fromkeys(annotations, 'it has no z'))
    assert matcher.nearest(parse_concept('Altitude[uav1]')) == (
        'no stream carries Altitude[uav1]; the annotation of a is invalid: it has no z'
    )


def test_a_comment_names_the_place_that_annotations_were_made_from() -> None:
    first, *others = TEXT.splitlines()
    text = '\n'.join([first, '# robot.yaml:6:34', *others])
    path = Path('/robot.ssl')
    origins = origins_of(path, parse_annotations(text))
    assert [str(each.file) for each in origins.values()] == [str(path), *['robot.yaml:6:34'] * 2]
    assert origins_of(path, ()) == {}

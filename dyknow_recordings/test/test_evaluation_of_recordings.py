"""Formulas over recordings: verdicts, violations, stand-ins, silence and episodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from recorded import TYPE, ListedSamples, RecordedSample, at, recording, sample

from dyknow_common import DyKnowError, ExitCode, InlineText, Verdict, round_time
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import parse_constants
from dyknow_recordings.evaluation.episodes import FROM_FIRST_STATE, EpisodeStart, Every
from dyknow_recordings.evaluation.evaluation import evaluate_recording
from dyknow_recordings.evaluation.results import FormulaReport, Outcome
from dyknow_recordings.evaluation.vocabulary import NO_FILES, MonitoringFiles
from dyknow_recordings.reading.columns import TopicContent

pytestmark = pytest.mark.long

ONTOLOGY = """
@prefix : <http://example.org/robots#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://example.org/robots> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
:Robot a owl:Class ; rdfs:subClassOf dyknow:Object .
:Power a owl:Class ; rdfs:subClassOf dyknow:Feature ;
    dyknow:argument1 :Robot ; dyknow:value_type "float" ; dyknow:unit "W" .
:r1 a owl:NamedIndividual, :Robot .
"""
ANNOTATIONS = """
stream main contains Power[r1] = power with sample_period = 100 ms;
stream spare contains Power[r1] = power with sample_period = 200 ms
"""
STREAMS = """
stream main = select p as power from "/main" with max_delay = 50 ms, sample_period = 100 ms,
    sample_period_deviation = 50 ms;
sink main;
stream spare = select p as power from "/spare";
sink spare
"""


ROBOT = """
@prefix : <http://example.org/{name}#> .
@prefix dyknow: <http://www.dyknow.org/ontology#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://example.org/{name}> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
:{sort} a owl:Class ; rdfs:subClassOf dyknow:Object .
:{feature} a owl:Class ; rdfs:subClassOf dyknow:Feature ;
    dyknow:argument1 :{sort} ; dyknow:value_type "float" ; dyknow:unit "{unit}" .
:{object} a owl:NamedIndividual, :{sort} .
:scout a owl:NamedIndividual, :{sort} .
"""
BRIDGES = """
robot2:height equivalent uav:Altitude; robot2:Drone into uav:UAV; robot2:self same uav:uav2;
robot2:Drone into uav:Boat
"""
ANNOTATED = """
stream "/drones" contains height[d] = ft for every d in Drone where d = id;
stream "/scout" contains Altitude[uav:scout] = m
"""


def series(
    topic: str, times: Iterable[float], value: float = 1.0, field: str = 'p'
) -> list[RecordedSample]:
    return [sample(topic, each, **{field: value}) for each in times]


def steps(start: float, end: float, period: float = 0.1) -> list[float]:
    return [start + period * n for n in range(round((end - start) / period))]


def check(
    source: ListedSamples,
    formula: str,
    files: MonitoringFiles = NO_FILES,
    start: EpisodeStart = FROM_FIRST_STATE,
) -> FormulaReport:
    report = evaluate_recording(source, [RequestedFormula(formula)], files, start)
    # Signals are kept without an effect on the results.
    again = evaluate_recording(source, [RequestedFormula(formula)], files, start, keep_signals=True)
    found = tuple(replace(each, signals=None) for each in again.formulas)
    assert repr(replace(again, formulas=found)) == repr(report)
    return report.formulas[0]


@pytest.fixture
def files(tmp_path: Path) -> MonitoringFiles:
    for name, text in (('r.ttl', ONTOLOGY), ('r.ssl', ANNOTATIONS), ('r.streams', STREAMS)):
        (tmp_path / name).write_text(text)
    return MonitoringFiles((tmp_path / 'r.ttl',), (tmp_path / 'r.ssl',), (tmp_path / 'r.streams',))


@pytest.fixture
def bridged_files() -> MonitoringFiles:
    robots = (
        ROBOT.format(name='uav', sort='UAV', feature='Altitude', unit='m', object='uav2'),
        ROBOT.format(name='robot2', sort='Drone', feature='height', unit='ft', object='self'),
    )
    return MonitoringFiles(
        tuple(InlineText(f'robot {number}', text) for number, text in enumerate(robots)),
        (InlineText('annotations', ANNOTATED),),
        bridges=(InlineText('bridges', BRIDGES),),
    )


def drones(robot2: float, scout: float) -> ListedSamples:
    """Return the heights of the drones of robot 2 in ft, and the altitude of another scout."""
    heights = {'self': robot2, 'scout': scout}
    return recording(
        [
            *(
                sample('/drones', each + 0.01 * n, id=name, ft=heights[name])
                for each in steps(0, 2)
                for n, name in enumerate(heights)
            ),
            *series('/scout', steps(0, 2), 10.0, 'm'),
        ]
    )


def test_objects_of_bridged_sorts(bridged_files: MonitoringFiles) -> None:
    formula = 'forall u in UAV: always[0 s, 1 s] Altitude[u] < 30'
    assert check(drones(50.0, 60.0), formula, bridged_files).outcome is Outcome.TRUE
    for source, reason in (
        (drones(1000.0, 60.0), 'Altitude[uav2] = 304.8'),
        (drones(50.0, 500.0), 'Altitude[robot2:scout] = 152.4'),
    ):
        report = check(source, formula, bridged_files)
        assert report.outcome is Outcome.FALSE
        assert reason in report.episodes[0].explanation
        found = {each.symbol for each in report.groundings}
        assert found == {f'Altitude[{each}]' for each in ('uav2', 'uav:scout', 'robot2:scout')}
    notes = evaluate_recording(source, [RequestedFormula(formula)], bridged_files).notes
    assert any("unknown concept 'uav:Boat'" in each for each in notes)
    own = check(drones(1000.0, 1000.0), 'forall d in Drone: always height[d] > 900', bridged_files)
    assert own.outcome is Outcome.UNDECIDED


@pytest.mark.parametrize('comparison', ['u != self', 'u != d', 'u != scout'])
def test_no_object_is_compared_with_another_name(
    bridged_files: MonitoringFiles, comparison: str
) -> None:
    text = f'forall u in UAV: forall d in Drone: {comparison} -> always Altitude[u] < height[d]'
    error = check(drones(50.0, 60.0), text, bridged_files).error
    assert error is not None
    assert f"'{comparison}'" in str(error)


def test_a_verdict_with_its_time_and_reason() -> None:
    source = recording([*series('/a', steps(0, 2)), sample('/a', 2.5, p=9.0)])
    (episode,) = check(source, 'always "/a".p < 5').episodes
    assert (episode.begin, episode.verdict, episode.decided_at) == (at(0), Verdict.FALSE, at(2.5))
    assert '"/a".p = 9' in episode.explanation


def test_only_needed_fields_of_needed_topics_are_read() -> None:
    source = recording([*series('/a', steps(0, 1)), *series('/b', steps(0, 1))])
    check(source, 'always "/a".p < 5')
    assert source.read == {'/a': {'p'}}


def test_a_formula_that_says_how_it_is_asked() -> None:
    source = recording([*series('/a', steps(0, 2)), *series('/a', steps(2, 3), 9.0)])
    asked = RequestedFormula('"/a".p < 5', every_state=True, margin=True)
    plain = RequestedFormula('"/a".p < 5')
    found = evaluate_recording(source, [asked, plain]).formulas
    every = EpisodeStart(every=Every.STATE)
    (standing,) = evaluate_recording(source, [plain], start=every, margins=True).formulas
    assert repr(found[0].episodes) == repr(standing.episodes)
    assert len(found[0].episodes) == 30
    assert found[0].outcome is Outcome.FALSE
    assert (len(found[1].episodes), found[1].margin) == (1, None)


def test_what_remains_undecided() -> None:
    source = recording(series('/a', steps(0, 1)))
    invariant = check(source, 'always "/a".p < 5')
    assert invariant.outcome is Outcome.UNDECIDED
    assert not invariant.presumably_false
    assert invariant.episodes[0].residual_formula == 'always ("/a".p < 5)'
    obligation = check(source, 'eventually "/a".p > 5')
    assert obligation.presumably_false


def test_errors_of_one_formula_do_not_concern_the_others() -> None:
    source = recording(series('/a', steps(0, 1)))
    texts = (
        'always',
        'forall x in Ghost: always P[x] > 1',
        'Altitude[u] > 1',
        'eventually "/a".p = 1',
    )
    report = evaluate_recording(source, [RequestedFormula(text) for text in texts])
    assert [each.outcome for each in report.formulas] == ['error', 'error', 'error', 'true']


def test_a_formula_without_states_is_an_error() -> None:
    source = recording(series('/odom', steps(0, 1)))
    error = check(source, 'always "/odm".p < 5').error
    assert str(error) == (
        'the recording has no state: the recording has no topic /odm (did you mean /odom?)'
    )


@pytest.mark.parametrize('every', [Every.FIRST, Every.STATE])
def test_a_formula_that_needs_no_state(every: Every) -> None:
    start = EpisodeStart(every=every)
    report = check(recording(series('/a', [0])), 'always "/a".p < 5 or true', start=start)
    (episode,) = report.episodes
    assert (episode.verdict, episode.decided_at) == (Verdict.TRUE, None)


def test_a_formula_that_needs_states_but_no_values() -> None:
    error = check(recording(series('/a', [0, 1, 2])), 'eventually[1 s, 2 s] true').error
    assert str(error) == 'the formula depends on no feature, so it has no states'


def test_a_topic_of_an_unknown_type() -> None:
    source = recording(series('/a', [0, 1]))
    source.contents['/a'] = TopicContent(TYPE, None, has_stamp=False, count=2)
    error = check(source, 'always "/a".p < 5').error
    assert f'no message of /a can be read: the message type {TYPE} is not defined' in str(error)


def in_watts(formula: str, files: MonitoringFiles) -> FormulaReport:
    return check(recording(series('/main', steps(0, 2), 150.0)), formula, files)


def test_numbers_are_converted_to_the_unit_of_their_feature(files: MonitoringFiles) -> None:
    report = in_watts('forall r: always[0 s, 1 s] Power[r] < 0.2 kW', files)
    assert report.formula == (
        'let Power: "W" in (forall r in Robot: (always[0 s, 1 s] (Power[r] < 0.2 "kW")))'
    )
    assert report.outcome is Outcome.TRUE
    report = in_watts('forall r: always[0 s, 1 s] Power[r] < 0.1 kW', files)
    assert 'is not < 100 W (0.1 kW)' in report.episodes[0].explanation
    assert in_watts('eventually[0 s, 1 s] Power[r1] > 0.15 "kW"', files).outcome is Outcome.FALSE
    limits = 'let most = 150 W, least = 1 mW in'
    report = in_watts(f'{limits} always[0 s, 1 s] (Power[r1] <= most and Power[r1] > least)', files)
    assert report.outcome is Outcome.TRUE
    constants = parse_constants({'most': '0.15 kW'})
    requested = RequestedFormula('eventually[0 s, 1 s] Power[r1] > most', constants=constants)
    source = recording(series('/main', steps(0, 2), 150.0))
    assert evaluate_recording(source, [requested], files).formulas[0].outcome is Outcome.FALSE


@pytest.mark.parametrize(
    ('formula', 'message'),
    [
        ('always Power[r1] < 2 m', """'2 "m"' is in m, which does not convert to W"""),
        ('always "/main".p < 2 W', """'"/main".p' is a field of a stream, which states no unit"""),
        ('always main.power < 2 W', "'main.power' is a field of a stream, which states no unit"),
        (
            'always main < 2 W',
            'describes this feature; declare it, or state the unit, let main: UNIT in',
        ),
    ],
)
def test_numbers_that_do_not_convert(formula: str, message: str, files: MonitoringFiles) -> None:
    error = in_watts(formula, files).error
    assert message in str(error)
    # The text with the units of features is no text of the user.
    assert ('^' in str(error)) is ('is a field' in message)


def test_a_misspelled_feature_is_not_one_without_a_unit(files: MonitoringFiles) -> None:
    error = in_watts('always Powr[r1] < 2 W', files).error
    assert str(error) == (
        "the unit of 'Powr' is not known, as no ontology describes this feature; "
        "did you mean 'Power'?"
    )


def test_a_violation_without_a_stand_in(files: MonitoringFiles) -> None:
    files.annotations[0].write_text('stream main contains Power[r1] = power')
    source = recording([*series('/main', [*steps(0, 1), *steps(1.5, 3)])])
    report = check(source, 'forall r in Robot: always Power[r] < 5', files)
    assert report.outcome is Outcome.ERROR
    assert report.error is not None
    assert report.error.code is ExitCode.CONSTRAINT_VIOLATION
    assert 'sample_period' in report.error.message
    assert [each.stream_name for each in report.violations] == ['main']


def test_violations_after_the_verdict_do_not_concern_a_formula(files: MonitoringFiles) -> None:
    files.annotations[0].write_text('stream main contains Power[r1] = power')
    source = recording([*series('/main', [*steps(0, 1), *steps(1.5, 3)])])
    texts = ('eventually Power[r1] < 5', 'always Power[r1] < 5')
    early, late = evaluate_recording(source, list(map(RequestedFormula, texts)), files).formulas
    assert (early.outcome, len(early.violations), early.states) == ('true', 0, 1)
    assert (late.outcome, len(late.violations), late.states) == ('error', 1, 10)


def test_a_stream_whose_topic_is_not_recorded_is_no_stand_in(files: MonitoringFiles) -> None:
    source = recording([*series('/main', [*steps(0, 1), *steps(1.5, 3)])])
    report = check(source, 'forall r in Robot: always Power[r] < 5', files)
    assert report.error is not None
    assert report.error.code is ExitCode.CONSTRAINT_VIOLATION
    assert 'sample_period' in report.error.message
    assert report.events == ()


def test_states_that_break_a_rule_at_the_end_are_no_success() -> None:
    # Samples of /a wait for /b, until there are too many.
    waiting = series('/a', [0.001 * n for n in range(20_000)])
    source = recording([*waiting, sample('/b', 0, p=1.0)])
    report = check(source, 'always "/a".p < "/b".p + 5')
    assert report.outcome is Outcome.ERROR
    assert 'buffer' in str(report.error)


def test_a_topic_that_falls_silent() -> None:
    source = recording([*series('/a', steps(0, 1)), *series('/b', steps(0, 9))])
    report = check(source, 'always "/a".p < 5')
    assert (report.outcome, report.waits_for) == ('undecided', '/a has fallen silent')
    assert check(source, 'always "/b".p < 5').waits_for == ''


@pytest.mark.parametrize(
    ('times', 'end', 'reason'),
    [
        ([0.0, 4.0, 8.0], 18, ''),
        ([0.0, 4.0, 8.0], 22, '/a has fallen silent'),
        ([0.0], 22, ''),  # A single message has no rate.
    ],
)
def test_a_topic_is_silent_by_its_own_rate(times: list[float], end: float, reason: str) -> None:
    source = recording([*series('/a', times), *series('/b', steps(0, end))])
    assert check(source, 'always "/a".p < 5').waits_for == reason
    late = check(source, 'always "/a".p < 5', start=EpisodeStart(at(9)))
    assert str(late.error) == 'the recording has no state: /a has fallen silent'


@pytest.mark.parametrize('times', [steps(0, 2), [0.1]])
@pytest.mark.parametrize('batch', [1, 1 << 14])
@pytest.mark.parametrize('every', ['', 'true'])
def test_samples_that_no_state_contains_are_noted(
    times: list[float], batch: int, every: str
) -> None:
    """What they would break after the last state is no success of a strict check."""
    messages = [*series('/a', steps(0, 20)), *series('/b', times), sample('/a', 20, p=99.0)]
    source = recording(messages, batch=batch)
    wanted = [
        RequestedFormula('always "/a".p - "/b".p < 50', name='f', every_state=bool(every)),
        RequestedFormula('always "/a".p + "/b".p < -50', name='decided'),
        RequestedFormula('always "/a".p < 500', name='whole'),
    ]
    report = evaluate_recording(source, wanted)
    until = round_time(at(times[-1]))
    why = '/b has fallen silent'
    assert report.notes == (f"'f' was evaluated until {until} of {round_time(at(20))}: {why}",)
    assert report.formulas[0].waits_for == why


def test_a_topic_that_falls_silent_for_longer_than_the_limit_is_noted() -> None:
    source = recording([*series('/a', steps(0, 1)), *series('/b', steps(0, 9))])
    report = evaluate_recording(source, [RequestedFormula('always "/a".p < 5', name='f')])
    (note,) = report.notes
    assert note.startswith("'f' was evaluated until ")
    assert note.endswith(': /a has fallen silent')


def test_states_that_end_with_the_recording_are_not_noted() -> None:
    messages = [*series('/a', steps(0, 20)), *series('/b', [0, 8, 16])]
    source = recording(messages)
    texts = ['always "/a".p < 99', 'always "/b".p < 99', 'always "/a".p + "/b".p < 99']
    assert evaluate_recording(source, [RequestedFormula(each) for each in texts]).notes == ()


def test_a_stand_in_that_published_all_the_time_loses_no_state(files: MonitoringFiles) -> None:
    main = series('/main', [*steps(0, 1), *steps(1.5, 3)])
    spare = series('/spare', steps(0, 3, 0.2))
    report = check(recording([*main, *spare]), 'always[0 s, 2 s] Power[r1] < 5', files)
    (episode,) = report.episodes
    assert episode.verdict is Verdict.TRUE
    assert report.gaps == ()
    assert 'states are made of select power as "Power[r1]" from spare' in report.events[0]
    # The state between the last one of the former stream and the fault counts, too.
    spare[5] = sample('/spare', 1.0, p=7.0)
    report = check(recording([*main, *spare]), 'always[0 s, 2 s] Power[r1] < 5', files)
    assert (report.episodes[0].verdict, report.episodes[0].decided_at) == (Verdict.FALSE, at(1.0))


def test_a_stand_in_that_broke_its_constraint_gives_a_gap(files: MonitoringFiles) -> None:
    main = series('/main', [*steps(0, 1), *steps(1.5, 3)])
    spare = series('/spare', [*steps(0, 0.3, 0.2), *steps(0.8, 3, 0.2)])
    report = check(recording([*main, *spare]), 'always[0 s, 2 s] Power[r1] < 5', files)
    assert report.episodes[0].verdict is Verdict.UNDECIDED
    assert [each.after for each in report.gaps] == [at(0.9)]


def test_a_late_sample_gives_a_gap(files: MonitoringFiles) -> None:
    """States that were progressed without it lack it."""
    main = [*series('/main', steps(0, 1)), sample('/main', 0.55, delay=0.41, p=7.0)]
    source = recording([*main, *series('/spare', steps(0, 3, 0.2))])
    report = check(source, 'always[0 s, 2 s] Power[r1] < 5', files)
    assert report.episodes[0].verdict is Verdict.UNDECIDED
    (gap,) = report.gaps
    assert gap.after == at(0.9)


def test_a_stand_in_that_begins_late_gives_a_gap(files: MonitoringFiles) -> None:
    main = series('/main', [*steps(0, 1), *steps(1.5, 3)])
    spare = [*series('/spare', steps(1.2, 2.95, 0.2)), sample('/spare', 3.0, p=7.0)]
    report = check(recording([*main, *spare]), 'always Power[r1] < 5', files)
    (episode,) = report.episodes
    assert (episode.verdict, episode.decided_at) == (Verdict.FALSE, at(3.0))
    (gap,) = report.gaps
    assert gap.after == at(0.9)
    assert gap.before == at(1.2)
    assert 'states are made of select power as "Power[r1]" from spare' in report.events[0]


def test_a_verdict_that_depends_on_a_gap_is_an_error(files: MonitoringFiles) -> None:
    main = series('/main', [*steps(0, 1), *steps(1.5, 3)])
    source = recording([*main, *series('/spare', steps(1.2, 3, 0.2))])
    report = check(source, 'eventually[0 s, 1 s] Power[r1] > 5', files)
    assert report.outcome is Outcome.ERROR
    assert 'states that are missing' in str(report.episodes[0].error)


def test_a_silent_topic_is_replaced(files: MonitoringFiles) -> None:
    ssl = files.annotations[0]
    ssl.write_text('stream "/a" contains Power[r1] = p; stream "/b" contains Power[r1] = p')
    spare = [*series('/b', steps(0, 12, 0.2)), sample('/b', 12.5, p=7.0)]
    report = check(recording([*series('/a', steps(0, 1)), *spare]), 'always Power[r1] < 5', files)
    assert report.episodes[0].decided_at == at(12.5)
    assert "topic '/a' has been silent for 5 s" in report.events[0]


@pytest.fixture(params=['topics', 'streams'])
def pair(files: MonitoringFiles, request: pytest.FixtureRequest) -> MonitoringFiles:
    """Return files with two sources of a feature, from /a, the better one, and /b."""
    if request.param == 'topics':
        texts = '"/a" contains Power[r1] = p', '"/b" contains Power[r1] = p'
    else:
        texts = 'main contains Power[r1] = power', 'spare contains Power[r1] = power'
        made = (
            f'stream {name} = select p as power from "/{topic}"; sink {name}'
            for name, topic in (('main', 'a'), ('spare', 'b'))
        )
        files.streams[0].write_text(';'.join(made))
    files.annotations[0].write_text(';'.join(f'stream {each}' for each in texts))
    return files


def test_no_topic_that_has_not_begun_replaces_a_silent_one(pair: MonitoringFiles) -> None:
    first = [*series('/a', [*steps(0, 2), *steps(8, 10)]), sample('/a', 10, p=7.0)]
    source = recording([*first, *series('/a', steps(10.1, 30)), *series('/b', steps(20, 30))])
    report = check(source, 'always Power[r1] < 5', pair)
    assert (report.episodes[0].decided_at, report.events) == (at(10), ())


def test_a_better_topic_that_begins_late_hides_no_violation(pair: MonitoringFiles) -> None:
    spare = [*series('/b', steps(0, 3)), sample('/b', 3, p=7.0), *series('/b', steps(3.1, 30))]
    report = check(recording([*spare, *series('/a', steps(20, 30))]), 'always Power[r1] < 5', pair)
    assert report.episodes[0].decided_at == at(3)


def test_an_overdue_stream_without_a_stand_in(files: MonitoringFiles) -> None:
    source = recording([*series('/a', steps(0, 1)), *series('/other', steps(0, 12))])
    files.streams[0].write_text(
        'stream main = select p as power from "/a" with sample_period = 100 ms; sink main'
    )
    files.annotations[0].write_text('stream main contains Power[r1] = power')
    report = check(source, 'always Power[r1] < 5', files)
    # The topics that no formula uses still tell how long the recording is.
    assert report.error is not None
    assert report.error.code is ExitCode.UNAVAILABLE
    assert report.error.message == "topic '/a' has been silent for 5 s"


def test_late_samples_are_put_in_order(tmp_path: Path) -> None:
    path = tmp_path / 'a.streams'
    path.write_text('stream a = select p from "/a" with max_delay = 300 ms; sink a')
    late = [sample('/a', 0.1 * n, delay=0.25 * (n == 5), p=float(n)) for n in range(20)]
    report = check(recording(late), 'always a.p != 5', MonitoringFiles(streams=(path,)))
    assert report.episodes[0].decided_at == at(0.5)
    report = check(recording(late), 'always "/a".p != 5')
    assert 'valid_time_order' in str(report.error)


@pytest.mark.parametrize(
    ('broken', 'text'),
    [
        (RecordedSample(at(1), '/a', TYPE, -5, {'p': 1.0}), 'stamped with a time before 1970'),
        (
            RecordedSample(at(1), '/a', 'a/msg/B', at(1), {'p': 1.0}),
            'type of the topic has changed',
        ),
    ],
)
def test_messages_that_cannot_be_used(broken: RecordedSample, text: str) -> None:
    report = check(recording([*series('/a', steps(0, 0.9)), broken]), 'always "/a".p < 5')
    assert text in str(report.error)


def test_zero_stamps_are_replaced_by_the_time_of_recording() -> None:
    unset = [RecordedSample(at(n), '/a', TYPE, 0, {'p': float(n)}) for n in range(3)]
    report = evaluate_recording(recording(unset), [RequestedFormula('always "/a".p < 2')])
    assert report.formulas[0].episodes[0].decided_at == at(2)
    assert report.notes == ("topic '/a' leaves stamps at zero: the time of recording is used",)


def test_a_topic_without_stamps() -> None:
    plain = [RecordedSample(at(n), '/a', TYPE, None, {'p': float(n)}) for n in range(3)]
    assert check(recording(plain), 'always "/a".p < 2').episodes[0].decided_at == at(2)


def test_a_table_has_features_for_fields() -> None:
    rows = [sample('states', n, **{'Power[u1]': float(n), 'Power[u2]': 1.0}) for n in range(4)]
    files = MonitoringFiles(domains={'UAV': ('u1', 'u2')})
    report = check(recording(rows), 'forall u in UAV: always Power[u] < 3', files)
    assert report.episodes[0].decided_at == at(3)


def test_an_episode_at_every_state() -> None:
    source = recording([*series('/a', [0, 1, 3]), sample('/a', 2, p=9.0)])
    start = EpisodeStart(every=Every.STATE)
    report = check(source, 'eventually[0 s, 1 s] "/a".p > 5', start=start)
    found = [(each.begin, each.outcome, each.decided_at) for each in report.episodes]
    assert found == [
        (at(0), 'false', at(1)),
        (at(1), 'true', at(2)),
        (at(2), 'true', at(2)),
        (at(3), 'undecided', None),
    ]


def test_an_episode_at_each_rising_edge() -> None:
    values = [0, 0, 1, 1, 0, 1, 1]
    source = recording(
        [sample('/a', n, up=float(each), v=float(n)) for n, each in enumerate(values)]
    )
    start = EpisodeStart(every=Every.TRIGGER, trigger='"/a".up > 0.5')
    report = check(source, 'always[0 s, 1 s] "/a".v < 6', start=start)
    found = [(each.begin, each.outcome, each.decided_at) for each in report.episodes]
    assert found == [(at(2), 'true', at(3)), (at(5), 'false', at(6))]


def test_a_trigger_that_looks_ahead_is_refused() -> None:
    start = EpisodeStart(every=Every.TRIGGER, trigger='eventually "/a".p > 5')
    error = check(recording(series('/a', steps(0, 1))), 'always "/a".p < 5', start=start).error
    assert 'is not decided by one state' in str(error)


def test_the_begin() -> None:
    source = recording([*series('/a', steps(0, 1), 9.0), *series('/a', steps(1, 2), 1.0)])
    start = EpisodeStart(begin=at(1))
    report = check(source, 'always "/a".p < 5', start=start)
    assert (report.episodes[0].begin, report.outcome) == (at(1), 'undecided')
    late = check(source, 'always "/a".p < 5', start=EpisodeStart(begin=at(9)))
    assert str(late.error) == 'the recording has no state: it ends too early'


@pytest.mark.parametrize('batch', [1, 1000])
@pytest.mark.parametrize('delay', [0.0, 90_000.0])
def test_the_begin_with_stamps_of_another_clock(delay: float, batch: int) -> None:
    messages = [sample('/a', time - delay, delay=delay, p=1) for time in steps(0, 9)]
    source = recording(messages, batch)
    report = check(source, 'eventually "/a".p > 5', start=EpisodeStart(begin=at(6)))
    assert report.episodes[0].begin == at(6 - delay), report
    assert report.states == len(steps(6, 9))


def test_a_broken_stream_is_named_where_it_is_used(files: MonitoringFiles) -> None:
    files.streams[0].write_text('stream main = select q as power from "/main"; sink main')
    source = recording(series('/main', steps(0, 1)))
    report = evaluate_recording(source, [RequestedFormula('always Power[r1] < 5')], files)
    error = report.formulas[0].error
    assert "stream 'main' cannot be made" in str(error)
    assert "no field 'q'" in str(error)


def test_files_that_cannot_be_read() -> None:
    files = MonitoringFiles(streams=(Path('nowhere.streams'),))
    with pytest.raises(DyKnowError, match=r'cannot read the streams in nowhere.streams'):
        evaluate_recording(recording(series('/a', [0])), [RequestedFormula('true')], files)


def test_a_jump_of_years_ends() -> None:
    early = RecordedSample(0, '/a', TYPE, 1, {'p': 1.0})
    source = recording([early, *series('/a', steps(0, 1))])
    assert check(source, 'always "/a".p < 5').outcome is Outcome.UNDECIDED


@pytest.mark.parametrize(
    ('delay', 'outcome'), [(0.9, 'undecided'), (2.0, Outcome.ERROR), (90_000.0, 'undecided')]
)
def test_stamps_of_a_clock_that_lags(delay: float, outcome: str) -> None:
    """If it lags by more than a day, it is a simulation's."""
    messages = [sample('/a', time - delay, delay=delay, p=1) for time in steps(3, 9)]
    report = check(recording(messages), 'always "/a".p < 5')
    assert report.outcome == outcome, report
    if outcome is Outcome.ERROR:
        assert 'came 2 s after its stamp' in str(report.error)

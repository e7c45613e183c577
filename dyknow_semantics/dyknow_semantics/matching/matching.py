"""Semantic matching: which streams carry what a concept means (paper, section V)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product

from dyknow_common import LanguageError
from dyknow_semantics.annotations.annotation import Annotation, Concept
from dyknow_semantics.annotations.checking import check_annotation, check_concept
from dyknow_semantics.matching.index import Offer, OfferIndex
from dyknow_semantics.matching.near_misses import Explanation, near_misses, nearest
from dyknow_semantics.matching.object_names import ObjectNames
from dyknow_semantics.matching.patterns import Pattern, pattern_of
from dyknow_semantics.matching.specifications import Match, MatchQuery, in_order, make_match
from dyknow_semantics.ontology.features import converts
from dyknow_semantics.ontology.knowledge import Knowledge


def match(
    concept: Concept, annotations: Iterable[Annotation], knowledge: Knowledge
) -> tuple[Match, ...]:
    """The streams that carry a concept; to ask more than once, see `Matcher.match`.

    Raises:
        LanguageError: if the concept makes no sense relative to the ontology.
    """
    matcher = Matcher(knowledge)
    matcher.update({str(each): each for each in annotations})
    return matcher.match(concept)


@dataclass(frozen=True, slots=True)
class _Entry:
    """An annotation and what it offers, or why it offers nothing."""

    annotation: Annotation
    offers: tuple[Offer, ...]
    fault: str = ''


class Matcher:
    """Annotations, indexed by what they mean; a change costs what it changes.

    An annotation that makes no sense, such as of an object that is gone, matches nothing until the
    ontology is changed so that it does.

    Args:
        knowledge: the ontologies, with the bridges between them.
        stated: what the ontologies say by themselves, where there are bridges.
    """

    def __init__(self, knowledge: Knowledge, stated: Knowledge | None = None) -> None:
        self.knowledge = knowledge
        self._stated = stated or knowledge
        self._speech = ObjectNames(self._stated, knowledge)
        self._entries: dict[str, _Entry] = {}
        self._taken: Mapping[str, Annotation] = {}
        self._mentions: dict[str, dict[str, None]] = defaultdict(dict)
        self.index = OfferIndex()

    @property
    def faults(self) -> Mapping[str, str]:
        """What is wrong with each annotation that makes no sense, by its canonical text."""
        return {text: each.fault for text, each in self._entries.items() if each.fault}

    def update(self, annotations: Mapping[str, Annotation]) -> None:
        """Takes these annotations, by their canonical texts, in place of those it has."""
        if annotations is self._taken:
            return
        for text in self._entries.keys() - annotations.keys():
            self.remove(text)
        for text in annotations.keys() - self._entries.keys():
            self.add(text, annotations[text])
        self._taken = annotations

    def add(self, text: str, annotation: Annotation) -> None:
        """Adds an annotation of this canonical text."""
        entry = self._entries[text] = self._entry(annotation)
        for offer in entry.offers:
            self.index.add(offer)
        for name in _mentioned(annotation):
            self._mentions[name][text] = None

    def remove(self, text: str) -> None:
        """Removes the annotation of a canonical text."""
        entry = self._entries.pop(text)
        for offer in entry.offers:
            self.index.remove(offer)
        for name in _mentioned(entry.annotation):
            del self._mentions[name][text]
            if not self._mentions[name]:
                del self._mentions[name]

    def learn(self, knowledge: Knowledge, stated: Knowledge | None = None) -> None:
        """Takes another state of the ontologies; see the class for the arguments."""
        before, after = (self.knowledge, self._stated), (knowledge, stated or knowledge)
        if before == after:
            return
        self.knowledge, self._stated = after
        self._speech = ObjectNames(self._stated, knowledge)
        compared = dict.fromkeys(zip(before, after, strict=True))
        changed = [
            name
            for name in self._mentions
            if any(old.meaning(name) != new.meaning(name) for old, new in compared)
        ]
        for text in dict.fromkeys(text for name in changed for text in self._mentions[name]):
            annotation = self._entries[text].annotation
            self.remove(text)
            self.add(text, annotation)

    def match(self, concept: Concept) -> tuple[Match, ...]:
        """The streams that carry a concept, one for each ground feature of each annotated field.

        Returns:
            Exact matches before others, then those of a shorter sample period before others, then
            of a shorter delay, then by name.

        Raises:
            LanguageError: if the concept makes no sense relative to the ontology.
        """
        asked = self.pattern(concept)
        unit = self.knowledge.feature(asked.feature).unit
        found: list[Match] = []
        for carried in self.knowledge.subconcepts(asked.feature):
            if carried in self.index.features:
                exact = asked.feature in self.knowledge.subconcepts(carried)
                question = MatchQuery(concept.feature.name, asked.feature, unit, exact)
                offers = self.index.candidates(carried, asked)
                self._answer(question, asked, offers, found)
        return in_order(found)

    def nearest(self, concept: Concept) -> str:
        """A sentence on what comes nearest to a concept that nothing matches.

        Raises:
            LanguageError: if the concept makes no sense relative to the ontology.
        """
        sentence = nearest(concept, self.pattern(concept), self.index, self.knowledge)
        name = concept.feature.name
        faults = [
            f'; the annotation of {each.annotation.stream} makes no sense: {each.fault}'
            for each in self._entries.values()
            if each.fault and name in _mentioned(each.annotation)
        ]
        return ''.join([sentence, *faults[:1]])

    def explain(self, concept: Concept) -> tuple[Explanation, ...]:
        """Why streams match a concept, in their order, and why others nearly do.

        Raises:
            LanguageError: if the concept makes no sense relative to the ontology.
        """
        matches = (
            Explanation(str(each.declaration), matches=True, reason=each.reason)
            for each in self.match(concept)
        )
        misses = near_misses(self.pattern(concept), self.index, self.knowledge)
        faulty = (
            Explanation(text, matches=False, reason=fault) for text, fault in self.faults.items()
        )
        return (*matches, *misses, *faulty)

    def pattern(self, concept: Concept) -> Pattern:
        """The ground features that are asked for.

        Raises:
            LanguageError: if the concept makes no sense relative to the ontology.
        """
        check_concept(concept, self.knowledge)
        known = self.knowledge
        return pattern_of(concept.feature, concept.ranges, known, known.identities)

    def _answer(
        self, question: MatchQuery, asked: Pattern, offers: Iterable[Offer], found: list[Match]
    ) -> None:
        """Adds the matches among offers; those made for an earlier question are there already."""
        unit, has_synonyms = question.unit, self.knowledge.has_synonyms
        for offer in offers:
            if offer.unit != unit and offer.unit and not converts(offer.unit, unit):
                continue
            for objects in offer.pattern.common_objects(asked):
                answers = offer.answers.get(question)
                if answers is None:
                    answers = offer.answers[question] = {}
                for names in self._names(asked, objects) if has_synonyms else (objects,):
                    if names not in answers:
                        data = self._data(offer, objects)
                        answers[names] = make_match(question, names, offer, data)
                    found.append(answers[names])

    def _names(self, asked: Pattern, objects: tuple[str, ...]) -> Iterable[tuple[str, ...]]:
        """What whoever asks calls some objects."""
        choices = (
            self._speech.names(sort, each) if sort else (word,)
            for each, word, sort in zip(objects, asked.words, asked.sorts, strict=True)
        )
        return product(*choices)

    def _data(self, offer: Offer, objects: tuple[str, ...]) -> dict[str, str]:
        """For each variable of an offer, what its samples call the object that it stands for."""
        pattern = offer.pattern
        placed = zip(pattern.arguments, pattern.sorts, objects, strict=True)
        return {
            argument.removeprefix('?'): self._speech.datum(sort, each)
            for argument, sort, each in placed
            if sort
        }

    def _entry(self, annotation: Annotation) -> _Entry:
        try:
            check_annotation(annotation, self._stated)
        except LanguageError as error:
            return _Entry(annotation, (), error.reason)
        offers: list[Offer] = []
        for content in annotation.contents:
            # A bridge into a sort adds to what is asked for, not to what a stream carries.
            identities = self._speech.identities
            pattern = pattern_of(content.feature, annotation.ranges, self.knowledge, identities)
            unit = content.unit or self._stated.feature(pattern.feature).unit
            offers.append(Offer(annotation, content, pattern, unit))
        return _Entry(annotation, tuple(offers))


def _mentioned(annotation: Annotation) -> dict[str, None]:
    """The names of features, sorts and objects in an annotation."""
    names = dict.fromkeys(each.sort for each in annotation.ranges)
    for content in annotation.contents:
        names[content.feature.name] = None
        names |= dict.fromkeys(argument.name for argument in content.feature.arguments)
    return names

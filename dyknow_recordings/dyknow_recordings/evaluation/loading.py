"""The vocabulary of a check, loaded from files."""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_recordings.evaluation.vocabulary import MonitoringFiles, NoVocabulary, Vocabulary
from dyknow_recordings.reading.columns import TopicContent


def load_vocabulary(files: MonitoringFiles, topics: Mapping[str, TopicContent]) -> Vocabulary:
    """Return the vocabulary of some files.

    Args:
        files: the files.
        topics: the recorded topics, against whose fields the annotations are checked.

    Raises:
        DyKnowError: naming a file that cannot be read.
    """
    if not (files.ontologies or files.annotations):
        return NoVocabulary(files.domains)
    # The libraries for ontologies take a second to load.
    from dyknow_recordings.evaluation.semantics import SemanticVocabulary  # noqa: PLC0415

    return SemanticVocabulary(files, topics)

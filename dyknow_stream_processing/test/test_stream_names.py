"""The check of the names of streams."""

import gc

from dyknow_stream_processing.language.specification import SinkDeclaration
from dyknow_stream_processing.management.naming import check_name


def test_no_syntax_is_kept_for_a_checked_name() -> None:
    def kept() -> int:
        gc.collect()
        return sum(type(each) is SinkDeclaration for each in gc.get_objects())

    before = kept()
    for number in range(100):
        check_name(f'states_of_evaluation_{number}')
    assert kept() == before

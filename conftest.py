"""Imports the packages before pytest meets the folders of the same names that hold them."""

import dyknow_bringup  # noqa: F401
import dyknow_coordinator  # noqa: F401
import dyknow_reasoning  # noqa: F401
import dyknow_semantics  # noqa: F401
import dyknow_stream_processing  # noqa: F401

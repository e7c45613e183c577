"""Lets tests share what `reasoning_reference.py` holds."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

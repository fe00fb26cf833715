"""What the tests of the sweep share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # workers import `sweep_units` by that name

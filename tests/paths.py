"""Where the project and the shared recordings are. Tests that need recordings skip when the folder
is absent."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

DATA = Path(os.environ.get("KOLLSMAN_DATA", ROOT.parent / "shared" / "data"))

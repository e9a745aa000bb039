"""Where data for local use are: recorded contacts, frames, grasps; beside the checkout or where PALPATE_DATA says."""

import os
from pathlib import Path

DATA = Path(os.environ.get("PALPATE_DATA", Path(__file__).resolve().parents[2].parent / "shared" / "data"))

"""Files of the C headers of external GNCs and of backends, which ``docs/c_headers.py`` writes from the records."""

from __future__ import annotations

from pathlib import Path
from typing import Final

HEADER_FILE: Final = Path(__file__).resolve().parent / "include" / "hil_gnc.h"
BACKENDS_HEADER_FILE: Final = HEADER_FILE.with_name("hil_backends.h")

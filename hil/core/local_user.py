"""Account on this computer under which the program runs."""

from __future__ import annotations

import os
import pwd


def local_user() -> str:
    """Return the name of the account from the operating system, not from the environment."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"user {os.getuid()}"

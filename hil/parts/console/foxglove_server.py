"""Process of a console's server for Foxglove.

``python -m hil.parts.console.foxglove_server``, started by ``foxglove_clients``, ends with its parent.
"""

from hil.core.child_process import Parent
from hil.parts.console.foxglove_process import run_child


def main() -> None:
    """Serve until the console ends."""
    run_child(Parent())


if __name__ == "__main__":
    main()

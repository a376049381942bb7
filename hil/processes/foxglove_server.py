"""Process of a console's server for Foxglove.

``python -m hil.processes.foxglove_server`` is started by ``hil.console.foxglove_clients``; it ends with its parent.
"""

from hil.console.foxglove_process import run_child
from hil.core.child_process import Parent


def main() -> None:
    """Serve until the console ends."""
    run_child(Parent())


if __name__ == "__main__":
    main()

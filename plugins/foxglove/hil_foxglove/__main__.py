"""Process of a console's server for Foxglove: ``hil_foxglove.clients`` starts it, and it ends with its parent."""

from hil.core.child_process import Parent
from hil_foxglove.process import run_child

if __name__ == "__main__":
    run_child(Parent())

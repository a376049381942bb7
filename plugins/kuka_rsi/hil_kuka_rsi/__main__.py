"""``python -m hil_kuka_rsi RIG -o DIR``: files for the controller, from the rig file that the bench uses."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hil.config.load import load_rig
from hil.errors import BadInput
from hil_kuka_rsi.controller_files import controller_files
from hil_kuka_rsi.entry import RsiSettings


def main() -> int:
    """Write the files; return 2 for a rig file that has no KUKA robot."""
    parser = argparse.ArgumentParser(prog="python -m hil_kuka_rsi", description=__doc__)
    parser.add_argument("rig", help="rig file")
    parser.add_argument("-o", dest="folder", type=Path, required=True, help="folder of the files")
    options = parser.parse_args()
    try:
        arm = load_rig(options.rig).value.arm
    except BadInput as error:
        sys.stderr.write(f"{error}\n")
        return 2
    settings = None if arm is None or arm.driver != "kuka_rsi" else arm.settings
    if not isinstance(settings, RsiSettings):
        sys.stderr.write(f'{options.rig}: rig.arm.driver: allowed "kuka_rsi"\n')
        return 2
    options.folder.mkdir(parents=True, exist_ok=True)
    for name, text in controller_files(settings).items():
        (options.folder / name).write_text(text, encoding="utf-8")
        sys.stdout.write(f"{options.folder / name}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

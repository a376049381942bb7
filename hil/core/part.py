"""Parts: capabilities of a bench in addition to its core, each declared by one ``Part``.

The core imports no part. It asks for what it needs by the setting that needs it, as ``vmu.source=rendered``, or by a
place where every part may add something, as the checks of a job. Parts of this package are listed in
``hil.parts.declarations``,
those of other packages are found by entry points of the group ``hil.parts``, named as the part:

    [project.entry-points."hil.parts"]
    robot = "acme_robot.part:PART"

A declaration names functions by their import paths, ``module:function``. A module is imported when its function is
called, so that a session loads those parts alone that its scenario and rig use.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, NamedTuple

from hil.core.build_info import VERSION
from hil.errors import BadInput, one_line

GROUP: Final = "hil.parts"
_OURS: Final = "hil.parts.declarations:PARTS"


class PartCommand(NamedTuple):
    """Command of a part. path: of a function, or of an App with commands of its own. summary: of ``hil --help``.

    example: a line that can be typed.
    """

    path: str
    summary: str
    example: str = ""


class PartSink(NamedTuple):
    """Rows that a run sends to its recording for a part. slots: rows of the ring between them, in real time.

    topic, schema: of the channel in the file. fields: import path of the field table of a row, which begins with the
    time ``t_s`` of the run. Without these the rows are images, IMAGE, whose topics are those of their cameras.
    offsets: import path of a function of rows that returns those with a position of the chaser, and the positions less
    those by the encoders, (n, 3), m, in H: a console plots them.
    """

    slots: int
    topic: str = ""
    schema: str = ""
    fields: str = ""
    offsets: str = ""


@dataclass(frozen=True, kw_only=True)
class Part:
    """Declaration of a part. Functions and models are named by import paths, ``module:name``."""

    name: str
    summary: str
    commands: Mapping[str, PartCommand] = field(default_factory=dict)
    """Commands of ``hil`` by name; "recordings place" is added to the commands of ``hil recordings``."""
    tables: Mapping[str, str] = field(default_factory=dict)
    """Models of its tables in scenario and rig files, by key: "tracker", "rig.tracker"; "" for those in ``hil.config``.
    A file need not have them: defaults of an absent table are the part's."""
    provides: Mapping[str, str] = field(default_factory=dict)
    """Functions that the core needs, by the setting or the option that needs them."""
    uses: Callable[[Any, Any], bool] | None = None
    """Whether a run of a scenario on a rig uses the part; None: if one of the files has a table of it that is not in
    ``hil.config``. The following functions are called for such runs alone."""
    check_rig: str = ""
    check_run: str = ""
    """Return the problems of a scenario and a rig, as loaded, that prevent any motion, or the run."""
    attach: str = ""
    """Returns the context in which the part of a session acts, for a ``Job`` and the ``SessionParts`` to add to."""
    each_cycle: bool = False
    """Whether it checks each cycle of a run, as it ends: the compiled loop hands its rows over many cycles later."""
    preflight: str = ""
    """Returns the ``PreflightCheck``s of its devices, for a rig whose wires have addresses."""
    attachments: str = ""
    """Returns texts for a recording by their names, for a scenario and a rig."""
    sinks: Mapping[str, PartSink] = field(default_factory=dict)
    """What it adds to recordings, by name."""
    viewers: Mapping[str, str] = field(default_factory=dict)
    """Make live viewers of a console, by the names of these: ``Viewer`` in ``hil.parts.console.viewers``."""
    sections: Mapping[str, str] = field(default_factory=dict)
    """Return the ``Section`` of a table of the summary, by the name of the table: see ``hil.report.section``."""
    kernels: Mapping[str, str] = field(default_factory=dict)
    """Compile a group of kernels, by its name in ``hil warm-up``."""
    opencv: bool = False
    """Whether its kernels need OpenCV."""
    modules: Sequence[str] = ()
    """Packages and modules of which it is made besides ``hil.parts.NAME``, for the import contract."""

    def tables_in(self, scenario: Any, rig: Any) -> list[str]:
        """Return the keys of its tables that the files have, without those in ``hil.config``."""
        extra = [*(scenario.model_extra or {}), *(f"rig.{key}" for key in rig.model_extra or {})]
        return [key for key in self.tables if key in extra]

    def used_by(self, scenario: Any, rig: Any) -> bool:
        """Return whether a run of ``scenario`` on ``rig`` uses the part."""
        return bool(self.tables_in(scenario, rig)) if self.uses is None else self.uses(scenario, rig)

    def claims(self) -> Iterator[str]:
        """Yield what no other part may have as well."""
        yield f"name {self.name}"
        yield from (f"command {name}" for name in self.commands)
        yield from (f"table [{key}]" for key in self.tables)
        yield from (f"setting {key}" for key in self.provides)
        yield from (f"sink {name}" for name in self.sinks)
        yield from (f"viewer {name}" for name in self.viewers)
        yield from (f"kernels {group}" for group in self.kernels)
        yield from (f"table {name} of the summary" for name in self.sections)
        yield from (f"topic {sink.topic}" for sink in self.sinks.values() if sink.topic)


class InstalledPart(NamedTuple):
    """A usable part. origin: the package that it is from."""

    part: Part
    version: str
    origin: str


class Parts(NamedTuple):
    """The parts of an installation by name, and one line for each that cannot be used."""

    usable: dict[str, InstalledPart]
    problems: list[str]


@cache
def parts() -> Parts:
    """Return the parts of this installation: ``hil.parts`` first, then other packages."""
    own = [InstalledPart(part, VERSION, "hil") for part in imported(_OURS)]
    return joined(own, entry_points(group=GROUP))


def joined(own: Iterable[InstalledPart], points: Iterable[EntryPoint]) -> Parts:
    """Return ``own`` and the parts of ``points``, of which none may claim what an earlier one has."""
    joint = Parts({}, [])
    owners: dict[str, str] = {}

    def add(new: InstalledPart) -> None:
        what = f"part {new.part.name} of package {new.origin}"
        claims = [*new.part.claims()]
        if taken := [claim for claim in claims if claim in owners]:
            joint.problems.append(f"{what}: {taken[0]} is that of {owners[taken[0]]}: the part is left out")
            return
        if twice := [claim for claim in claims if claims.count(claim) > 1]:
            joint.problems.append(f"{what}: declares {twice[0]} twice: the part is left out")
            return
        owners.update(dict.fromkeys(claims, what))
        joint.usable[new.part.name] = new

    for each in own:
        add(each)
    for point in points:
        name = f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"
        what = f"part {point.name} of package {name}: {point.value}"
        try:
            loaded = point.load()
        except Exception as error:
            joint.problems.append(f"{what} cannot be imported: {one_line(f'{type(error).__name__}: {error}', 200)}")
            continue
        if not isinstance(loaded, Part):
            joint.problems.append(f"{what} is of type {type(loaded).__name__}, expected Part")
        elif loaded.name != point.name:
            joint.problems.append(f"{what} declares part {loaded.name}, expected {point.name}")
        else:
            add(InstalledPart(loaded, point.dist.version if point.dist else "", point.dist.name if point.dist else ""))
    return joint


def commands_of(group: str = "") -> dict[str, PartCommand]:
    """Return the commands of all parts, or those that parts add to the commands of ``group``: "recordings place"."""
    within = {name: command for name, command in declared("commands").items() if name.rpartition(" ")[0] == group}
    return {name.rpartition(" ")[2]: command for name, command in within.items()}


def provided(setting: str, source: str = "hil") -> Any:
    """Return what a part provides for ``setting``. source: for messages. Raises BadInput if no usable part has it."""
    for each in parts().usable.values():
        if setting in each.part.provides:
            return imported(each.part.provides[setting])
    reasons = "".join(f"; {problem}" for problem in parts().problems)
    raise BadInput.single(source, setting, f"needs a part that is not installed, see hil list parts{reasons}")


def used_parts(scenario: Any, rig: Any) -> list[InstalledPart]:
    """Return the parts that a run of ``scenario`` on ``rig`` uses."""
    return [each for each in parts().usable.values() if each.part.used_by(scenario, rig)]


def declared(name: str) -> dict[str, Any]:
    """Return what all parts declare under ``name``, by its keys: "kernels", "viewers"."""
    return {key: value for each in parts().usable.values() for key, value in getattr(each.part, name).items()}


@cache
def part_sinks() -> dict[str, PartSink]:
    """Return the sinks of all parts by name."""
    return declared("sinks")


def without_opencv() -> list[str]:
    """Return the groups of kernels that cannot be compiled without OpenCV."""
    return [group for each in parts().usable.values() if each.part.opencv for group in each.part.kernels]


def hooks(name: str, scenario: Any, rig: Any) -> Iterator[Any]:
    """Yield the function that each part which a run of ``scenario`` on ``rig`` uses has for ``name``, if it has one."""
    for each in used_parts(scenario, rig):
        if path := getattr(each.part, name):
            yield hook(each.part, name, path)


def hook(part: Part, name: str, path: str) -> Any:
    """Return what the import path of ``part`` under ``name`` names. Raises BadInput if it names nothing."""
    try:
        return imported(path)
    except (AttributeError, ImportError) as error:
        raise BadInput.single(f"part {part.name}", name, f"{path!r}: {error}") from error


def imported(path: str) -> Any:
    """Return what the import path ``module:name`` names."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)

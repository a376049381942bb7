"""Table ``[tracker]`` of a rig file: stream, bodies, bounds, and faults of a tracker that is no device."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.faults import ALWAYS_S, FACTOR_MAX, ErrorTerm
from hil.config.tables.model import ConfigModel, Delay, Name, NotNegative, Positive, Triple

ROLES: Final = ("chaser", "target", "reference")
"""Bodies of a tracker, in the order of the records."""
MOVED: Final = ("rails", "target", "bench", "tracker")
"""What a fault ``moved`` displaces: rails with the chaser, target, both of them, or the tracker itself."""
_PORTS: Final = {"natnet": 1510, "qtm": 22223}

FAULTS: Final[dict[str, ErrorTerm]] = {
    "no_pose": ErrorTerm("no body is tracked"),
    "lost": ErrorTerm("`of` is not tracked: markers are hidden"),
    "swapped": ErrorTerm("chaser and target have each other's names"),
    "frozen": ErrorTerm("repeats its last poses, with fresh time stamps"),
    "noise_scale": ErrorTerm("the noise is this multiple of the stated one", 1, "1", "", 0.0, FACTOR_MAX),
    "clock_jump": ErrorTerm("its clock is ahead by this time", 1, "s", "", -1e6, 1e6),
    "moved": ErrorTerm("`of` is displaced: rails, target, bench or tracker", 3, "m", "H", 0.0, 10.0),
    "rotated": ErrorTerm("the chaser is rotated", 3, "deg", "c", 0.0, 90.0),
}
"""Kind of fault -> term, of a mock or emulated tracker."""


class TrackedBody(ConfigModel):
    """A body of the tracker, and the pose on it of what it stands for: as fitted; unless set, the same axes."""

    body: Annotated[int, Field(ge=0)] | Name
    """Streaming ID of a body of NatNet, name of one of QTM."""
    position_m: Triple = (0.0, 0.0, 0.0)
    """In the axes of the body: from its origin to the reference point of chaser or target."""
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    """Rotation vector from the axes of the body to c of the chaser, H of the target."""


class TrackerFrame(ConfigModel):
    """`[tracker.frame]`: H in the frame of the tracker; unless set, it is measured by the target's body."""

    position_m: Triple
    """Position of the target's reference point."""
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    """Rotation vector from the tracker's axes to H."""


class TrackerFault(ConfigModel):
    """`[[tracker.faults]]`: a fault of a mock or emulated tracker, in the run's time."""

    at_s: NotNegative
    """Onset; of an emulated tracker by the time of the bench."""
    until_s: Positive | None = None
    """End; default: the end of the run."""
    kind: str
    """`no_pose`, `lost`, `swapped`, `frozen`, `noise_scale`, `clock_jump`, `moved`, `rotated`."""
    value: float | Triple | None = None
    """Size: factor, s, m in H, deg."""
    of: Literal["chaser", "target", "reference", "rails", "bench", "tracker"] | None = None
    """Body that is `lost`, by default the chaser; what has `moved`, by default the rails."""

    @property
    def end_s(self) -> float:
        """End, in the run's time."""
        return ALWAYS_S if self.until_s is None else self.until_s

    @property
    def values(self) -> tuple[float, ...]:
        """Components of the value, () without one."""
        return () if self.value is None else self.value if isinstance(self.value, tuple) else (self.value,)

    @model_validator(mode="after")
    def _is_in_the_table(self) -> Self:
        if (term := FAULTS.get(self.kind)) is None:
            raise ValueError(f'kind = "{self.kind}": a tracker has {", ".join(FAULTS)}')
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"until_s = {self.until_s:g}: must be later than at_s = {self.at_s:g}")
        if problem := term.problem(self.values) if term.values or self.values else "":
            raise ValueError(problem if self.values else f'kind = "{self.kind}" needs value, {term.count}')
        allowed = {"lost": ROLES, "moved": MOVED}.get(self.kind, ())
        if self.of is not None and self.of not in allowed:
            raise ValueError(f'of = "{self.of}": {self.kind} takes {", ".join(allowed) or "none"}')
        return self


class Tracker(ConfigModel):
    """`[tracker]`: an independent measurement of the bench's pose. It is compared with the encoders, and never reaches
    the GNC."""

    on_wires: ClassVar = ("natnet", "qtm", "text")

    driver: Literal["mock", "natnet", "qtm", "text"]
    """`natnet`: OptiTrack Motive, NatNet 3.0 to 4.x; `qtm`: Qualisys RT protocol; `text`: datagrams of one body."""
    host: str = "127.0.0.1"
    """Address of the computer with Motive or QTM; of `text` that of this computer."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Port of commands, by default 1510 or 22223; of `text` the UDP port that receives."""
    local: str = "0.0.0.0"
    """Address of this computer in the network of the cameras, for NatNet by multicast."""
    frames: str = "hil"
    """Of `text`: frames of poses or of points, `hil`, `euler-mm` or the path of a frame file."""
    chaser: TrackedBody
    target: TrackedBody | None = None
    reference: TrackedBody | None = None
    """A body on the floor, by which a moved bench is distinguished from a moved tracker."""
    frame: TrackerFrame | None = None
    sigma_m: Positive = 0.0002
    """Standard deviation of a position of the tracker, per axis."""
    sigma_deg: Positive = 0.02
    """The same of an attitude."""
    bench_sigma_m: NotNegative = 0.0003
    """What the bench's own pose is worth, per axis, if no `bench.geometry_file` gives it."""
    bench_sigma_deg: NotNegative = 0.02
    """The same of its attitude."""
    bound_sigmas: Annotated[float, Field(ge=3.0, le=20.0)] = 5.0
    """Difference of encoders and tracker, in sigmas of both, beyond which the bench is held."""
    gate_m: Positive = 0.05
    """A single sample farther off is rejected; half a second of them counts."""
    gate_deg: Positive = 5.0
    """The same of its attitude."""
    max_age_s: Delay = 0.2
    """An older sample is rejected; longer without one raises an alarm of low priority."""
    latency_s: Delay = 0.004
    """Mock and emulated tracker: from exposure to receipt."""
    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 100.0
    """Mock and emulated tracker: samples per second."""
    clock_offset_s: float = 12.5
    """Mock and emulated tracker: lead of its clock at the time zero of the bench."""
    clock_scale: Positive = 1.0
    """Mock and emulated tracker: seconds of its clock per second."""
    faults: tuple[TrackerFault, ...] = ()

    @property
    def bodies(self) -> dict[str, TrackedBody]:
        """Bodies by their roles, in the order of ``ROLES``."""
        given = {role: getattr(self, role) for role in ROLES}
        return {role: body for role, body in given.items() if body is not None}

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, 0 for a port of the system."""
        return self.host, self.port or _PORTS.get(self.driver, 0)

    def connected(self, address: str) -> Any:
        """Return the table with the address that the emulator reports."""
        host, _, port = address.rpartition(":")
        return self.model_copy(update={"host": host, "port": int(port)})

    @model_validator(mode="after")
    def _bodies_suffice(self) -> Self:
        names = [body.body for body in self.bodies.values()]
        if len(set(names)) != len(names):
            raise ValueError(f"body: {', '.join(map(repr, names))}: must differ from each other")
        if self.driver == "text" and len(names) > 1:
            raise ValueError("target, reference: a stream of frames has one body, allowed: chaser with [tracker.frame]")
        if self.target is None and self.frame is None:
            raise ValueError("target: is missing: needed to measure the tracker's frame, unless [tracker.frame] has it")
        if self.driver == "natnet" and (texts := [name for name in names if isinstance(name, str)]):
            raise ValueError(f'body = "{texts[0]}": allowed are streaming IDs of NatNet, whole numbers')
        if self.driver == "qtm" and (numbers := [name for name in names if isinstance(name, int)]):
            raise ValueError(f"body = {numbers[0]}: allowed are names of bodies of QTM")
        return self

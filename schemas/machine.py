"""The machine file: one TOML text describes a rig.

A quantity is a number or `{ value = …, sd = … }`. A wrong file raises MachineError with one line that names
the key, the value, what is allowed and the nearest right key. schemas/machine_toml.py reads the text;
`tilth.logger.machine_file` opens the file.
"""

import string
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from tilth.schemas.bus_name import BUS_NAME
from tilth.schemas.flow import Mount
from tilth.schemas.log_settings import Log
from tilth.schemas.quantity import Exact, Inertia, Length, Placed, Taped, Weighed, quantity
from tilth.schemas.quantity import Quantity as Quantity
from tilth.schemas.section import Section as _Section
from tilth.schemas.tyre_size import tyre_size


class MachineError(Exception):
    """The machine file is wrong; the text says where and what to do."""


def _hexadecimal(raw: Any) -> int:
    if isinstance(raw, str) and len(raw) == 16 and set(raw) <= set(string.hexdigits):
        return int(raw, 16)
    raise ValueError('a NAME is written as 16 hexadecimal digits in quotes, such as "A00017000421E240"')


_HexName = Annotated[
    int,
    BeforeValidator(_hexadecimal, json_schema_input_type=Annotated[str, Field(pattern="^[0-9A-Fa-f]{16}$")]),
]
DBC_BREAK = "\f"  # a page's end: between the texts of two DBC files
_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"


class MachineName(_Section):
    name: str = Field(pattern=_NAME, description="part of every Zenoh key")


class Implements(_Section):
    """Of a tractor that pulls one of several: each has a file, with its [implement], [tyres.implement] and
    receivers, which is joined to this one (machine_toml.joined)."""

    files: list[str] = Field(min_length=1, description="relative to this one")


class Ballast(_Section):
    """A mass that its body's own mass, CG and inertia are without: weights, or what is in a tank."""

    mass: Weighed = Field(description="kg; a number alone is taken to 2 %")
    ahead_of_axle: Placed = Field(
        description="its middle ahead of the tractor's rear axle, or of the implement's axle, m; behind it "
        "negative; a number alone is taken to 5 cm"
    )
    height: Placed = Field(description="of its middle above the ground, m; a number alone is taken to 5 cm")
    length: float = Field(default=0.0, ge=0, description="how long it is fore and aft, m")
    width: float = Field(default=0.0, ge=0, description="how wide it is, m")


class Weighing(_Section):
    """A scale on the implement, whose message is a signal of a DBC file."""

    bus: str
    dbc: str = Field(description="DBC file, relative to the file that names it")
    dbc_text: str | None = Field(default=None, description="the text of that file; filled in when it is read")
    signal: str
    weighs: Literal["load", "whole"] = Field(
        default="load", description="what is carried, or the implement with what it carries"
    )
    mask: int = Field(
        default=0x1FFFFFFF, ge=0, le=0x1FFFFFFF, description="bits of the identifier that must match"
    )
    scale: float | None = Field(
        default=None, gt=0, description="kg per unit of the signal; not told: by its unit, kg, t or lb"
    )
    offset: float = Field(default=0.0, description="kg")
    not_available: int | list[int] | None = Field(
        default=None,
        description="raw value, or [lowest, highest], that means no data (as read, unsigned); not told: all "
        "bits set, of a signal without sign",
    )


class Load(Ballast):
    """What an implement carries and loses during the day: `mass` when it is full, 0 when it is empty. Mass,
    CG
    and inertia of [implement] are then those of the empty one, as the prior of its tyres is."""

    exponent: Annotated[Quantity, quantity(0.1)] = Field(
        default=Quantity(value=0.8, sd=0.15),
        description="stiffness of tyres grows with their load to this power; a number alone is taken to 0.1",
    )
    lasts: float = Field(
        default=600.0,
        gt=0,
        description="time in which it may become any other, where no scale tells it, s: a grain cart 600, a "
        "sprayer 3600",
    )
    weighing: Weighing | None = Field(
        default=None, description="a scale that a DBC file describes; PGN 65258 needs none"
    )


class Tractor(_Section):
    """Distances from the tractor's CG, m (dissertation, Table 5.1)."""

    a: Length = Field(description="CG to the front axle, m")
    b: Length = Field(description="CG to the rear axle, m")
    c: Taped = Field(description="CG to the hitch, behind, m; a number alone is taken to 2 cm")
    mass: Exact = Field(description="kg, without its ballast")
    yaw_inertia: Inertia = Field(description="kg m^2; a number alone is taken to 5 %")
    cg_height: Length = Field(description="above ground, m")
    cg_sd: float = Field(
        default=0.02, ge=0, description="of the CG's place along the body: moves a, b, c and receivers, m"
    )
    pair_yaw_sd: float = Field(
        default=0.2, ge=0, description="of the yaw of its pair of receivers as mounted, deg"
    )
    lever_sd: float | None = Field(
        default=None,
        ge=0,
        description="of how far forward the middle of its receivers is, m; else it follows from survey_sd",
    )
    kingpin_distance: float | None = Field(
        default=None, gt=0, description="between the kingpins, m; needed where the sensor sits on one of them"
    )
    ackermann: Annotated[Quantity, quantity(0.1)] = Field(
        default=Quantity(value=0.8, sd=0.3),
        description="how far the front wheels turn towards one centre: 1 as by Ackermann, 0 by equal angles",
    )
    hitch_height: Annotated[Quantity, quantity(0.03)] | None = Field(
        default=None, description="of drawbar or ball, where the implement pulls, above the ground, m"
    )
    pivot_height: Annotated[Quantity, quantity(0.03)] | None = Field(
        default=None, description="of the pin on which the front axle swings, above the ground, m"
    )
    suspended_front_axle: bool = Field(
        default=False, description="true where the front axle has springs: its pin and tilt are less certain"
    )
    front_axle_mass: Annotated[Quantity, quantity(default_share=0.1)] | None = Field(
        default=None, description="of the front axle with its wheels, kg: it does not roll with the tractor"
    )
    ballast: list[Ballast] = Field(default=[], description="what mass, CG and yaw_inertia are without")
    wheel_speed_factor: Annotated[Quantity, quantity(0.005)] | None = Field(
        default=None,
        description="wheel-based speed (PGN 65096) over ground speed at no slip; other tyres change it",
    )

    @property
    def wheelbase(self) -> float:
        """m."""
        return self.a.value + self.b.value

    @model_validator(mode="after")
    def _turning_forwards(self) -> Self:
        factor = self.wheel_speed_factor
        if factor is not None and factor.value <= 0:
            raise ValueError(f"wheel_speed_factor = {factor.value:g}: must be above zero")
        return self


class Implement(_Section):
    """Distances of the towed single-axle implement, m."""

    name: str | None = Field(
        default=None,
        pattern=_NAME,
        description="by which it is told from others; needed in a file of its own",
    )
    names: list[_HexName] = Field(
        default=[], description="64-bit NAMEs of its own control units, by which it is known when hitched on"
    )
    described: bool = Field(
        default=True,
        description="false: nobody has measured it; driving finds its lengths, within the sds of d and e, "
        "lever_sd, pair_yaw_sd and its receivers' survey_sd",
    )
    d: Taped = Field(description="hitch to its CG, m; a number alone is taken to 2 cm")
    e: Taped = Field(description="CG to the axle, behind, m; a number alone is taken to 2 cm")
    mass: Exact = Field(description="kg, without its ballast")
    yaw_inertia: Inertia = Field(description="kg m^2; a number alone is taken to 5 %")
    cg_height: Length = Field(description="above ground, m")
    cg_sd: float = Field(
        default=0.02, ge=0, description="of the CG's place along the body: moves d, e and receivers, m"
    )
    pair_yaw_sd: float = Field(
        default=0.2, ge=0, description="of the yaw of its pair of receivers as mounted, deg"
    )
    lever_sd: float | None = Field(
        default=None,
        ge=0,
        description="of how far forward the middle of its receivers is, m; else it follows from survey_sd",
    )
    ballast: list[Ballast] = Field(default=[], description="what mass, CG and yaw_inertia are without")
    working_width: float = Field(
        default=0.0, ge=0, description="of the ground that it works about its axle, m; 0: not told"
    )
    load: Load | None = Field(
        default=None, description="what it carries and loses during the day; without it, its mass stays"
    )


class Tyre(_Section):
    """Of one axle: the prior, log-normal about two values, and how its tyres hold the rig upright."""

    cornering_stiffness: float = Field(gt=0, description="whole axle, N/rad")
    relaxation_length: float = Field(gt=0, description="m")
    log_sd: float = Field(default=0.7, gt=0, description="sd of the natural logarithm of both")
    track: Taped | None = Field(
        default=None, description="between the middles of left and right tyre, of duals of the inner ones, m"
    )
    dual_track: Taped | None = Field(
        default=None, description="the same of the outer tyres of dual wheels, m; needs track"
    )
    deflection: Annotated[Quantity, quantity(default_share=0.15)] | None = Field(
        default=None,
        description="by how much the load presses the tyres in, m: free radius less the height of the hub",
    )
    size: str | None = Field(
        default=None, description="printed on the side, such as 520/85R42; with pressure, not with deflection"
    )
    pressure: float | None = Field(default=None, gt=0, description="in the tyres, bar; with size")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.size is None) != (self.pressure is None):
            raise ValueError("size and pressure go together: either alone tells nothing of the stiffness")
        if self.size is not None:
            tyre_size(self.size)
            if self.deflection is not None:
                raise ValueError("give deflection, or size and pressure: what is measured is better")
        if self.dual_track is not None and (self.track is None or self.dual_track.value <= self.track.value):
            raise ValueError("dual_track is of the outer tyres: it needs track, of the inner ones, below it")
        return self


class Tyres(_Section):
    front: Tyre
    rear: Tyre
    implement: Tyre


class Bus(_Section):
    name: str = Field(pattern=BUS_NAME)
    interface: str = Field(description="any python-can interface, mavlink among them")
    channel: str | int
    bitrate: int = Field(default=250_000, gt=0)
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further arguments of that python-can interface"
    )
    request_claims: bool = Field(
        default=False,
        description="when the bus is opened, send one frame that asks all devices for their NAMEs (PGN 59904 "
        "for 60928); else nothing is ever sent",
    )

    @model_validator(mode="after")
    def _able(self) -> Self:
        if self.request_claims and self.interface == "mavlink":
            raise ValueError("request_claims: an autopilot's bus is only listened to; leave it out")
        return self


class Receiver(_Section):
    mount: Mount
    bus: str
    name: _HexName | None = Field(default=None, description="64-bit NAME as 16 hexadecimal digits")
    source: int | None = Field(
        default=None, ge=0, le=253, description="source address where no claim is heard"
    )
    manufacturer: int | None = Field(default=None, ge=0, le=2047, description="whose source address it is")
    position: tuple[float, float, float] = Field(
        description="forward and right of that body's CG, above the ground, m"
    )
    survey_sd: float = Field(default=0.02, ge=0, description="of forward and right of its position, m")
    position_sd: float = Field(default=0.025, gt=0, description="of an RTK-fixed position, per axis, m")
    velocity_sd: float = Field(default=0.05, gt=0, description="of the velocity over ground, per axis, m/s")
    yaw_rate_sd: float = Field(default=0.3, gt=0, description="deg/s")
    heading_sd: float = Field(default=0.5, gt=0, description="of a heading the receiver reports, deg")
    roll_sd: float = Field(default=0.5, gt=0, description="deg")
    roll_zero: Annotated[Quantity, quantity()] | None = Field(
        default=None, description="what it reports when level, after roll_sign, deg; none: 0, sd 0.57"
    )
    roll_sign: Literal[1, -1] = Field(
        default=1, description="-1 where it reports the right side down as minus"
    )
    yaw_rate_sign: Literal[1, -1] = Field(default=1, description="-1 where it reports a right turn as minus")
    roll_corrected: bool = Field(
        default=False, description="true where the receiver already reports the point on the ground below it"
    )
    latency: Annotated[Quantity, quantity(0.05)] = Field(
        default=Quantity(value=0.1, sd=0.05), description="from measurement to first frame, s"
    )

    @model_validator(mode="after")
    def _someone(self) -> Self:
        if self.name is None and self.source is None:
            raise ValueError(
                'give name = "16 hexadecimal digits" or source = 0..253, so that it can be told apart'
            )
        return self


class WheelAngle(_Section):
    """A sensor as a row (id …), as a signal of a DBC file (dbc, signal), or as PGN 127245 (pgn, source)."""

    bus: str
    id: int | None = Field(default=None, ge=0, le=0x1FFFFFFF)
    mask: int = Field(default=0x1FFFFFFF, ge=0, le=0x1FFFFFFF, description="bits of id that must match")
    extended: bool = Field(default=True, description="29-bit identifier")
    dbc: str | None = Field(default=None, description="DBC file, relative to this one")
    dbc_text: str | None = Field(default=None, description="the text of that file; filled in when it is read")
    signal: str | None = None
    pgn: Literal[127245] | None = None
    source: int | None = Field(default=None, ge=0, le=253)
    instance: int | None = Field(default=None, ge=0, le=252, description="of PGN 127245")
    byte_order: Literal["big", "little"] = "little"
    start_byte: int | None = Field(default=None, ge=0, le=63)
    start_bit: int | None = Field(
        default=None,
        ge=0,
        le=511,
        description="as in a DBC file: least significant bit, or most if big endian",
    )
    bits: int = Field(default=16, ge=1, le=32)
    signed: bool = True
    scale: float = Field(
        default=1.0, description="degrees per bit; with a dbc, degrees per unit of the signal"
    )
    offset: float = Field(default=0.0, description="degrees")
    sign: Literal[1, -1] = Field(default=1, description="+1 where a right turn is positive")
    lookup: list[tuple[float, float]] | None = Field(
        default=None, description="linkage: [reading, wheel angle] in degrees, ascending, linear between"
    )
    not_available: int | list[int] | None = Field(
        default=None, description="raw value, or [lowest, highest], that means no data (as read, unsigned)"
    )
    kingpin: Literal["mean", "left", "right"] = Field(
        default="mean", description="which wheel carries the sensor"
    )
    curve: Annotated[Quantity, quantity()] = Field(
        default=Quantity(value=0.0),
        description="curvature of its linkage, 1/rad: of a reading x less zero the wheel has x + curve x^2",
    )
    zero: Annotated[Quantity, quantity(0.5)] = Field(
        default=Quantity(value=0.0, sd=0.5), description="the reading when straight, after sign, deg"
    )
    gain: Annotated[Quantity, quantity(0.02)] = Field(
        default=Quantity(value=1.0, sd=0.02),
        description="the reading over the true angle; not applied: where its estimate begins",
    )
    sd: float = Field(default=0.1, gt=0, description="white noise, deg")
    delay: float = Field(default=0.01, ge=0, description="from measurement to frame, s")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = [self.id is not None, self.dbc is not None, self.pgn is not None]
        if sum(ways) != 1:
            raise ValueError("give exactly one of id, dbc (with signal) or pgn = 127245 (with source)")
        if self.id is not None and (self.start_byte is None) == (self.start_bit is None):
            raise ValueError("a sensor given by id needs start_byte or start_bit (one of them)")
        if self.dbc is not None and self.signal is None:
            raise ValueError('a sensor given by dbc needs signal = "its name"')
        if self.pgn is not None and self.source is None:
            raise ValueError("pgn = 127245 needs source = 0..253")
        if self.gain.value <= 0:
            raise ValueError(f"gain = {self.gain.value:g}: must be above zero; sign turns it round")
        if self.lookup is not None and (
            len(self.lookup) < 2
            or any(after[0] <= before[0] for before, after in zip(self.lookup, self.lookup[1:], strict=False))
        ):
            raise ValueError("lookup needs two or more rows with ascending readings")
        return self


class Zenoh(_Section):
    prefix: str = Field(default="tilth", pattern=r"^[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$")
    listen: list[str] = Field(default=["tcp/127.0.0.1:7447"], description="Zenoh endpoints of the daemon")
    connect: list[str] = Field(default_factory=list, description="Zenoh routers to reach")
    config: str | None = Field(
        default=None,
        description="daemon.json of `tilth keys`, for a shared network: its endpoints instead of listen and "
        "connect, which are for this computer only; relative to this file",
    )
    open: bool = Field(
        default=False,
        description="true: it is meant that everybody on the network may read, mark and speak in the "
        "daemon's name, where listen, connect or config lets them in without keys",
    )
    ros: bool = Field(
        default=False,
        description="true: also publish as a node of ROS 2, for rmw_zenoh; needs the package `tilth[ros]`",
    )
    ros_domain: int = Field(default=0, ge=0, le=232, description="ROS_DOMAIN_ID of that node")
    ros_replay_domain: int = Field(
        default=100, ge=0, le=232, description="ROS_DOMAIN_ID of replays and simulations: no robot hears them"
    )

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.config is not None and self.model_fields_set & {"listen", "connect"}:
            raise ValueError("give config, or listen and connect: that file has its own endpoints")
        return self

    @model_validator(mode="after")
    def _replays_apart(self) -> Self:
        if self.ros_replay_domain == self.ros_domain:
            raise ValueError("ros_replay_domain must not be ros_domain: robots would hear replays")
        return self


class Estimation(_Section):
    two_step: bool = Field(
        default=False,
        description="also fit by the dissertation's two steps, to compare with: costs half as much as pem",
    )
    field_map: str | None = Field(
        default=None,
        description="file of what a season has told of a field, by `tilth map`: a prior of place and tracker",
    )


class Machine(_Section):
    """A whole machine file."""

    machine: MachineName
    implements: Implements | None = None
    tractor: Tractor
    implement: Implement
    tyres: Tyres
    bus: list[Bus] = Field(min_length=1)
    receiver: list[Receiver] = Field(min_length=1, max_length=4)
    wheel_angle: WheelAngle
    log: Log = Log()
    zenoh: Zenoh = Zenoh()
    estimation: Estimation = Estimation()

    @property
    def name(self) -> str:
        return self.machine.name

    @property
    def rig(self) -> str:
        """The machine and, where it has a name, the implement: what estimates belong to."""
        return f"{self.name}+{self.implement.name}" if self.implement.name else self.name

    @property
    def weighing(self) -> Weighing | None:
        return None if self.implement.load is None else self.implement.load.weighing

    @property
    def dbc_text(self) -> str | None:
        """Of the DBC files that it names, that of the wheel angle and that of the scale, as machine_toml
        reads them; None where it names none."""
        own = (self.wheel_angle.dbc_text, self.weighing and self.weighing.dbc_text)
        return DBC_BREAK.join(text or "" for text in own).rstrip(DBC_BREAK) or None

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = [bus.name for bus in self.bus]
        for twice in {name for name in names if names.count(name) > 1}:
            raise ValueError(f'bus: the name "{twice}" is used twice; each bus needs its own')
        for user, bus in [
            *((f"receiver {r.mount}", r.bus) for r in self.receiver),
            ("wheel_angle", self.wheel_angle.bus),
            *(("implement.load.weighing", scale.bus) for scale in [self.weighing] if scale is not None),
        ]:
            if bus not in names:
                raise ValueError(
                    f'{user}: bus = "{bus}" is no [[bus]] of this file; there are {", ".join(names)}'
                )
        mounts = [r.mount for r in self.receiver]
        for mount in {m for m in mounts if mounts.count(m) > 1}:
            raise ValueError(f'receiver: two of them have mount = "{mount}"; each place holds one')
        if self.wheel_angle.kingpin != "mean" and self.tractor.kingpin_distance is None:
            raise ValueError(
                "wheel_angle.kingpin: a sensor on one kingpin needs tractor.kingpin_distance in m"
            )
        self._positive_lengths()
        self._receivers_apart()
        return self

    def _positive_lengths(self) -> None:
        for body, keys in (
            ("tractor", "a b c mass yaw_inertia cg_height"),
            ("implement", "d mass yaw_inertia cg_height"),
        ):
            for key in keys.split():
                value = getattr(getattr(self, body), key).value
                if value <= 0:
                    raise ValueError(f"{body}.{key} = {value:g}: must be above zero")
            for number, ballast in enumerate(getattr(self, body).ballast, 1):
                if (value := ballast.mass.value) < 0:
                    raise ValueError(
                        f"{body}.ballast[{number}].mass = {value:g} kg: a mass is not below zero; what was "
                        f"taken off is left out, or taken off {body}.mass"
                    )
        load = self.implement.load
        if load is not None and load.mass.value <= 0:
            raise ValueError(
                f"implement.load.mass = {load.mass.value:g} kg: give what it carries when it is full, or "
                "leave out [implement.load]"
            )
        if load is not None and not 0 <= load.exponent.value <= 1.2:
            raise ValueError(
                f"implement.load.exponent = {load.exponent.value:g}: from 0, a stiffness that does not grow "
                "with the load, to 1.2; tyres have 0.6 to 1"
            )

    def _receivers_apart(self) -> None:
        identities = [(r.bus, r.name, r.source) for r in self.receiver]
        for one in identities:
            if identities.count(one) > 1:
                raise ValueError(
                    "receiver: two of them have the same bus, name and source; they cannot be told apart"
                )
        for body in ("tractor", "implement"):
            pair = [r for r in self.receiver if r.mount.body == body]
            if len(pair) == 2:
                apart = sum(
                    (p - q) ** 2 for p, q in zip(pair[0].position[:2], pair[1].position[:2], strict=True)
                )
                if apart < 0.25:
                    raise ValueError(
                        f"receiver: the two on the {body} are less than 0.5 m apart; no heading from that"
                    )

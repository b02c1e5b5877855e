"""Drafts a machine file from a survey of buses: it parses once every line marked FILL IN is filled in."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from tilth.replay.discover import BusDevice, Findings
from tilth.replay.turn_rates import in_words
from tilth.replay.wheel_search import WheelCandidate
from tilth.schemas.flow import Mount
from tilth.schemas.invocation import command
from tilth.schemas.machine import Bus
from tilth.schemas.quantity import Quantity
from tilth.schemas.rule_of_thumb import DRAWING
from tilth.schemas.wheel_angle import RUDDER

Measured = Mapping[str, Mapping[str, Quantity]]
"""Section -> key -> value."""
FILL_IN = "# FILL IN"
DEERE = 33
MOST_RECEIVERS = 4

_HEAD = f"""\
[machine]
name = {FILL_IN}: a name in quotes; letters, digits, - and _

[tractor]                         # distances from its CG; any quantity may be {{ value = …, sd = … }}
a = {FILL_IN}: to the front axle, m
b = {FILL_IN}: to the rear axle, m
c = {FILL_IN}: to the hitch, behind, m
mass = {FILL_IN}: kg, as driven, with ballast that has no entry of its own
yaw_inertia = {FILL_IN}: kg m^2
cg_height = {FILL_IN}: above the ground, m
# hitch_height = 0.5                # of drawbar or ball above the ground, m
# pivot_height = 0.7                # of the pin on which the front axle swings, above the ground, m
# suspended_front_axle = true       # where it has springs
# front_axle_mass = 650             # of the front axle with its wheels, kg
# [[tractor.ballast]]               # once for each: what mass, CG and yaw_inertia above are without
# mass = 600                        # kg
# ahead_of_axle = 4.1               # its middle ahead of the rear axle, behind it negative, m
# height = 0.9                      # above the ground, m

[implement]
d = {FILL_IN}: hitch to its CG, m
e = {FILL_IN}: CG to the axle, behind, m
mass = {FILL_IN}: kg, as loaded, but for what has an entry of its own
yaw_inertia = {FILL_IN}: kg m^2
cg_height = {FILL_IN}: above the ground, m
# [[implement.ballast]]             # such as what is in a tank
# mass = {{ value = 6000, sd = 300 }} # kg
# ahead_of_axle = 0.3               # its middle ahead of the implement's axle, m
# height = 1.6                      # above the ground, m
# length = 3.5                      # how long it is, m, and
# width = 2.0                       # how wide

# Priors of whole axles: these are of a 150 kW tractor with a grain cart. Their size has to be right, no more.
# Take off the # of the lines below them and give your own: they tell how far the rig leans in a turn, without
# which stiffnesses and lengths are less certain. Deflection: a free tyre's radius less the height of its hub.
"""
_STANDING = """\
# track = 1.93                      # between the middles of both tyres, of duals of the inner ones, m
# dual_track = 3.05                 # the same of the outer tyres of dual wheels, m
# deflection = 0.06                 # by how much the load presses the tyres in, m; or instead of it:
# size = "520/85R42"                # as printed on the tyre,
# pressure = 1.2                    # and what is in it, bar
"""
_PRIORS = (("front", 220e3, 1.1), ("rear", 486e3, 1.5), ("implement", 167e3, 1.1))


def draft(findings: Findings, buses: Sequence[Bus], measured: Measured | None = None) -> str:
    """The text. buses: as they were opened; those of a log are left to be filled in. measured: keys of the
    rig that follow from scale and tape."""
    opened = {bus.name: bus for bus in buses}
    headline = f'# A draft by `{command("discover")}`. Every line with "FILL IN" needs a value; then: '
    parts = [f"{headline}{command('check', 'THIS_FILE')}\n{_drawing()}", _filled(_HEAD, measured or {})]
    for axle, stiffness, length in _PRIORS:
        parts.append(
            f"[tyres.{axle}]\n"
            f"cornering_stiffness = {stiffness:g}      # N/rad\n"
            f"relaxation_length = {length:g}            # m\n"
            "log_sd = 0.7\n" + _STANDING
        )
    parts += [_bus(name, opened.get(name)) for name in findings.buses or tuple(opened)]
    parts += _receivers(findings)
    parts.append(_wheel_angle(findings))
    return "\n".join(parts)


def _drawing() -> str:
    """How a to e are measured, as comments."""
    lines = [
        *DRAWING.splitlines(),
        f"`{command('discover', '--help')}`: --scale and --tape find them by weighing",
    ]
    return "".join(f"# {line}\n" for line in lines)


def _filled(text: str, measured: Measured) -> str:
    """The text with the values of its sections that are known."""
    return filled_in(text, {
        section: {
            key: (toml_quantity(found), "by rule of thumb" if key == "yaw_inertia" else "by scale and tape")
            for key, found in keys.items()
        }
        for section, keys in measured.items()
    })  # fmt: skip


def toml_quantity(quantity: Quantity) -> str:
    return f"{{ value = {quantity.value:.10g}, sd = {quantity.sd:.10g} }}"


def filled_in(text: str, values: Mapping[str, Mapping[str, tuple[str, str]]]) -> str:
    """A draft with the values of some keys: section -> key -> (TOML, how it is known). A key without TOML is
    left out. Of the second [[receiver]] the section is receiver.1."""
    section, lines, counts = "", [], Counter[str]()
    for line in text.splitlines():
        if line.startswith("["):
            section = line.strip("[").partition("]")[0]
            counts[section] += 1
            section += f".{counts[section] - 1}" if line.startswith("[[") else ""
        key, equals, rest = line.partition(" = ")
        if equals and (found := values.get(section, {}).get(key)) is not None:
            toml, how = found
            if not toml:
                continue
            what = rest.partition(f"{FILL_IN}: ")[2]
            told = ", ".join(part for part in (what, how) if part)
            line = f"{key} = {toml}" + (f"  # {told}" if told else "")
        lines.append(line)
    return "\n".join(lines) + "\n"


def _bus(name: str, bus: Bus | None) -> str:
    lines = ["[[bus]]", f'name = "{name}"']
    if bus is None:
        lines.append(f'interface = {FILL_IN}: "socketcan" or another interface of python-can')
        lines.append(f'channel = {FILL_IN}: such as "can0"')
        lines.append("bitrate = 250000")
    else:
        channel = bus.channel if isinstance(bus.channel, int) else toml_text(bus.channel)
        lines += [
            f"interface = {toml_text(bus.interface)}",
            f"channel = {channel}",
            f"bitrate = {bus.bitrate}",
        ]
        if bus.options:
            lines.append(
                f"options = {{ {', '.join(f'{toml_text(k)} = {_toml(v)}' for k, v in bus.options.items())} }}"
            )
    return "\n".join(lines) + "\n"


def _toml(value: str | int | float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return toml_text(value) if isinstance(value, str) else repr(value)


def toml_text(text: str) -> str:
    """As a TOML string; JSON escapes what TOML wants escaped, but for the last of the control characters."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _receivers(findings: Findings) -> Iterator[str]:
    usable = [source for source in findings.receivers if source.positions]
    silent = [source for source in findings.receivers if not source.positions]
    for source in usable[:MOST_RECEIVERS]:
        yield _receiver(source)
    for source in [*usable[MOST_RECEIVERS:], *silent]:
        why = "also sends positions" if source.positions else 'sends positions, all "not available"'
        yield f"# Source {source.source} on {source.bus}, {_who(source)}, {why}.\n"
    if not usable:
        yield _receiver(None)


def _receiver(source: BusDevice | None) -> str:
    lines = ["[[receiver]]" + (f"  # {_who(source)}, heard from address {source.source}" if source else "")]
    lines.append(f"mount = {FILL_IN}: one of " + ", ".join(f'"{mount}"' for mount in Mount))
    if source is None:
        lines += [
            f"bus = {FILL_IN}: name of its [[bus]], in quotes",
            f"source = {FILL_IN}: its address, or name",
        ]
    elif source.shares_name and source.name is not None:
        why = f"two devices claim NAME {source.name:016X}: it identifies neither"
        lines += [f'bus = "{source.bus}"', f"source = {source.source}  # {why}"]
        lines.append(f"manufacturer = {source.manufacturer}")
    elif source.name is not None:
        lines += [f'bus = "{source.bus}"', f'name = "{source.name:016X}"']
    else:
        lines += [f'bus = "{source.bus}"', f"source = {source.source}  # no address claim was heard"]
        lines.append(f"manufacturer = {FILL_IN}: code of its maker, John Deere 33, Trimble 98, Topcon 231, …")
    if source is not None and source.turn_rate_lag is not None:
        lines.append(f"# {in_words(source.turn_rate_lag)}")
    lines.append(f"position = {FILL_IN}: [forward, right] of that body's CG and height above the ground, m")
    deere = source is not None and source.manufacturer == DEERE
    hint = "John Deere's usually does: see its display" if deere else "true where it does: see its settings"
    lines.append(f"roll_corrected = {str(deere).lower()}  # reports the point on the ground? {hint}")
    return "\n".join(lines) + "\n"


def _who(source: BusDevice) -> str:
    if source.manufacturer is None:
        return "maker unknown"
    return source.manufacturer_name or f"manufacturer {source.manufacturer}"


def _wheel_angle(findings: Findings) -> str:
    best = findings.wheel_angles[0] if findings.wheel_angles else None
    others = "".join(f"# May be it, too: {described(c)}\n" for c in findings.wheel_angles[1:4])
    if best is None:
        return (
            "# No word was seen that moves as a wheel angle does: turn the wheel while listening.\n"
            f"[wheel_angle]\nbus = {FILL_IN}: name of its [[bus]], in quotes\n"
            f'id = {FILL_IN}: identifier, such as 0x18FF0B15\nbyte_order = {FILL_IN}: "big" or "little"\n'
            f"start_byte = {FILL_IN}: from 0\nscale = {FILL_IN}: degrees per bit\n"
        )
    if best.pgn == RUDDER:
        lines = [f"# {described(best)}", "[wheel_angle]", f'bus = "{best.bus}"', "pgn = 127245"]
        return others + "\n".join([*lines, f"source = {best.can_id & 0xFF}", *_ending(best)])
    mark = "" if best.likely else f"  {FILL_IN}, or leave it: moves smoothly, but {_doubt(best)}"
    lines = [
        f"# {described(best)}",
        "[wheel_angle]",
        f'bus = "{best.bus}"',
        f"id = 0x{best.can_id:X}{mark}",
        *([] if best.extended else ["extended = false"]),
        f'byte_order = "{best.byte_order}"',
        f"start_byte = {best.start_byte}",
        "bits = 16",
        f"signed = {str(best.signed).lower()}",
        f"scale = {FILL_IN}: degrees per bit; the word went from {best.lowest} to {best.highest}",
        *([] if best.signed else [f"offset = {FILL_IN}: degrees, so that straight ahead is 0"]),
    ]
    return others + "\n".join([*lines, *_ending(best)])


def _ending(candidate: WheelCandidate) -> list[str]:
    known = candidate.yaw_correlation is not None and abs(candidate.yaw_correlation) > 0.5
    sign = -1 if known and (candidate.yaw_correlation or 0.0) < 0 else 1
    hint = "as the yaw rate says" if known else "turn the wheel right: must come out positive"
    return [f"sign = {sign}  # {hint}", "zero = { value = 0.0, sd = 0.5 }  # degrees when straight", ""]


def _doubt(candidate: WheelCandidate) -> str:
    if candidate.yaw_correlation is None:
        return "no turn was driven that would show whether it follows the yaw rate"
    return (
        f"follows the yaw rate by {abs(candidate.yaw_correlation):.0%} only; turn to both sides at one speed"
    )


def described(candidate: WheelCandidate) -> str:
    """One line for a person."""
    c = candidate
    follows = "no turn to compare with"
    if c.yaw_correlation is not None:
        follows = f"correlation with the yaw rate {c.yaw_correlation:+.2f}"
    return (
        f"0x{c.can_id:X} on {c.bus}, byte {c.start_byte}, {c.byte_order} endian: "
        f"{c.per_s:.0f}/s, {c.lowest} to {c.highest}, {follows}"
    )

"""The measured frequency response beside those of models.

response: what a measured response is, made plain by `document.plain`: {"outputs": [p], "hz": [f], "value":
{"re", "im"} [f][p], "band": {"gain_low", "gain_high", "phase_half"} [f][p], "coherence" [f][p], "excited" [f]
or absent, "curves": [{"name", "response": {"re", "im"}, "sentence"}], "speed", "segments", "segment_s",
"notes": […], "reason": "" or why there is nothing, "loop": {"sentence"} or
absent}. Gains are rad/s or rad per rad.
"""

import cmath
import math
from collections.abc import Mapping
from typing import Any, Final

from tilth.analysis.report.document import (
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.wording import fixed, number

OUTPUTS: Final = {
    "r_t": "tractor's yaw rate", "r_i": "implement's yaw rate", "articulation": "articulation",
}  # fmt: skip
TABLE_ROWS: Final = 12  # of frequencies, evenly spread in their logarithm


def response_section(response: Mapping[str, Any] | None) -> ReportSection | None:
    """None without a response; a sentence where none could be measured."""
    if not response:
        return None
    title = "Frequency response"
    if response.get("reason") or not response.get("hz"):
        reason = response.get("reason") or "no frequency is excited"
        return ReportSection("response", title, (ReportText(f"Not measured: {reason.rstrip('.')}."),))
    data = drawn(response)
    parts: list[Part] = [ReportText(text) for text in response.get("notes") or ()]
    loop = response.get("loop") or {}
    parts += [ReportText(loop["sentence"])] if loop.get("sentence") else []
    speed = f" at {response['speed']:.2f} m/s" if response.get("speed") else ""
    for output in data["outputs"]:
        parts += [_figure(data, output, speed), _table(data, output)]
    parts += [
        ReportText(f"{one['name']}: {one['sentence']}") for one in response["curves"] if one.get("sentence")
    ]
    return ReportSection("response", title, tuple(parts))


def drawn(response: Mapping[str, Any]) -> dict[str, Any]:
    """Per output gain (dB) with its band, phase (°) with its band, coherence; the same of the models."""
    excited = response.get("excited") or [True] * len(response["hz"])
    rows = [k for k, one in enumerate(excited) if one]
    outputs = []
    for p, name in enumerate(response["outputs"]):
        value, band = response["value"], response["band"]
        phase, half = _phase(value, rows, p), [math.degrees(band["phase_half"][k][p]) for k in rows]
        outputs.append({
            "name": name,
            "gain_db": [_db(math.hypot(value["re"][k][p], value["im"][k][p])) for k in rows],
            "gain_low_db": [_db(band["gain_low"][k][p]) for k in rows],
            "gain_high_db": [_db(band["gain_high"][k][p]) for k in rows],
            "phase_deg": phase,
            "phase_half_deg": half,
            "coherence": [response["coherence"][k][p] for k in rows],
            "models": [
                {
                    "name": curve["name"],
                    "gain_db": [_db(_size(curve["response"], k, p)) for k in rows],
                    "phase_deg": _phase(curve["response"], rows, p),
                }
                for curve in response["curves"]
            ],
        })  # fmt: skip
    return {"hz": [response["hz"][k] for k in rows], "outputs": outputs}


def _size(value: Mapping[str, Any], k: int, p: int) -> float:
    return math.hypot(value["re"][k][p], value["im"][k][p])


def _db(gain: float | None) -> float | None:
    return None if gain is None or gain <= 0 else 20.0 * math.log10(gain)


def _phase(value: Mapping[str, Any], rows: list[int], p: int) -> list[float]:
    """°, without jumps."""
    found: list[float] = []
    for k in rows:
        angle = math.degrees(cmath.phase(complex(value["re"][k][p], value["im"][k][p])))
        if found:
            angle += 360.0 * round((found[-1] - angle) / 360.0)
        found.append(angle)
    return found


def _figure(data: Mapping[str, Any], output: Mapping[str, Any], speed: str) -> ReportFigure:
    what = OUTPUTS.get(output["name"], output["name"])
    models = ", ".join(one["name"] for one in output["models"])
    return ReportFigure(
        f"response-{output['name']}", "response",
        f"Response of the {what} to the wheel angle{speed}: gain, phase and coherence. Points with "
        f"95 % bands: measured. Lines: the model with parameters {models}.",
        f"Three panels over {len(data['hz'])} frequencies from {number(data['hz'][0])} to "
        f"{number(data['hz'][-1])} Hz. The table below has numbers.",
        {"hz": data["hz"], **output},
    )  # fmt: skip


def _table(data: Mapping[str, Any], output: Mapping[str, Any]) -> ReportTable:
    """Of some frequencies; all stand in the JSON."""
    hz = data["hz"]
    last = len(hz) - 1
    wanted = [hz[0] * (hz[-1] / hz[0]) ** (k / max(1, TABLE_ROWS - 1)) for k in range(TABLE_ROWS)]
    rows = sorted({min(range(last + 1), key=lambda k: abs(hz[k] - one)) for one in wanted})
    cells = tuple(
        (
            ReportCell(number(hz[k]), hz[k]),
            ReportCell(fixed(output["gain_db"][k], 1), output["gain_db"][k]),
            ReportCell(_range(output["gain_low_db"][k], output["gain_high_db"][k])),
            ReportCell(fixed(output["phase_deg"][k], 0), output["phase_deg"][k]),
            ReportCell(f"±{output['phase_half_deg'][k]:.0f}", output["phase_half_deg"][k]),
            ReportCell(fixed(output["coherence"][k], 2), output["coherence"][k]),
            *(ReportCell(fixed(model["gain_db"][k], 1), model["gain_db"][k]) for model in output["models"]),
        )
        for k in rows
    )
    columns = (
        "Hz", "gain, dB", "95 %", "phase, °", "95 %", "coherence",
        *(f"gain, {model['name']}, dB" for model in output["models"]),
    )  # fmt: skip
    what = OUTPUTS.get(output["name"], output["name"])
    caption = f"Response of the {what}, at some frequencies."
    return ReportTable(f"response-table-{output['name']}", caption, columns, cells)


def _range(low: float | None, high: float | None) -> str:
    return f"{'−∞' if low is None else f'{low:.1f}'} … {fixed(high, 1)}"

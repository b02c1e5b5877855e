"""The measured frequency response beside those of models."""

import cmath
import math
from typing import Final, TypedDict

from tilth.analysis.report.data import ComplexTable, Numbers, ResponseFacts
from tilth.analysis.report.document import (
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.wording import fixed, kmh, number

OUTPUTS: Final = {
    "r_t": "tractor's yaw rate", "r_i": "implement's yaw rate", "articulation": "articulation",
}  # fmt: skip
TABLE_ROWS: Final = 12  # of frequencies, evenly spread in their logarithm


class DrawnModel(TypedDict):
    name: str
    gain_db: Numbers
    phase_deg: list[float]


class DrawnOutput(TypedDict):
    """Of one output; low and high are the 95 % band."""

    name: str
    gain_db: Numbers
    gain_low_db: Numbers
    gain_high_db: Numbers
    phase_deg: list[float]
    phase_half_deg: list[float]
    coherence: list[float]
    models: list[DrawnModel]


class DrawnResponse(TypedDict):
    """Where the steering excites."""

    hz: list[float]
    outputs: list[DrawnOutput]


def response_section(response: ResponseFacts | None) -> ReportSection | None:
    """None without a response; a sentence where none could be measured."""
    if not response:
        return None
    title = "Frequency response"
    if response.get("reason") or not response.get("hz"):
        reason = response.get("reason") or "no frequency is excited"
        return ReportSection("response", title, (ReportText(f"Not measured: {reason.rstrip('.')}."),))
    data = drawn(response)
    parts: list[Part] = [ReportText(text) for text in response.get("notes") or ()]
    loop = response.get("loop")
    parts += [ReportText(loop["sentence"])] if loop and loop["sentence"] else []
    driven_mps = response.get("speed")
    speed = f" at {kmh(driven_mps)}" if driven_mps else ""
    for output in data["outputs"]:
        parts += [_figure(data, output, speed), _table(data, output)]
    parts += [ReportText(one["sentence"]) for one in response["curves"] if one.get("sentence")]
    return ReportSection("response", title, tuple(parts))


def drawn(response: ResponseFacts) -> DrawnResponse:
    """Per output gain (dB) with its band, phase (°) with its band, coherence; the same of the models."""
    excited = response.get("excited") or [True] * len(response["hz"])
    rows = [k for k, one in enumerate(excited) if one]
    outputs: list[DrawnOutput] = []
    for p, name in enumerate(response["outputs"]):
        value, band = response["value"], response["band"]
        phase, half = _phase(value, rows, p), [math.degrees(band["phase_half"][k][p]) for k in rows]
        outputs.append({
            "name": name,
            "gain_db": [_db(_size(value, k, p)) for k in rows],
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


def _size(value: ComplexTable, k: int, p: int) -> float:
    return math.hypot(value["re"][k][p], value["im"][k][p])


def _db(gain: float | None) -> float | None:
    return None if gain is None or gain <= 0 else 20.0 * math.log10(gain)


def _phase(value: ComplexTable, rows: list[int], p: int) -> list[float]:
    """°, without jumps."""
    found: list[float] = []
    for k in rows:
        angle = math.degrees(cmath.phase(complex(value["re"][k][p], value["im"][k][p])))
        if found:
            angle += 360.0 * round((found[-1] - angle) / 360.0)
        found.append(angle)
    return found


def _figure(data: DrawnResponse, output: DrawnOutput, speed: str) -> ReportFigure:
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


def _table(data: DrawnResponse, output: DrawnOutput) -> ReportTable:
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

"""The report of a calibration: the same kind of file as `tilth report` writes."""

import math

from tilth.analysis.calibration.run import Calibrated
from tilth.analysis.report.document import (
    WARNING,
    DriveReport,
    ReportCell,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.estimator.calibration.verdict import NOT_IDENTIFIABLE
from tilth.schemas.reasons import Reason
from tilth.schemas.sentences import sentence
from tilth.schemas.spread import plus_minus


def report_of(found: Calibrated) -> DriveReport:
    """All of it; every number is in its data."""
    parts = (_at_a_glance, _numbers, _receivers, _steering, _residuals, _soil, _file)
    sections = tuple(part(found) for part in parts)
    return DriveReport(f"Calibration of {found.machine.name}", sections, found.as_json())


def _at_a_glance(found: Calibrated) -> ReportSection:
    kind = "plain" if found.verdict.good else WARNING
    parts = [ReportText(f"{found.title}; {', '.join(found.logs)}.")]
    parts += [ReportText(f"Found: {fault.text}.", WARNING) for fault in found.faults]
    parts += [ReportText(sentence, kind) for sentence in found.verdict.sentences]
    parts += [ReportText(note) for note in found.notes]
    return ReportSection("glance", "Is it good, and why not?", tuple(parts))


def _numbers(found: Calibrated) -> ReportSection:
    rows = tuple(
        tuple(
            ReportCell(text, one.moved if k == 1 else None, one.sd if k == 1 else None)
            for k, text in enumerate(row)
        )
        for one, row in zip(found.verdict.numbers, found.rows(), strict=True)
    )
    columns = (
        "number",
        "change ± 95 %",
        "in the file",
        "sd assumed",
        "sd now",
        "sd wanted",
        "by either half",
        "status",
    )
    table = ReportTable("numbers", "What the drive told, on top of what the file said", columns, rows)
    asked = []
    for one in found.verdict.numbers:
        if one.why_not:
            verb = "is not told" if one.status == NOT_IDENTIFIABLE else "would be told better"
            asked.append(ReportText(f"{one.number.words}: {verb}; {one.why_not}."))
    return ReportSection("numbers", "Numbers", (table, *asked))


def _receivers(found: Calibrated) -> ReportSection:
    rows = []
    for one in found.receivers:
        jitter = "no standstill" if one.jitter is None else f"{one.jitter * 1e3:.0f} mm"
        per_s = "" if one.per_s is None else f"{one.per_s:.1f} Hz"
        delay, stated = (f"{s * 1e3:.0f} ms" for s in (one.latency, one.stated))
        rows.append(
            (
                ReportCell(one.mount.replace("_", " ")), ReportCell(one.name),
                ReportCell("not heard" if one.source is None else f"{one.source} on {one.bus}"),
                ReportCell(per_s, one.per_s), ReportCell(jitter, one.jitter), ReportCell(delay, one.latency),
                ReportCell(stated, one.stated),
            )
        )  # fmt: skip
    columns = ("receiver", "NAME", "address", "positions", "jitter at standstill", "latency", "by the file")
    return ReportSection(
        "receivers", "Receivers", (ReportTable("receivers", "Who sends", columns, tuple(rows)),)
    )


def _steering(found: Calibrated) -> ReportSection:
    """Not in the machine file: it is for who makes or tunes a guidance system."""
    told = found.steering
    text = ReportText(found.steering_words)
    if isinstance(told, str):
        return ReportSection("steering", "Automatic steering", (text,))
    per = math.degrees(1.0)
    rows = (
        ("dead time", plus_minus(told.dead_time, told.dead_time_sd, "s"), told.dead_time, told.dead_time_sd),
        ("time constant", plus_minus(told.time_constant, told.time_constant_sd, "s"), told.time_constant,
         told.time_constant_sd),
        ("largest rate" if told.limited else "largest rate seen",
         plus_minus(told.rate * per, told.rate_sd * per, "°/s"), told.rate, told.rate_sd),
        ("measured over commanded angle", f"{told.gain:.3f}", told.gain, None),
        ("share of the wheels' motion that this explains", f"{told.explained * 100:.1f} %", told.explained,
         None),
        ("driving that tells it", f"{told.seconds:.0f} s", told.seconds, None),
    )  # fmt: skip
    table = ReportTable(
        "steering", "How the front wheels follow the commands", ("", "found"),
        tuple((ReportCell(name), ReportCell(shown, value, sd)) for name, shown, value, sd in rows),
    )  # fmt: skip
    return ReportSection("steering", "Automatic steering", (text, table))


def _residuals(found: Calibrated) -> ReportSection:
    fit, gap, judged = found.found.fit, found.found.hitch_gap, found.verdict
    halves = f"{judged.chi2:.1f}, {judged.dof}, {judged.p:.2g}"
    rows = (
        ("driving that was used", f"{fit.seconds:.0f} s, {fit.rows} measurements", fit.seconds),
        ("innovations over their sds, rms", f"{fit.residual:.2f}", fit.residual),
        ("autocorrelation of the innovations", f"{fit.whiteness:.2f}", fit.whiteness),
        ("left out as outliers", f"{fit.outliers}", float(fit.outliers)),
        ("gap of the hitch as seen from either body, sd", f"{gap * 100:.1f} cm", gap),
        ("halves: chi-square, degrees of freedom, p", halves, judged.p),
    )  # fmt: skip
    table = ReportTable(
        "residuals", "What is left unexplained", ("", "found"),
        tuple((ReportCell(name), ReportCell(text, value)) for name, text, value in rows),
    )  # fmt: skip
    refused = [
        ReportText(f"Not used: {count * 0.2:.0f} s, {sentence(Reason(why))}.")
        for why, count in found.found.refused.items()
    ]
    return ReportSection("residuals", "Residuals", (table, _by_kind(found), *refused))


def _by_kind(found: Calibrated) -> ReportTable:
    rows = tuple(
        (ReportCell(one.kind.words), ReportCell(f"{one.ratio:.2f}", one.ratio), ReportCell(one.words))
        for one in found.found.fit.left
    )
    caption = "What is left of each kind of measurement, over the noise that the machine file states"
    return ReportTable("left", caption, ("", "times", "is that so?"), rows)


def _soil(found: Calibrated) -> ReportSection:
    rows = tuple(
        (
            ReportCell(name),
            ReportCell(f"± {196 * whole:.1f} %", whole),
            ReportCell(f"± {196 * part:.1f} %", part),
        )
        for name, (whole, part) in found.verdict.soil.items()
    )
    table = ReportTable(
        "soil", "95 % of the six by this drive, and what of it the numbers above leave open",
        ("parameter", "by this drive", "of which from the numbers"), rows,
    )  # fmt: skip
    return ReportSection("soil", "What it costs the parameters of soil and tyres", (table,))


def _file(found: Calibrated) -> ReportSection:
    lines = [line for line in found.difference(("before", "after")).splitlines() if line[:1] in "+-"][2:]
    rows = tuple((ReportCell({"+": "new", "-": "old"}[line[0]]), ReportCell(line[1:])) for line in lines)
    table = ReportTable("file", "Lines that change in the machine file", ("", "line"), rows)
    asked = [ReportText(text) for text in found.sentences() if text.startswith("Not by driving")]
    return ReportSection("file", "Machine file", (table, *asked))

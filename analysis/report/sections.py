"""All sections of a report from all of its data."""

from tilth.analysis.report.answered import response_section
from tilth.analysis.report.checked import held_out_section, residuals_section
from tilth.analysis.report.data import ReportData, RunFacts
from tilth.analysis.report.document import DriveReport, ReportSection
from tilth.analysis.report.fitted import fit_section
from tilth.analysis.report.glance import glance_section
from tilth.analysis.report.made import made_section, short_section
from tilth.analysis.report.published import nuisances_section, published_section
from tilth.analysis.report.wording import clock


def report_of(data: ReportData) -> DriveReport:
    """What is absent is left out."""
    runs = data["runs"]
    prior = runs[0]["machine"]["prior"]
    found: list[ReportSection | None] = [
        short_section(runs),
        *(_run_section(run, k, len(runs)) for k, run in enumerate(runs, 1)),
        fit_section(data.get("fit"), prior),
        held_out_section(data.get("held_out")),
        residuals_section(data.get("residuals")),
        response_section(data.get("response")),
        made_section(data),
    ]
    title = f"Drive report: {_called(runs[0])}" if len(runs) == 1 else f"Drive report: {len(runs)} runs"
    return DriveReport(title, tuple(section for section in found if section), data)


def _run_section(run: RunFacts, number: int, of: int) -> ReportSection:
    id = f"run{number}"
    sections = (glance_section(run, id), published_section(run, id), nuisances_section(run, id))
    title = f"Run {number}: {_called(run)}" if of > 1 else f"Run {run['id']}"
    return ReportSection(id, title, (), tuple(section for section in sections if section))


def _called(run: RunFacts) -> str:
    """The machine and when it drove, as people call a run; its id where its time is not known."""
    if run["start_utc_s"] is None:
        return str(run["id"])
    return f"{run['machine']['name']}, {clock(run['start_utc_s'], '%Y-%m-%d %H:%M UTC')}"

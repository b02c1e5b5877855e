# %% [markdown]
# # From a log to the parameters
#
# A drive with two steps is simulated, as a recorder would have logged it. Put a log of your own in its place.
# Cells begin with `# %%`: editors that know the percent format run them one by one.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tilth.analysis
from tilth.analysis.fit.fitting import choose, fit_all
from tilth.analysis.fit.result import as_json
from tilth.analysis.runs import segments
from tilth.analysis.validation.validate import hold_out
from tilth.cli import main
from tilth.schemas.spread import interval, of_logarithm

folder = Path(tempfile.mkdtemp(prefix="tilth-notebook-"))
scenario = folder / "two_steps.toml"
steering = "[[6.0, 0.0], [16.0, 7.0], [6.0, 0.0], [16.0, -7.0], [8.0, 0.0]]"  # s, degrees of the wheels
scenario.write_text(f"seconds = 52.0\nspeed = 4.5\nsteering = {steering}\n")
log = folder / "two_steps.mcap"
main(["simulate", str(scenario), "--seed", "3", "--out", str(log)])

# %% [markdown]
# ## What was driven

# %%
(run,) = tilth.analysis.open(log)
print(f"{run.duration_s:.0f} s, machine {run.machine.name}")
for segment in segments.find(run.poses):
    told = ", ".join(segments.tells(segment, run.poses, run.machine))
    print(f"{segment.kind:8} {segment.start_s:5.1f} to {segment.end_s:5.1f} s; at best: {told or 'nothing'}")

# %% [markdown]
# ## The six parameters, of each step and of both

# %%
fitted = fit_all(choose([run]))
answer = as_json(fitted)
joint, agreement = answer["joint"], answer["agreement"]
assert joint and agreement
for name, row in joint["parameters"].items():
    each = [one["parameters"][name]["value"] for one in answer["runs"]]
    said = of_logarithm(row["value"], row["sd"]) if row["value"] and row["sd"] else row["reason"]
    print(f"{name:8} {said}   each: {', '.join('-' if v is None else f'{v:.4g}' for v in each)}")
print(agreement["sentence"])

# %% [markdown]
# ## Do they predict what was not fitted?
#
# Root mean square distance over 30 s, in metres; a star marks runs that were not fitted.

# %%
ids = [wanted.id for wanted in fitted.wanted]
for subset in hold_out(fitted):
    by = "+".join(str(ids.index(id) + 1) for id in subset.fitted) or "machine file"
    cells = [f"{cell.tractor_m:5.2f}{'*' if cell.held_out else ' '}" for cell in subset.cells]
    print(f"{by:14} {'  '.join(cells)}")

# %% [markdown]
# ## The drive, and what the two steps tell
#
# Above the wheel angle and both yaw rates; below each step's stiffnesses with their 95 % intervals, and those
# of both together.

# %%
figure, (drive, fits) = plt.subplots(2, figsize=(7, 5), num="drive", layout="constrained")
figure.suptitle("Two steps, and the stiffnesses that they tell")
for column in ("wheel_angle_rad", "tractor_yaw_rate_radps", "implement_yaw_rate_radps"):
    drive.plot(
        run.poses.t_s, np.degrees(run.poses[column]), label=column.rpartition("_")[0].replace("_", " ")
    )
drive.set(xlabel="time, s", ylabel="° and °/s")
drive.legend()
fitted_ones = [*((one["id"], one["parameters"]) for one in answer["runs"]), ("both", joint["parameters"])]
for k, (label, parameters) in enumerate(fitted_ones):
    rows = [parameters[name] for name in ("C_af", "C_ar", "C_ai")]
    values = np.array([row["value"] or np.nan for row in rows]) / 1e3
    sds = np.array([row["sd"] or np.nan for row in rows]) / 1e3
    low, high = np.transpose([interval(*one) for one in zip(values, sds / values, strict=True)])
    ends = [values - low, high - values]
    fits.errorbar(np.arange(3) + 0.1 * (k - 1), values, ends, fmt="o", capsize=3, label=label)
fits.set(xticks=range(3), xticklabels=("C_af", "C_ar", "C_ai"), ylabel="kN/rad")
fits.legend(title="step")

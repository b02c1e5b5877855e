# %% [markdown]
# # From parameters to a controller's gains
#
# What a fit or a live estimate says of the soil goes into the model, and the model into the gains of a linear
# quadratic regulator (dissertation, chapter 5). Here with parameters as `tilth fit --json` gives them.

# %%
from importlib import resources

import matplotlib.pyplot as plt
import numpy as np

from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import system
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.models.regulator import closed_loop, regulator
from tilth.logger.machine_file import read_machine

machines = resources.files("tilth.deploy") / "machines"
with resources.as_file(machines / "jd7930-parker500.toml") as path:
    machine = read_machine(path).machine

estimated = {"C_af": (92e3, 4e3), "C_ar": (576e3, 26e3), "C_ai": (68e3, 3e3)}  # N/rad: value, sd
estimated |= {"sigma_f": (1.48, 0.34), "sigma_r": (1.92, 0.29), "sigma_i": (1.10, 0.45)}  # m
assumed = rig_of(machine)
learned = assumed._replace(**{name: value for name, (value, _) in estimated.items()})

# %% [markdown]
# ## Gains for the soil that was assumed, and for the one that was found

# %%
model = model_named("relaxation")
SPEED = 4.5  # m/s
rigs = {"assumed": assumed, "learned": learned}
gains = {name: regulator(system(model, rig, SPEED)) for name, rig in rigs.items()}
states = system(model, learned, SPEED).states
for k, state in enumerate(states):
    print(f"{state:10} {gains['assumed'].gain[k]:9.4f} {gains['learned'].gain[k]:9.4f}")

# %% [markdown]
# ## What the wrong gains cost on the real soil
#
# The slowest and the least damped poles of the loop that the regulator closes.

# %%
for name, made in gains.items():
    poles = np.linalg.eigvals(closed_loop(system(model, learned, SPEED), made.gain))
    damping = np.min(-poles.real / np.abs(poles))
    print(f"gains for the {name} soil: slowest {np.max(poles.real):.2f} rad/s, least damping {damping:.2f}")

# %% [markdown]
# ## Do the intervals matter?
#
# Draws from what is known of the soil, each with the gains of the estimate. A controller that must be stable
# for all of them looks at the worst.

# %%
rng = np.random.default_rng(1)
worst, all_poles = -np.inf, []
for _ in range(200):
    drawn = {name: value * np.exp(sd / value * rng.normal()) for name, (value, sd) in estimated.items()}
    loop = closed_loop(system(model, assumed._replace(**drawn), SPEED), gains["learned"].gain)
    all_poles.append(np.linalg.eigvals(loop))
    worst = max(worst, float(np.max(all_poles[-1].real)))
print(f"slowest pole of 200 draws: {worst:.2f} rad/s" + ("" if worst < 0 else "; not stable for all"))

# %%
figure, axes = plt.subplots(figsize=(7, 4), num="poles", layout="constrained")
figure.suptitle("Poles of the closed loop over what is known of the soil")
drawn_poles = np.concatenate(all_poles)
axes.plot(np.real(drawn_poles), np.imag(drawn_poles), ".", markersize=2, label="200 draws", rasterized=True)
for name, made in gains.items():
    poles = np.linalg.eigvals(closed_loop(system(model, learned, SPEED), made.gain))
    axes.plot(poles.real, poles.imag, "x", label=f"the estimate, gains for the {name} soil")
axes.axvline(0.0, color="gray", linewidth=0.8)
axes.set(xlabel="real part, 1/s", ylabel="imaginary part, 1/s", xlim=(-6.0, 0.5))
axes.legend(loc="upper left")

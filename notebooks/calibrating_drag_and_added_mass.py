# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Calibrating drag and added mass
#
# The head of a robot is clamped in a tank. A force sensor measures thrust and recoil. Two pressure
# sensors measure the pressures of the front and the rear chamber. A camera measures the position of
# the tail's tip. This tutorial identifies the drag coefficient C_d and the added-mass coefficient
# m_a from these data. The tutorial also computes the uncertainty of both coefficients.
#
# To use your own data, set the environment variable `SLIDER_EXPERIMENT` to the path of your
# experiment.toml. The CSV files of the trials must be in the same folder. Without this variable,
# the notebook simulates a tank with known coefficients. The simulated sensors have noise, and the
# gain of the force sensor differs by about one percent between the trials. The calibration does not
# use the known coefficients.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import slider_jax as sj
from calibration.identification.identify import identify_parameters, parameter_table
from calibration.inference.uncertainty import confidence_interval, correlations, determined
from calibration.model.plan import Resolution
from slider_jax.experiment import load as experiments

sj.enable_float64()

own = os.environ.get("SLIDER_EXPERIMENT")
truth = {"C_d": 3.1, "m_a": 0.72, "k": 0.075, "K_Q": 4.6e-7}
if own:
    path, mesh = Path(own), Resolution(101, 200, 2.0e-3)
else:
    from calibration.measurements.synthetic import Truth, random_trials, write_tank

    runs = [run | {"duration": 1.0} for run in random_trials(5, count=6)[2:]]
    made = {"nodes": 41, "step": 1e-3, "scheme": "sdirk2"}
    path = write_tank(Path("tank"), Truth(truth, {}), runs, seed=1, numerics=made)
    mesh = Resolution(31, 80, 4.0e-3)
tank = experiments.load(path)
for trial in tank.trials:
    print(
        f"{trial.file}: {trial.frequency:g} Hz, {1e-3 * trial.amplitude:g} kPa, phase "
        f"{trial.phase:g}, towed at {trial.tow_speed:g} m/s"
    )

# %% [markdown]
# ## All channels together
#
# C_d and m_a determine the forces of the water. These forces also depend on how far the body bends,
# and on the pressures in the chambers. K_Q, the moment per unit pressure, determines how far the
# body bends. The time constant k determines how fast the pressures follow their set pressures. The
# calibration therefore fits all four parameters together, to all channels of all trials. The
# derivatives of the simulation are forward-mode derivatives.

# %%
found = identify_parameters(tank, progress=print, fine=mesh, coarse=mesh)
print(parameter_table(found))

# %%
shown = int(np.argmax([len(r.t) for r in found.problem.records]))
record = found.problem.records[shown]
row = record.row("thrust")
here = record.t < 4.0 / (record.trial.frequency or 1.0)
figure, axes = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, layout="constrained")
axes[0].plot(record.t[here], record.values[row][here], ".", ms=2, color="0.6", label="measured")
for y, label, colour in (
    (found.before[shown], "before", "C1"),
    (found.fit.predicted[shown], "calibrated", "C0"),
):
    axes[0].plot(record.t[here], y[row][here], color=colour, lw=1, label=label)
    axes[1].plot(record.t[here], (record.values[row] - y[row])[here], color=colour, lw=0.8)
axes[0].set_ylabel("thrust (N)")
axes[1].set(ylabel="measured - model (N)", xlabel="time (s)")
axes[0].legend(fontsize="small")
plt.show()

# %% [markdown]
# In the upper plot, "before" is the simulation with the initial parameters, and "calibrated" is the
# simulation with the fitted parameters. The tare (offset) and the gain of each sensor differ from
# trial to trial. The calibration does not fit tares and gains, but treats them as noise that is
# correlated in time. A constant shift of the residual is therefore no sign of a wrong model.
#
# ## Uncertainty
#
# The drag and the added-mass force both act normal to the body, but with a phase difference of a
# quarter of a stride. The drag depends on the velocity of the crossflow. The added-mass force
# depends on the acceleration of the crossflow. The data can therefore discriminate between C_d and
# m_a. The ellipse shows the 95 % confidence region from the noise alone. The cross shows the
# reported 95 % intervals. These intervals also include the discretisation error of the model.

# %%
labels = [p.label for p in found.entries]
pair = [labels.index("C_d"), labels.index("m_a")]
cov = found.fit.covariance[np.ix_(pair, pair)]
centre = found.fit.theta[pair]
values, vectors = np.linalg.eigh(cov)
turn = np.linspace(0.0, 2.0 * np.pi, 200)
ellipse = np.sqrt(5.99 * values) * np.stack([np.cos(turn), np.sin(turn)], axis=1) @ vectors.T
figure, ax = plt.subplots(figsize=(4.6, 3.8), layout="constrained")
ax.plot(*(centre + ellipse).T, label="noise, 95 %")
ax.plot(*centre, "C0o", ms=4)
low_high = np.array([confidence_interval(found.fit, found.entries, i)[1:] for i in pair])
ax.errorbar(
    *centre[:, None],
    xerr=np.abs(low_high[0] - centre[0])[:, None],
    yerr=np.abs(low_high[1] - centre[1])[:, None],
    color="0.5",
    lw=1,
    label="interval, with discretisation",
)
if not own:
    ax.plot(truth["C_d"], truth["m_a"], "k*", label="true value")
ax.set(xlabel="C_d (-)", ylabel="m_a (-)")
ax.legend(fontsize="small")
plt.show()
print(f"correlation of C_d and m_a: {correlations(found.fit)[pair[0], pair[1]]:.2f}")

# %% [markdown]
# ## From thrust alone
#
# This fit uses only the thrust. The wider intervals show that the thrust alone contains less
# information than all channels.

# %%
alone = identify_parameters(
    tank, channels=("thrust",), progress=lambda text: None, fine=mesh, coarse=mesh
)
print(parameter_table(alone))
wider = {}
for i, label in enumerate(labels):
    _, low, high = confidence_interval(alone.fit, alone.entries, i)
    _, least, most = confidence_interval(found.fit, found.entries, i)
    wider[label] = (high - low) / (most - least)
    note = "" if determined(alone.entries[i], low, high) else ", not determined"
    print(f"{label}: interval {wider[label]:.1f} times as wide as with all channels{note}")

# %% [markdown]
# ## Prediction
#
# The plot compares the measured mean thrust of each trial with the mean thrust of the calibrated
# model. The means exclude the first stride.

# %%
means = []
for r, y in zip(found.problem.records, found.fit.predicted, strict=True):
    late = r.there("thrust") & (r.t > 1.0 / (r.trial.frequency or 1.0))
    means.append((r.trial.frequency or 0.0, r.values[row][late].mean(), y[row][late].mean()))
frequency, measured, predicted = np.array(sorted(means)).T
figure, ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")
ax.errorbar(frequency, measured, 2.0 * tank.sensors.force_tare, fmt="ko", ms=4, label="measured")
ax.plot(frequency, predicted, "C0x-", label="calibrated")
ax.set(xlabel="drive frequency (Hz)", ylabel="mean thrust (N)")
ax.legend(fontsize="small")
plt.show()
worst = 1e3 * np.abs(measured - predicted).max()
print(f"largest difference {worst:.0f} mN, including the errors of tare and gain")

# %% [markdown]
# The command `slider calibrate EXPERIMENT.toml --out DIR` makes the same calibration. The command
# writes a model file that you can use with `slider simulate --model`. With the option
# `--per-frequency`, the command also tests whether the coefficients depend on the frequency. If the
# residual exceeds the noise, the model lacks a physical effect. `slider close-loop` searches for
# this effect.

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
# # Tracing the valve
#
# The firmware of the rig regulates the pressure p of a chamber and writes p to a log. The paper
# models the regulated pressure as a first-order lag behind the set pressure p_set: dp/dt = (p_set -
# p)/k, with the time constant k = 87 ms. This tutorial compares this lag with pressure logs and
# examines the residual. The function behind `slider close-loop`, called "the loop" below, then
# identifies the effect that the lag lacks. The last steps test the result on logs that the fit did
# not use.
#
# The logs of the real rig are public (GitHub repository bvanstratum/SoftSnakePressureControl, sweep
# of 2022-12-21). These files are not part of this repository. To use the files, put them into the
# folder `$SLIDER_DATA/manifold`. Without the files, the notebook simulates the logs of a chamber
# with known valves. The output on this page is from simulated logs.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import slider_jax as sj
from calibration.pressure_logs.close_loop import close_loop_on_logs, thrust_change
from calibration.pressure_logs.read import PA_PER_PSI, psi, read_log
from calibration.pressure_logs.synthetic import write_logs

sj.enable_float64()

home = Path(os.environ.get("SLIDER_DATA", "../shared/data"))
paths = sorted((home / "manifold").glob("*.txt"))
real = bool(paths)
if not real:
    print(f"no logs in {home / 'manifold'}: simulated logs replace them")
    paths = write_logs(Path("made_logs"), cycles=2.0)
logs = sorted((read_log(path) for path in paths), key=lambda log: log.frequency)
print(", ".join(f"{log.frequency:.3g} Hz ({len(log.t)} samples)" for log in logs))

# %% [markdown]
# ## The lag and the measured rate
#
# Each sample of a log gives the pressure error, p_set - p, and the rate at which the pressure
# changes. If the pressure followed a lag, the rate would be proportional to the error at every
# pressure. The firmware opens a valve fully if the error exceeds 3.4 psi (25 steps of the
# analogue-to-digital converter). The plots show the rate for errors above +4 psi (filling) and
# below -4 psi (venting). At these points, a valve is fully open. Each blue circle is the mean rate
# of the samples in a small range of pressures.

# %%
filling, venting = [], []
for log in logs:
    p, step = psi(log.pressure), 5
    rate = (p[2 * step :] - p[: -2 * step]) / (2 * step * log.period)
    error = (psi(log.command) - p)[step:-step]
    middle = p[step:-step]
    filling.append(np.stack([middle, rate])[:, error > 4.0])
    venting.append(np.stack([middle, rate])[:, error < -4.0])
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for ax, parts, name in zip(axes, (filling, venting), ("filling", "venting"), strict=True):
    x, y = np.concatenate(parts, axis=1)
    ax.plot(x, y, ".", ms=1, color="0.7", rasterized=True)
    bins = np.linspace(x.min(), x.max(), 16)
    which = np.digitize(x, bins)
    means = [
        (x[which == i].mean(), y[which == i].mean())
        for i in range(1, 16)
        if (which == i).sum() > 20
    ]
    ax.plot(*np.array(means).T, "o-", color="C0")
    ax.set(title=f"{name}, valve wide open", xlabel="pressure (psi)", ylabel="rate (psi/s)")
axes[1].axline((0.0, 0.0), slope=-1.4, color="C3", ls=":", lw=1)
axes[1].axline((-14.7, 0.0), slope=-1.4, color="C3", ls="--", lw=1)
plt.show()

# %% [markdown]
# The rate depends on the pressure and not on the error. A lag therefore cannot describe these
# valves. While the chamber vents, the rate is proportional to the absolute pressure: a line through
# the data reaches zero near a gauge pressure of -14.7 psi, which is a vacuum. The dashed line has
# this property. The dotted line is proportional to the gauge pressure and does not fit. The vent
# valve therefore acts as a choked orifice. While the chamber fills, the rate decreases as the
# pressure approaches the supply pressure.
#
# ## The result of the loop
#
# The loop receives the logs and a list of candidate effects. To save time, this notebook uses four
# candidates. The loop orders the logs by frequency and holds out every second log. The command
# `slider close-loop logs/*.txt --out DIR` makes the same analysis with all effects that change
# the pressure in a log, and writes a report.
#
# The bar chart after the next two cells compares the fits. Each bar is the mean square of the
# whitened residual, which is the residual in units of its noise. A value near 1 means that the
# residual is at the noise floor.

# %%
candidates = (
    "firmware_valves", "pulsed_valves", "choked_flow", "pressure_ripple",
)  # fmt: skip
outcome = close_loop_on_logs(logs, candidates, progress=print)
print(outcome.verdict, outcome.search.effects)

# %%
first = outcome.search.rounds[0]
refits = sorted(first.refitted, key=lambda x: x.fit.square)
left = {"lag": outcome.search.base.square} | {x.name: x.fit.square for x in refits}
figure, ax = plt.subplots(figsize=(7, 2.6), layout="constrained")
ax.barh(list(left)[::-1], [x / outcome.search.base.samples for x in left.values()][::-1])
ax.set(xscale="log", xlabel="mean square over the noise (-)", ylabel="model, refitted")
plt.show()

# %% [markdown]
# ## Parameters
#
# The next cell prints the parameters of the identified model with 95 % intervals. The valve law
# replaces the lag in this model, so the time constant k has no influence on the pressure. The loop
# therefore reports that these logs do not determine k.

# %%
for i in outcome.final.free:
    p = outcome.entries[i]
    value, low, high = outcome.interval(i)
    if high - low > 0.5 * (p.prior.high - p.prior.low):
        print(f"{p.label:<28} not determined by these logs")
    else:
        print(f"{p.label:<28} {value:.4g}  ({low:.4g} to {high:.4g}) {p.prior.unit}")

# %% [markdown]
# ## Held-out logs
#
# The next cell predicts the held-out logs. The model receives only the set pressures of the log and
# the first measured sample. Such a prediction is called a free run.

# %%
errors = outcome.held_out["p_front"]
before, after, floor = (errors[key] / PA_PER_PSI for key in ("before", "after", "floor"))
print(
    f"held-out rms {before:.2f} psi with the best lag, {after:.2f} with the model found, "
    f"noise {floor:.2f}"
)

predicted = outcome.problem.predict(outcome.search.final.theta)
lagged = outcome.problem.predict(outcome.search.base.theta)
shown = [outcome.held[0], outcome.held[-2]]  # the first halves of two logs
figure, axes = plt.subplots(2, len(shown), figsize=(10, 5), sharex="col", layout="constrained")
for column, i in enumerate(shown):
    record = outcome.problem.records[i]
    here = record.t < 3.0 / record.trial.frequency
    measured = record.values[0] / PA_PER_PSI
    for series, label, colour in ((lagged, "lag", "C1"), (predicted, "found", "C0")):
        p = series[i][0] / PA_PER_PSI
        axes[0, column].plot(record.t[here], p[here], color=colour, lw=1, label=label)
        axes[1, column].plot(record.t[here], (measured - p)[here], color=colour, lw=0.8)
    axes[0, column].plot(record.t[here], measured[here], "k", lw=0.6, label="measured")
    axes[0, column].set_title(f"{record.trial.frequency:.3g} Hz, held out")
    axes[1, column].set_xlabel("time (s)")
axes[0, 0].set_ylabel("pressure (psi)")
axes[1, 0].set_ylabel("measured - free run (psi)")
axes[0, 0].legend(fontsize="small")
plt.show()

# %% [markdown]
# ## An error of the instrument
#
# The pressure sensor's analogue-to-digital converter represents each pressure by a whole number,
# its code. Over many cycles, the pressure of a chamber passes smoothly through all values.
# Neighbouring codes should therefore occur equally often. The left plot shows the density of each
# code. The density is the number of readings with this code, divided by the mean number of
# readings of the neighbouring codes. If the density varies periodically with the code, the cause is
# the instrument. The right plot shows the power spectrum of this variation against the period in
# codes.

# %%
codes = np.concatenate([log.pressure for log in logs]).astype(int)
counts = np.bincount(codes, minlength=codes.max() + 1)
low, high = np.percentile(codes, [5, 95]).astype(int)
smooth = np.convolve(counts, np.ones(65) / 65, "same")
share = (counts / np.maximum(smooth, 1.0))[low:high]
figure, axes = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
axes[0].plot(np.arange(low, high), np.convolve(share, np.ones(5) / 5, "same"), lw=1)
axes[0].set(xlabel="code (-)", ylabel="density over its mean (-)")
power = np.abs(np.fft.rfft(share - share.mean(), 4096)) ** 2
period = 1.0 / np.fft.rfftfreq(4096)[1:]
inside = (period > 4) & (period < 100)
axes[1].plot(period[inside], power[1:][inside], lw=1)
axes[1].set(xlabel="period (codes)", ylabel="power (-)")
plt.show()
print(f"strongest period {period[inside][np.argmax(power[1:][inside])]:.1f} codes")

# %% [markdown]
# The simulated logs contain no error of the converter. The period that the cell prints for
# simulated logs is therefore due to chance. In the logs of the real rig, the density has a clear
# period of about 32 codes: the weight of the converter's fifth bit, whose pattern repeats every 32
# codes, is wrong. No behaviour of a chamber can cause such a period. For this reason, the
# candidates include the effect `pressure_ripple`, a periodic error of the converter.
#
# ## Influence on the thrust
#
# The next cell simulates the built-in robot with three pressure models, driven by a square wave at
# 4.8 Hz. The models are the paper's lag, the lag that fits the logs best, and the model that the
# loop identified. The cell prints the amplitude of the pressure in the front chamber, and the mean
# thrust. The identified valves belong to the simulated logs, so the last value holds only for these
# valves.

# %%
table = thrust_change(outcome)
for name in ("lag of the paper", "lag that fits the logs best", "with the added effects"):
    x = table[name]
    print(
        f"{name:<28} {1e-3 * x['pressure_half_range_Pa']:4.0f} kPa reached, "
        f"mean thrust {1e3 * x['mean_thrust_N']:6.1f} mN"
    )

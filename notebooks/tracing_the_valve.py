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
# The rig's firmware regulates the pressure of a chamber and logs it. The paper models this as a
# lag, dp/dt = (p_set - p)/k with k = 87 ms. This tutorial compares the lag with the rig's own
# logs, examines the residual, lets the loop identify the missing effect, and tests the result on
# held-out logs.
#
# The logs are public (bvanstratum/SoftSnakePressureControl, sweep of 2022-12-21) and not part of
# this repository. Put them in `$SLIDER_DATA/manifold`. Without them, the notebook simulates logs
# of a chamber with known valves.

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
# Each sample gives the error of the pressure and the rate at which the pressure then changed. For a
# lag, the rate is proportional to the error, at every pressure. The firmware opens a valve fully if
# the error exceeds 25 codes (3.4 psi). Beyond that error, the rate is the flow of an open valve.

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
# The rate depends on the pressure, not on the error. The venting rate is proportional to the
# absolute pressure: a line through the data is zero near -14.7 psi, a vacuum, like the dashed line.
# The dotted line is a flow proportional to the gauge pressure, and does not fit. Venting is
# therefore a choked orifice. Filling slows down as the chamber approaches the supply pressure.
#
# ## The result of the loop
#
# The loop gets the logs, and as candidates the effects that a pressure log can show. Every second
# log, in order of frequency, is held out. `slider close-loop logs/*.txt --out DIR` does the same
# with all candidates, and writes a report.

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
# The parameters with 95 % intervals. The lag's k has no influence in the model found, and the loop
# reports that these logs do not determine it.

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
# Free runs: the model gets the command and the first measured sample only.

# %%
errors = outcome.held_out["p_front"]
before, after, floor = (errors[key] / PA_PER_PSI for key in ("before", "after", "floor"))
print(
    f"held-out rms {before:.2f} psi with the best lag, {after:.2f} with the model found, "
    f"noise {floor:.2f}"
)

predicted = outcome.problem.predict(outcome.search.final.theta)
lagged = outcome.problem.predict(outcome.search.base.theta)
shown = [outcome.held[0], outcome.held[-1]]
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
# Over many cycles, the pressure of a chamber passes smoothly through all values. All codes of the
# converter near one pressure should therefore be equally frequent. If their density varies, the
# cause is the instrument.

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
# On the rig's logs, the density has a period of about 32 codes: the weight of the converter's fifth
# bit is wrong. No chamber causes this. The effect `pressure_ripple`, a periodic error of the
# converter, is one of the candidates.
#
# ## Influence on the thrust
#
# The same robot with each of the pressure models, driven by a square wave at 4.8 Hz.

# %%
table = thrust_change(outcome)
for name in ("lag of the paper", "lag that fits the logs best", "with what was found"):
    x = table[name]
    print(
        f"{name:<28} {1e-3 * x['pressure_half_range_Pa']:4.0f} kPa reached, "
        f"mean thrust {1e3 * x['mean_thrust_N']:6.1f} mN"
    )

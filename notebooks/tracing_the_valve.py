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
# The rig's firmware holds a chamber at a commanded pressure and logs what it does. The paper's
# model of that is a lag, dp/dt = (p_set - p)/k with k = 87 ms. Here we hold it against the rig's
# own logs, look at what it misses, let the loop say what is missing, and check its answer on logs
# that it has not seen.
#
# The logs are public (bvanstratum/SoftSnakePressureControl, sweep of 2022-12-21) and not part of
# this repository: put them in `$SLIDER_DATA/manifold`. Without them this notebook makes logs of a
# chamber whose valves are known, so that every step can still be followed.

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
    print(f"no logs in {home / 'manifold'}: made ones take their place")
    paths = write_logs(Path("made_logs"), cycles=2.0)
logs = sorted((read_log(path) for path in paths), key=lambda log: log.frequency)
print(", ".join(f"{log.frequency:.3g} Hz ({len(log.t)} samples)" for log in logs))

# %% [markdown]
# ## What a lag would do, and what the chamber does
#
# At each sample we know the error and how fast the pressure then changed. For a lag the rate is
# proportional to the error, at every pressure alike. The firmware opens a valve fully once the
# error exceeds 25 codes (3.4 psi), so beyond that the rate says what an open valve passes.

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
# The rate depends on the pressure, not on the error. Venting goes with the absolute pressure: the
# dashed line meets zero at -14.7 psi, a vacuum, and the dotted one, a flow that goes with the gauge
# pressure, does not fit. That is a choked orifice. Filling slows as the chamber nears the supply.
#
# ## The loop's answer
#
# We could go on by hand. Instead we give the logs to the loop, with every candidate of the library
# that a pressure log could show. Every other log, in order of frequency, is held out. `slider
# close-loop logs/*.txt --out DIR` does the same, with all candidates and a report.

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
# With intervals. The lag's k has no say any more, and the loop says that these logs do not
# determine it.

# %%
for i in outcome.final.free:
    p = outcome.entries[i]
    value, low, high = outcome.interval(i)
    if high - low > 0.5 * (p.prior.high - p.prior.low):
        print(f"{p.label:<28} not determined by these logs")
    else:
        print(f"{p.label:<28} {value:.4g}  ({low:.4g} to {high:.4g}) {p.prior.unit}")

# %% [markdown]
# ## On logs that it has not seen
#
# Free runs: the model gets the first measured sample and the command, and nothing else.

# %%
hidden = outcome.held_out
before, after, floor = (
    x["p_front"] / PA_PER_PSI for x in (hidden.before, hidden.after, hidden.floor)
)
print(
    f"held-out rms {before:.2f} psi with the best lag, {after:.2f} with what was found, "
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
# ## What no pneumatics can explain
#
# A chamber passes smoothly through all pressures, so over many cycles all codes of the converter
# near a pressure should come up alike. Their density tells of the instrument.

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
# On the rig's logs the density undulates about every 32 codes: a weight of the converter's fifth
# bit is off. No chamber does that. A periodic error of the converter, `pressure_ripple`, is a
# candidate like the others.
#
# ## What it means for thrust
#
# The same robot, driven by a square wave at 4.8 Hz, with each pressure model.

# %%
table = thrust_change(outcome)
for name in ("lag of the paper", "lag that fits the logs best", "with what was found"):
    x = table[name]
    print(
        f"{name:<28} {1e-3 * x['pressure_half_range_Pa']:4.0f} kPa reached, "
        f"mean thrust {1e3 * x['mean_thrust_N']:6.1f} mN"
    )

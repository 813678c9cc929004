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
# # From a trial on the rig to a fit
#
# This tutorial drives the pneumatics, records all data, and fits the model to the recordings.
#
# To use your own rig, set three environment variables: `SLIDER_PORT` to the serial port of your
# manifold, `SLIDER_RIG` to the path of your rig file, and `SLIDER_EXPERIMENT` to the path of your
# experiment file. Without these variables, the notebook starts a simulated rig. The simulated rig
# has a manifold on a pseudo-terminal, a force sensor on the network, and a robot in a tank. The
# parameters of the simulated robot differ from the parameters in the experiment file. The fit at
# the end of this tutorial identifies the parameters of the simulated robot.

# %%
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import slider_jax as sj
from calibration.identification.identify import identify_parameters, parameter_table
from calibration.inference.uncertainty import confidence_interval
from calibration.model.plan import Resolution
from rig.cli.settings import load_rig
from rig.cli.shared import load_trials, open_rig, with_force_counts
from rig.recording.clock import fit_clock
from rig.recording.decode import decode_readings
from rig.recording.reader import read_recording
from rig.trial.session import run_trials
from slider_jax.experiment import load as experiments
from slider_jax.optimise.design_space import to_toml

sj.enable_float64()

TRIALS = """
name = "three trials"
[robot]
body_length = 0.298
tail_length = 0.07
linear_density = 0.7
EI_body = 0.038
EI_tail = 0.0058
damping_time = 0.002
height = 0.03
front_chamber = [0.02, 0.145]
rear_chamber = [0.155, 0.28]
[parameters]
C_d = 2.0
m_a = 0.5
k = 0.06
K_Q = 4.2e-7
[numerics]
nodes = 21
step = 0.002
""" + "".join(
    f"""
[[trials]]
file = "{name}.csv"
frequency = {frequency}
amplitude = {amplitude}
phase = 0.15
duration = 1.2
"""
    for name, frequency, amplitude in (
        ("slow", 2.0, 220e3),
        ("middle", 3.3, 240e3),
        ("fast", 4.8, 200e3),
    )
)
truth = {"C_d": 2.7, "m_a": 0.6, "k": 0.075, "K_Q": 4.6e-7}
own = os.environ.get("SLIDER_PORT")
if own:
    path, rig_file = Path(os.environ["SLIDER_EXPERIMENT"]), Path(os.environ["SLIDER_RIG"])
else:
    path, rig_file = Path("three_trials.toml"), Path("simulated_rig.toml")
    path.write_text(TRIALS)

# %% [markdown]
# ## On the rig
#
# Each trial begins with one second of rest. The program measures the tares and the noise of the
# sensors in this second. Then the program plays the drive of the trial. The chambers vent at the
# end of each trial, and also after an error.
#
# The notebook prints the number of readings of each trial, and how many readings were lost. The
# number in ms is the delay that 99 % of the commands did not exceed.

# %%
measured = Path("measured")
measured.mkdir(exist_ok=True)
with ExitStack() as stack:
    port = own
    if not own:
        hidden = {f"parameters.{name}": value for name, value in truth.items()}
        tank = Path("tank.toml")
        tank.write_text(to_toml(experiments.load(path).with_values(hidden), "The tank."))
        command = [sys.executable, "-m", "slider_jax.cli.main", "rig", "simulate", str(tank)]
        simulated = stack.enter_context(
            subprocess.Popen(
                [*command, "--rig-file", str(rig_file)], stdout=subprocess.PIPE, text=True
            )
        )
        stack.callback(simulated.terminate)
        port = simulated.stdout.readline().split()[1]
    settings = with_force_counts(load_rig(rig_file))
    table_of_trials, trials = load_trials(path)
    machine = stack.enter_context(open_rig(port, settings, trials[0].drive.layout))
    summaries = run_trials(trials, machine, measured, {"rig": settings.model_dump(mode="json")})
(measured / "experiment.toml").write_bytes(path.read_bytes())
for trial in summaries:
    print(
        f"{trial['trial']}: {trial['readings']} readings, {trial['readings_lost']} lost; commands "
        f"within {1e3 * trial['command_late_99_s']:.1f} ms; "
        f"{'; '.join(trial['findings']) or 'no findings'}"
    )

# %% [markdown]
# ## The recording
#
# The recording contains every received byte with its time of arrival. The next cell decodes the
# messages again and compares the clock of the manifold with the clock of the computer. A straight
# line converts times of the manifold to times of the computer. In the upper plot, a delay of zero
# means that a message arrived exactly at the time that the line predicts. Points above zero are
# messages that arrived later. The lower plot shows the recorded pressures.

# %%
stream = read_recording(measured / "recordings" / f"{trials[0].name}.h5").streams["manifold"]
found = decode_readings(zip(stream.host_ns.tolist(), stream.pieces(), strict=True))
clock = fit_clock(found.device_s, found.host_s)
late = 1e3 * (found.host_s - clock.to_host(found.device_s))
figure, axes = plt.subplots(2, 1, figsize=(9, 5), layout="constrained")
axes[0].plot(found.device_s - found.device_s[0], late, ".", ms=2)
axes[0].set(xlabel="manifold's clock (s)", ylabel="delay of arrival (ms)")
columns = np.genfromtxt(measured / f"{trials[0].name}.csv", delimiter=",", names=True)
axes[1].plot(columns["t_s"], 1e-3 * columns["p_front_Pa"], label="front")
axes[1].plot(columns["t_s"], 1e-3 * columns["p_rear_Pa"], label="rear")
axes[1].set(xlabel="time (s)", ylabel="pressure (kPa)")
axes[1].legend()
plt.show()
print(f"the manifold's clock runs {1 / clock.rate:.6f} times as fast as the computer's clock")

# %% [markdown]
# ## The fit
#
# The folder `measured` now contains an experiment file and its measured trials. The next cell fits
# four parameters of the model to these trials. The command
# `slider calibrate measured/experiment.toml --out DIR` makes the same fit on a finer mesh.

# %%
mesh = Resolution(21, 60, 4.0e-3)
fitted = identify_parameters(
    experiments.load(measured / "experiment.toml"), progress=print, fine=mesh, coarse=mesh
)
print(parameter_table(fitted))
if not own:
    for i, entry in enumerate(fitted.entries):
        value, low, high = confidence_interval(fitted.fit, fitted.entries, i)
        print(f"{entry.label}: true value {truth[entry.label]:g}, found {value:.4g}")

# %%
names = ("p_front", "p_rear", "thrust", "recoil", "tip")
figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
record = fitted.problem.records[0]
for ax, name, unit in ((axes[0], "thrust", "N"), (axes[1], "tip", "m")):
    row = names.index(name)
    ax.plot(record.t, record.values[row], ".", ms=2, color="0.6", label="measured")
    ax.plot(record.t, fitted.before[0][row], "C1", lw=1, label="before")
    ax.plot(record.t, fitted.fit.predicted[0][row], "C0", lw=1, label="fitted")
    ax.set_ylabel(f"{name} ({unit})")
    ax.set_xlabel("time (s)")
axes[0].legend(fontsize="small")
plt.show()

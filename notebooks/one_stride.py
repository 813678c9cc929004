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
# # One stride
#
# SLIDER is clamped at the head in still water and drives its two chambers 4.8 times a second. This
# tutorial follows one stride through the simulator, in the order of the computation: the pressures,
# the shape, the forces of the water along the body, and the reading of a force sensor at the clamp.
#
# All quantities are in SI units. s increases from the tail's tip (s = 0) to the head (s = L). tau
# points towards the head, and n is tau rotated by +90 degrees. The straight robot is on the x axis
# with its head at x = 0.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import slider_jax as sj
from slider_jax import observables as obs
from slider_jax.beam.state import to_plane
from slider_jax.dynamics.rollout import rollout

sj.enable_float64()

# %% [markdown]
# ## The model
#
# A model is data: the robot, a tuple of effects that act on it, the law of the pressures, the drive
# of the chambers, and the support of the head. Each part is a frozen class whose numbers are leaves
# of a JAX pytree. The paper does not state the chambers' amplitude and delay; the values here are
# assumptions.

# %%
frequency = 4.8
drag, reactive = sj.NormalDrag(C_d=3.0), sj.ReactiveForce(m_a=1.0)
model = sj.Model(
    robot=sj.Robot(),
    effects=(drag, reactive),
    pressure_law=sj.FirstOrderLag(k=0.087),
    drive=sj.Drive(
        front=sj.SquareWave(frequency, amplitude=260e3),
        rear=sj.SquareWave(frequency, amplitude=260e3, phase=0.05),
    ),
    support=sj.Clamped(),
)

# %% [markdown]
# ## The rollout
#
# A stride has a whole number of time steps, so the valves switch between steps and never within
# one. After every step, `save` gets a `Snapshot` of the system and returns the quantities to keep.
# A section holds the kinematics in the cells of the grid. An effect needs nothing else to compute
# its force per length.


# %%
def save(x):
    section = x.section()
    return {
        "pressure": x.chambers.p,
        "midline": obs.midline(x),
        "phi": section.phi,
        "drag": jnp.stack(drag.force(section)),
        "reactive": jnp.stack(reactive.force(section)),
        "thrust": obs.thrust(x),
        "recoil": obs.recoil(x),
        "power": jnp.sum(obs.chamber_power(x)),
    }


steps, strides = 200, 7
times = sj.TimeGrid.per_stride(frequency, steps, strides)
run = jax.jit(lambda model: rollout(model, times, save))(model)
assert run.ok, "a step did not converge"

last = jax.tree.map(lambda series: np.asarray(series)[-steps:], run.saved)
phase = np.arange(1, steps + 1) / steps
s = np.asarray(run.mesh.grid.s)
cells = 0.5 * (s[1:] + s[:-1])

# %% [markdown]
# ## Pressures
#
# The valves switch the set pressure between +260 and -260 kPa. The sign says which side's chamber
# is filled. The air needs time: dp/dt = (p_set - p)/k with k = 87 ms, and half a stride lasts 104
# ms. The chambers therefore reach little more than half of the set pressure.

# %%
set_pressure = {
    "front": np.where(phase <= 0.5, 260.0, -260.0),
    "rear": np.where((phase > 0.05) & (phase <= 0.55), 260.0, -260.0),
}
figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
for chamber, (ax, name) in enumerate(zip(axes, set_pressure, strict=True)):
    ax.step(phase, set_pressure[name], where="pre", color="0.6", label="set")
    ax.plot(phase, 1e-3 * last["pressure"][:, chamber], label="actual")
    ax.set(title=f"{name} chamber", xlabel="phase of the stride (-)")
axes[0].set_ylabel("pressure (kPa)")
axes[0].legend()
plt.show()

# %% [markdown]
# ## Shape
#
# A pressurised chamber bends its span of the body: M = EI (kappa + alpha dkappa/dt) - M_act, with
# M_act = K_Q p in the span. At this frequency the inertia of the water determines the shape. The
# body swings about a node near the tail's joint, and the tail follows half a stride later.

# %%
figure, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
colours = plt.colormaps["viridis"]
for step in range(steps // 10 - 1, steps, steps // 10):
    x, y = 1e3 * last["midline"][step]
    ax.plot(x, y, color=colours(phase[step]), lw=1.8, label=f"{phase[step]:.1f}")
ax.plot(0.0, 0.0, "ks", ms=8)
ax.axvline(-1e3 * float(model.robot.body_length), color="0.7", ls=":", zorder=0)
ax.annotate("joint of the tail", (-1e3 * float(model.robot.body_length) + 3, -23), color="0.4")
ax.annotate("clamp", (-22, 4))
ax.set(xlabel="x (mm)", ylabel="y (mm)", ylim=(-26, 26), title="ten midlines (y stretched)")
ax.legend(title="phase (-)", ncols=2, fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# The phase of the fundamental along the body distinguishes a travelling wave from a standing wave.
# This wave is mostly standing: the index is near 0, and 1 would be a travelling wave. A clamped
# head and two chambers nearly in phase cause this.

# %%
t = np.asarray(run.t)[-steps:]
mode = obs.fundamental_mode(jnp.asarray(last["midline"][:, 1]), t, frequency)
print(f"travelling index {obs.travelling_index(mode):.2f}")

# %% [markdown]
# ## Forces along the body
#
# Two effects act on every section, as forces per length:
#
# - drag of the crossflow, F_n = -rho C_d H |u_n| u_n / 2, which opposes the motion;
# - Lighthill's reactive force, the change in momentum of the water that moves with the body,
#   F_n = -m_A (du_n/dt - d(u_tau u_n)/ds + u_n^2 kappa/2),
#   F_tau = -m_A (-u_n omega + u_tau u_n kappa + u_n du_n/ds).
#
# A body that does not stretch turns at omega = dV_n/ds + kappa V_tau, so F_tau is zero in still
# water. Both forces are then normal to the body, and push forward only where the body is inclined.
# The plots show two instants. At the largest thrust, the body is about to reverse, and only its
# acceleration matters. A quarter of a stride earlier, the tail is fast and drag contributes.

# %%
best = int(np.argmax(last["thrust"]))
instants = {"largest thrust": best, "a quarter of a stride before": best - steps // 4}
joint = 1e3 * float(model.robot.tail_length)


def forward(name):
    """Force per length along x [N/m] that an effect exerts on the cells, at every step."""
    return np.asarray(to_plane(*np.moveaxis(last[name], 1, 0), last["phi"])[0])


figure, axes = plt.subplots(
    2, 2, figsize=(10, 5.4), sharex=True, sharey="row", layout="constrained"
)
for column, (title, instant) in enumerate(instants.items()):
    for name in ("reactive", "drag"):
        axes[0, column].plot(1e3 * cells, last[name][instant, 1], label=name)
        axes[1, column].plot(1e3 * cells, forward(name)[instant], label=name)
    axes[0, column].set_title(f"{title} (phase {phase[instant]:.2f})")
    axes[1, column].set_xlabel("s, from the tail's tip (mm)")
for ax in axes.flat:
    ax.axhline(0.0, color="k", lw=0.6)
    ax.axvline(joint, color="0.7", ls=":", zorder=0)
axes[0, 0].set_ylabel("force along n (N/m)")
axes[1, 0].set_ylabel("force forward (N/m)")
axes[0, 0].annotate("joint of the tail", (joint + 4, 9), color="0.4")
axes[0, 0].legend(loc="upper right")
plt.show()

# %% [markdown]
# The mean of the forward force over the stride shows where thrust originates. Its integral over the
# body is the mean thrust, because the body gains no momentum over a steady stride.

# %%
mean_forward = {name: forward(name).mean(axis=0) for name in ("reactive", "drag")}
figure, ax = plt.subplots(figsize=(9, 3.2), layout="constrained")
for name, force in mean_forward.items():
    share = 1e3 * float(run.mesh.grid.integral(force))
    ax.plot(1e3 * cells, force, label=f"{name}, {share:+.0f} mN in all")
ax.axhline(0.0, color="k", lw=0.6)
ax.axvline(joint, color="0.7", ls=":", zorder=0)
ax.set(xlabel="s, from the tail's tip (mm)", ylabel="mean force forward (N/m)")
ax.legend()
plt.show()

from_water = float(run.mesh.grid.integral(sum(mean_forward.values())))
print(f"mean push of the water {1e3 * from_water:.2f} mN,", end=" ")
print(f"mean thrust {1e3 * last['thrust'].mean():.2f} mN")

# %% [markdown]
# ## Thrust and recoil
#
# A sensor between robot and clamp reads the force of the robot on the clamp: thrust = -T and
# recoil = -N at the head. Both half-strides push forward, so thrust has two peaks in a stride, and
# recoil has one. The mean thrust is small compared with its amplitude: it is the difference of
# large forces.

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for ax, name in zip(axes, ("thrust", "recoil"), strict=True):
    ax.axhline(0.0, color="k", lw=0.6)
    ax.plot(phase, 1e3 * last[name])
    ax.axhline(1e3 * last[name].mean(), color="C3", ls="--", label="mean")
    ax.set(xlabel="phase of the stride (-)", ylabel=f"{name} (mN)")
axes[0].legend()
plt.show()

mean_thrust, mean_power = last["thrust"].mean(), last["power"].mean()
print(f"mean thrust {1e3 * mean_thrust:.1f} mN, largest recoil {abs(last['recoil']).max():.2f} N")
print(f"power of the chambers {1e3 * mean_power:.0f} mW,", end=" ")
print(f"thrust per power {obs.force_efficiency(mean_thrust, mean_power):.2f} N/W")

# %% [markdown]
# ## Is it steady?
#
# The mean thrust of each stride, from rest on. The paper treats strides as steady after three
# tailbeats.

# %%
per_stride = np.asarray(obs.stride_means(run.saved["thrust"], steps))
print("mean thrust of each stride (mN):", np.round(1e3 * per_stride, 1))

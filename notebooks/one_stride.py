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
# In this tutorial, the head of SLIDER is clamped in still water, and both pairs of chambers are
# driven at 4.8 Hz. The tutorial explains the quantities of one stride in the order in which the
# simulator computes them: the pressures, the shape of the body, the forces of the water along the
# body, and the reading of a force sensor at the clamp.
#
# All quantities are in SI units. The coordinate s increases along the body from the tail's tip (s =
# 0) to the head (s = L, the length of the robot). The unit vector tau is tangential to the body and
# points towards the head. The unit vector n is tau rotated by +90 degrees. The straight robot lies
# on the x axis with its head at x = 0. docs/reference/glossary.md defines all symbols.

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
# A model contains five parts: the robot, a tuple of effects that act on the robot, the law of the
# pressures, the drive of the chambers, and the support of the head. Each part is an immutable
# object, and JAX can differentiate a result with respect to the numbers in the object. The paper
# does not state the pressure amplitude of the chambers and the delay of the rear chamber, so the
# values in this cell are assumptions.

# %%
frequency = 4.8
drag, reactive = sj.NormalDrag(C_d=3.0), sj.ReactiveForce(m_a=1.0)
model = sj.Model(
    robot=sj.uniform_robot(),
    effects=(drag, reactive),
    pressure_law=sj.FirstOrderLag(k=0.087),
    drive=sj.Drive(
        waves=(
            sj.SquareWave(frequency, amplitude=260e3),
            sj.SquareWave(frequency, amplitude=260e3, phase=0.05),
        )
    ),
    support=sj.Clamped(),
)

# %% [markdown]
# ## The rollout
#
# A rollout simulates the model step by step. A stride has a whole number of time steps, so the
# valves never switch within a step. After every step, the simulator calls the function `save` with
# a `Snapshot`, the state of the system at the end of the step. `save` returns the quantities to
# keep. The snapshot's `section` contains the shape and the velocities in all cells of the grid. An
# effect computes its force per length from these values.


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
# The set pressure p_set switches between +260 and -260 kPa. The sign of p_set states whether the
# left or the right chamber is filled. The pressure p follows with a lag, dp/dt = (p_set - p)/k,
# where the time constant k is 87 ms. Half a stride lasts 104 ms. The chambers therefore reach only
# a little more than half of the set pressure.

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
# A pressurised chamber bends its span of the body. The internal moment is M = EI (kappa + alpha
# dkappa/dt) - M_act, where EI is the bending stiffness, kappa the curvature, and alpha the damping
# time of the body. The moment of the chamber is M_act = K_Q p in its span and zero elsewhere.
#
# At this frequency, mainly the inertia of the water determines the shape. The body swings about a
# point that hardly moves, near the joint between body and tail. The tail moves half a stride later
# than the body.

# %%
figure, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
colours = plt.colormaps["viridis"]
for step in range(steps // 10 - 1, steps, steps // 10):
    x, y = 1e3 * last["midline"][step]
    ax.plot(x, y, color=colours(phase[step]), lw=1.8, label=f"{phase[step]:.1f}")
ax.plot(0.0, 0.0, "ks", ms=8)
ax.axvline(-1e3 * float(model.robot.body.length), color="0.7", ls=":", zorder=0)
ax.annotate("joint of the tail", (-1e3 * float(model.robot.body.length) + 3, -23), color="0.4")
ax.annotate("clamp", (-22, 4))
ax.set(xlabel="x (mm)", ylabel="y (mm)", ylim=(-26, 26), title="ten midlines (y stretched)")
ax.legend(title="phase (-)", ncols=2, fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# The travelling index is 1 for a travelling wave and 0 for a standing wave. The index is computed
# from the lateral motion at the stride frequency: from its amplitude and its phase at each point of
# the body. Here the index is close to 0, so the wave is mostly a standing wave. The reasons are the
# clamped head and the small delay between the two chambers.

# %%
t = np.asarray(run.t)[-steps:]
mode = obs.fundamental_mode(jnp.asarray(last["midline"][:, 1]), t, frequency)
print(f"travelling index {obs.travelling_index(mode):.2f}")

# %% [markdown]
# ## Forces along the body
#
# In this model, two effects act on every section of the body. Each effect is a force per length:
#
# - The drag of the crossflow opposes the motion normal to the body:
#   F_n = -rho C_d H |u_n| u_n / 2.
# - Lighthill's reactive force is the change in momentum of the water that moves with the body:
#   F_n = -m_A (du_n/dt - d(u_tau u_n)/ds + u_n^2 kappa/2),
#   F_tau = -m_A (-u_n omega + u_tau u_n kappa + u_n du_n/ds).
#
# Here F_tau is the component of a force along the body, and F_n the component normal to it. u_tau
# and u_n are the components of the body's velocity relative to the water. rho is the density of the
# water, C_d the drag coefficient, and H the height of the body. m_A is the added mass per length,
# kappa the curvature, and omega the turning rate of a section.
#
# If the body does not stretch, the turning rate of a section is omega = du_n/ds + kappa u_tau in
# still water. The component F_tau of the reactive force is then zero. Both forces are therefore
# normal to the body, and have a forward component only where the body is inclined to the x axis.
#
# The plots show the forces at two instants. At the instant of the largest thrust, the body is
# about to reverse its motion: the velocity is small, and only the acceleration matters. A quarter
# of a stride earlier, the tail moves fast, and the drag contributes to the force.

# %%
best = int(np.argmax(last["thrust"]))
instants = {"largest thrust": best, "a quarter of a stride before": best - steps // 4}
joint = 1e3 * float(model.robot.tail.length)


def forward(name):
    """Returns the force per length along x [N/m] (steps, cells) of the effect `name`."""
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
# The next plot shows the forward force per length, averaged over the stride. The plot shows which
# parts of the body produce thrust. The integral of this mean force along the body is equal to the
# mean thrust, because the body gains no momentum in a steady stride.

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
# A sensor between robot and clamp measures the force of the robot on the clamp. Thrust is the
# forward component, and recoil is the lateral component. At the head, thrust is -T and recoil is
# -N, where T is the axial force and N the shear force in the body. The robot pushes forward
# in both halves of a stride, so the thrust has two peaks per stride. The recoil has one peak per
# stride. The mean thrust is the difference between large forward and backward forces, so it is much
# smaller than the peaks.

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
# ## Is the motion steady?
#
# The next cell prints the mean thrust of each stride, beginning with the first stride from rest.
# The paper treats strides as steady after three tailbeats. In this simulation, the mean thrust
# changes by less than 1 mN per stride from the fourth stride on.

# %%
per_stride = np.asarray(obs.stride_means(run.saved["thrust"], steps))
print("mean thrust of each stride (mN):", np.round(1e3 * per_stride, 1))

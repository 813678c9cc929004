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
# # Designing a tail
#
# How long and how stiff should the tail be? This tutorial searches for the tail with the highest
# steady swimming speed. The tutorial uses three methods: a map, gradient ascent, and the genetic
# algorithm. The frequency, the pressures and the phase of the drive are fixed. The two remaining
# variables, the tail's length and stiffness, fit in one plot. The command `slider optimize swim`
# optimises all six variables.
#
# To save time, the simulation uses a coarse mesh of 17 nodes and only 48 time steps per stride. The
# last section repeats the simulation of the best design on a finer mesh.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax

import slider_jax as sj
from slider_jax.beam.parameters import Numerics
from slider_jax.optimise.design_space import models
from slider_jax.optimise.loop import run_optimiser, settings_of
from slider_jax.optimise.optimiser import make_optimiser
from slider_jax.optimise.population import Evaluation
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.paper_optimum import optimum
from slider_jax.swimming.steady_state import SteadySettings, find_steady, steady_speed

sj.enable_float64()

# %% [markdown]
# ## The objective
#
# The built-in robot has form drag at its head; docs/how-to/swimming.md explains why. The drive has
# a frequency of 5 Hz and a set pressure of 365 kPa in both chambers. The rear chamber follows the
# front chamber with a delay of 0.15 of a stride. The largest allowed stiffness of the tail is 38
# times the smallest allowed stiffness. The optimisation therefore uses the logarithm of the
# stiffness as its variable.

# %%
LENGTHS, STIFFNESSES = (0.02, 0.10), (0.001, 0.038)
robot = models(optimum())
coarse = SteadySettings(steps_per_stride=48, numerics=Numerics(tail_cells=4, body_cells=12))


def gait(unit):
    """Returns the design at a point (2,) of the unit square."""
    length = LENGTHS[0] + unit[0] * (LENGTHS[1] - LENGTHS[0])
    stiffness = STIFFNESSES[0] * (STIFFNESSES[1] / STIFFNESSES[0]) ** unit[1]
    return Gait(5.0, 365e3, 365e3, 0.15, length, stiffness)


def tail_text(unit):
    """Returns the length and the stiffness of a design's tail, as text."""
    return f"{1e3 * gait(unit).tail_length:.0f} mm and {1e3 * gait(unit).EI_tail:.1f} mN m^2"


def speed(unit, search=coarse):
    """Returns the steady speed of a design [m/s], or NaN if the design has no steady speed."""
    x = gait(unit)
    found = find_steady(robot(x), x.frequency, search)
    return jnp.where(found.ok, found.speed, jnp.nan)


speeds = Evaluation(speed)  # evaluates many designs at once, on all devices

# %% [markdown]
# ## Map
#
# For a map, we compute the speed at every point of a grid of designs. The map shows how the speed
# depends on both variables. However, the number of grid points grows exponentially with the number
# of variables. A map is therefore practical only for about two variables.

# %%
side = np.linspace(0.0, 1.0, 9)
grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
on_grid = speeds(grid)
top = grid[np.nanargmax(on_grid)]
print(f"{len(grid)} designs; the fastest {100 * np.nanmax(on_grid):.1f} cm/s, {tail_text(top)}")

# %% [markdown]
# ## Gradient ascent
#
# The function `steady_speed` is differentiable. The speed is the root of an equation, so the
# derivative follows from the implicit function theorem. The derivatives with respect to both
# variables cost about as much as two more evaluations of the speed. The optimiser Adam starts from
# a short and stiff tail.


# %%
def speed_twice(unit):
    found = gait(unit)
    value = steady_speed(robot(found), found.frequency, coarse)
    return value, value


slope = jax.jit(jax.jacfwd(speed_twice, has_aux=True))
climber = optax.adam(optax.cosine_decay_schedule(0.12, 20, 0.05), b1=0.7, b2=0.9)
at = jnp.array([0.1, 0.9])
state, path, heights = climber.init(at), [], []
for _ in range(20):
    gradient, value = slope(at)
    path.append(np.asarray(at))
    heights.append(float(value))
    step, state = climber.update(-gradient, state)
    at = jnp.clip(at + step, 0.0, 1.0)
path = np.array(path)
summit = path[int(np.nanargmax(heights))]
print(f"{len(path)} steps; the fastest {100 * np.nanmax(heights):.1f} cm/s, {tail_text(summit)}")

# %% [markdown]
# ## Genetic algorithm
#
# The paper uses a genetic algorithm. This method needs no derivatives, and it can leave a local
# maximum. However, it needs more evaluations than gradient ascent.

# %%
members, generations = 16, 8
genetic = make_optimiser("genetic", members, 2)
bred = run_optimiser(
    genetic,
    lambda population, gradients: (speeds(population), None),
    generations,
    seed=0,
    settings=settings_of(genetic, members, 0, {"notebook": "designing a tail"}),
)
evaluations = bred.history[-1].evaluations
print(f"{evaluations} evaluations; the fastest {100 * bred.score:.1f} cm/s, {tail_text(bred.best)}")

# %% [markdown]
# ## Comparison
#
# The left plot shows the map, the path of gradient ascent, and the last generation of the genetic
# algorithm. The right plot shows the best speed of each method against the number of evaluations.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
mm = 1e3 * gait(np.array([side, side])).tail_length
mN_m2 = 1e3 * gait(np.array([side, side])).EI_tail
shown = left.contourf(mm, mN_m2, 100 * on_grid.reshape(9, 9).T, 20, cmap="viridis")
figure.colorbar(shown, ax=left, label="steady speed (cm/s)")
walked = gait(path.T)
left.plot(1e3 * walked.tail_length, 1e3 * walked.EI_tail, "w.-", lw=1.0, label="gradient")
born = gait(bred.population.T)
left.plot(1e3 * born.tail_length, 1e3 * born.EI_tail, "C1x", ms=5, label="last generation")
left.set_yscale("log")
left.set_xlabel("tail length (mm)")
left.set_ylabel("EI of the tail (mN m²)")
left.legend(fontsize="small")
right.plot(3 * np.arange(1, len(heights) + 1), 100 * np.fmax.accumulate(heights), "C0.-",
           label="gradient (a step counts as three)")  # fmt: skip
right.plot([x.evaluations for x in bred.history], [100 * x.best for x in bred.history], "C1x-",
           label="genetic")  # fmt: skip
right.axhline(100 * np.nanmax(on_grid), color="0.5", ls="--", label=f"map of {len(grid)}")
right.set_xlabel("evaluations")
right.set_ylabel("best steady speed (cm/s)")
right.legend(fontsize="small", loc="lower right")
plt.show()

# %% [markdown]
# ## Finer mesh
#
# A soft tail bends sharply, so a coarse mesh limits the accuracy of the speed. We therefore
# simulate the best design of gradient ascent again, with 51 nodes and 96 steps per stride:

# %%
fine = SteadySettings(steps_per_stride=96, numerics=Numerics())
finer = float(jax.jit(lambda unit: speed(unit, fine))(jnp.asarray(summit)))
print(f"{100 * np.nanmax(heights):.2f} cm/s on 17 nodes, {100 * finer:.2f} cm/s on 51")

# %% [markdown]
# The command `slider optimize swim --out results/optimum` optimises all six variables. The command
# uses all cores and writes checkpoints. The option `--algorithm gradient` selects gradient ascent.
# `slider published --all` draws design maps like those of the paper.

"""Compares a strip that moves in three dimensions with PyElastica: the tip's path, and the cost.

    taskset -c 1 python benchmarks/peer_pyelastica_space.py --out peer_pyelastica_space.json

A clamped strip is released from rest under its weight, in air and in still water with drag. Its
section is rolled about the axis, so the strip bends in both planes and twists.

  * The criterion was stated before the first run. The tip's paths differ by less than 1 % of the
    tip's largest displacement, and each program's path changes by less than 0.2 % by refinement.
    The twists of the tip, relative to the clamp, are also compared; see docs/reference/performance.
  * PyElastica has the strip's stiffnesses and moments of inertia, and its shear stiffness. This
    simulator has no shear and no rotary inertia about n and b. Section "slender" has a tenth of
    these moments of inertia and ten times the shear stiffness, so it is closer to this model.
  * The rotary inertia about b limits PyElastica's stable time step and hardly changes the path. In
    section "thick", the inertia about n acts also about b, so larger time steps are stable.
  * A cost is CPU seconds of one core per simulated second and strip, with an error of the path
    below 1 %. The programs are timed in turns; the smallest of several rounds is reported.
"""

import argparse
import itertools
import json
import math
import os
from dataclasses import replace
from importlib.metadata import version

import cases  # sets float64 and the options of XLA
import elastica as ea
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numba import njit
from peer_pyelastica import Simulator, core_seconds, largest_step, machine_line, march, tip_position
from speed import least_cpu_seconds

from slider_jax.actuation import FirstOrderLag, SineWave
from slider_jax.beam.parameters import Numerics, uniform_robot
from slider_jax.dynamics.model import Drive, Model, SpaceSettings
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import Gravity, NormalDrag
from slider_jax.io.files import versions
from slider_jax.spatial.step import spatial_rollout
from slider_jax.supports import Clamped

LENGTH, HEIGHT, WIDTH = 0.3, 0.015, 0.006  # m; the height is along b, and the width along n
YOUNG, DENSITY = 20e6, 2000.0  # Pa, kg/m^3: a filled rubber
SHEAR = YOUNG / 3
AREA = HEIGHT * WIDTH
LINE_MASS = DENSITY * AREA
EI_B, EI_N = YOUNG * HEIGHT * WIDTH**3 / 12, YOUNG * WIDTH * HEIGHT**3 / 12
SLIMNESS = WIDTH / HEIGHT
GJ = SHEAR * HEIGHT * WIDTH**3 / 3 * (1 - 0.63 * SLIMNESS * (1 - SLIMNESS**4 / 12))
J_N, J_B = DENSITY * WIDTH * HEIGHT**3 / 12, DENSITY * HEIGHT * WIDTH**3 / 12  # kg m
G, RHO_WATER, C_DRAG = 9.81, 1000.0, 2.0  # m/s^2, kg/m^3, -
ROLL = 0.8  # rad
SECTION = J_N, J_B, 5 / 6 * SHEAR * AREA  # kg m, kg m, N
SLENDER = 0.1 * J_N, 0.1 * J_B, 10.0 * SECTION[2]
SECTIONS = {"real": SECTION, "thick": (J_N, J_N, SECTION[2])}
SECONDS, SAMPLE = 0.6, 0.01  # s, duration and interval of the compared positions
SAMPLES = round(SECONDS / SAMPLE)
TOLERANCE = 0.01
COARSE, FINE, TIMED = (40, 4), (80, 8), (20, 1)  # cells, and time steps per sample
PEER_COARSE, PEER_FINE, PEER_SLENDER = (40, 2e-5), (80, 1e-5), (40, 2.5e-6)  # elements, s
PEER_MESHES = 10, 20  # elements of the timed runs
MEMBERS, CHUNK = 112, 8  # strips in a batch, and strips that are computed together
TIMES = SAMPLE * np.arange(1, SAMPLES + 1)


def strip(in_water: bool) -> Model:
    """Returns the strip of this simulator."""
    robot = uniform_robot(
        body_length=0.8 * LENGTH, tail_length=0.2 * LENGTH, linear_density=LINE_MASS, EI_body=EI_B,
        EI_tail=EI_B, EA_body=YOUNG * AREA, EA_tail=YOUNG * AREA, damping_time=0.0, height=HEIGHT,
        K_Q=0.0, front_chamber=(0.02, 0.1), rear_chamber=(0.12, 0.2),
    ).with_parts(
        lambda p: replace(
            p, GJ=GJ, EI_n=EI_N, polar_inertia=J_N + J_B, width=WIDTH,
            area=AREA if in_water else None,
        )
    )  # fmt: skip
    weight = Gravity(G, elevation=math.pi / 2, density=RHO_WATER if in_water else 0.0)
    effects = (weight, NormalDrag(C_DRAG, RHO_WATER)) if in_water else (weight,)
    still = Drive((SineWave(1.0, 0.0), SineWave(1.0, 0.0)))
    space = SpaceSettings(jnp.zeros(2), ROLL)
    model = Model(robot, effects, FirstOrderLag(0.1), still, Clamped(), space=space)
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


def run(model: Model, cells: int, steps: int):
    """Returns positions [m] and twist [rad] of the tip (samples, 4), and success.

    The twist is relative to the clamp: the integral of Omega_tau. `steps` is the number of time
    steps per sample.
    """
    numerics = Numerics(tail_cells=cells // 5, body_cells=cells - cells // 5)
    times = TimeGrid(SAMPLE / steps, SAMPLES * steps)

    def save(x):
        twist = jnp.sum(x.section().curvature.tau * x.mesh.grid.ds)
        return jnp.append(x.positions()[:, 0], twist)

    out = spatial_rollout(model, times, save, numerics, checkpoint=False)
    return out.saved[steps - 1 :: steps], out.ok


@njit
def _loads(velocity, omega, directors, kappa, lengths, node_weights, unit, forces, torques):
    """Adds weight, and the drag of the flow across each element. `unit` is rho C_d / 2."""
    for k in range(node_weights.size):
        forces[2, k] -= node_weights[k]
    if unit == 0.0:
        return
    last = lengths.size - 1
    for k in range(last + 1):
        u = np.zeros(3)  # velocity of the element along its directors
        for i in range(3):
            for j in range(3):
                u[i] += directors[i, j, k] * 0.5 * (velocity[j, k] + velocity[j, k + 1])
        along_1 = -unit * HEIGHT * abs(u[0]) * u[0] * lengths[k]
        along_2 = -unit * WIDTH * abs(u[1]) * u[1] * lengths[k]
        for j in range(3):
            force = along_1 * directors[0, j, k] + along_2 * directors[1, j, k]
            forces[j, k] += 0.5 * force
            forces[j, k + 1] += 0.5 * force
        twist = 0.5 * (kappa[2, max(k - 1, 0)] + kappa[2, min(k, last - 1)])
        slip = omega[2, k] - u[2] * twist
        torques[2, k] -= unit / 32.0 * HEIGHT**4 * abs(slip) * slip * lengths[k]


class StripForcing(ea.NoForces):
    """Weight minus buoyancy, and drag, of a strip in air or water."""

    def __init__(self, elements, in_water):
        self.unit = 0.5 * RHO_WATER * C_DRAG if in_water else 0.0
        weight = (DENSITY - (RHO_WATER if in_water else 0.0)) * AREA * G
        self.node_weights = np.full(elements + 1, weight * element_length(elements))
        self.node_weights[[0, -1]] *= 0.5

    def apply_forces(self, system, time=0.0):
        _loads(system.velocity_collection, system.omega_collection, system.director_collection,
               system.kappa, system.lengths, self.node_weights, self.unit,
               system.external_forces, system.external_torques)  # fmt: skip


def element_length(elements):
    """Returns the length [m] of an element. Half an element is behind the clamp."""
    return LENGTH / (elements - 0.5)


def peer_strip(in_water, elements, section, members=1):
    """Returns a PyElastica simulator of strips along -x with d1 = n, d2 = -b, d3 = -tau.

    `section` contains the moments of inertia about n and b per length, and the shear stiffness.
    EI_b of the strips decreases from 100 % to 90 %.
    """
    simulator, rods = Simulator(), []
    length = element_length(elements)
    *across, shear = section
    inertia = np.array([*across, J_N + J_B]) * length
    for scale in np.linspace(1.0, 0.9, members):
        rod = ea.CosseratRod.straight_rod(
            elements, np.array([0.5 * length, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]),
            np.array([0.0, math.cos(ROLL), math.sin(ROLL)]), elements * length,
            math.sqrt(AREA / math.pi), DENSITY, youngs_modulus=YOUNG, shear_modulus=SHEAR,
        )  # fmt: skip
        rod.mass_second_moment_of_inertia[...] = np.diag(inertia)[..., None]
        rod.inv_mass_second_moment_of_inertia[...] = np.diag(1.0 / inertia)[..., None]
        rod.shear_matrix[...] = np.diag([shear, shear, YOUNG * AREA])[..., None]
        rod.bend_matrix[...] = np.diag([EI_N, scale * EI_B, GJ])[..., None]
        simulator.append(rod)
        simulator.constrain(rod).using(
            ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        simulator.add_forcing_to(rod).using(StripForcing, elements, in_water)
        rods.append(rod)
    simulator.finalize()
    return simulator, rods


def peer_run(in_water, elements, step, section):
    """Returns PyElastica's positions and twist of the tip (samples, 4), or None if unstable."""
    simulator, rods = peer_strip(in_water, elements, section)

    def tip_and_twist(rod):
        return np.append(tip_position(rod), rod.kappa[2].sum() * element_length(elements))

    series = march(simulator, rods[0], step, SECONDS, tip_and_twist)
    if series is None:
        return None
    t = step * np.arange(1, len(series) + 1)
    return np.stack([np.interp(TIMES, t, x) for x in series.T], axis=1)


def difference(series, reference) -> dict[str, float]:
    """Returns the largest differences of path and twist, divided by the reference's maxima."""
    path, exact = series[:, :3], reference[:, :3]
    moved = np.linalg.norm(exact - [-LENGTH, 0.0, 0.0], axis=1).max()
    twist = np.abs(series[:, 3] - reference[:, 3]).max() / np.abs(reference[:, 3]).max()
    return {"path": np.linalg.norm(path - exact, axis=1).max() / moved, "twist": twist}


def compare(in_water: bool) -> tuple[dict, np.ndarray]:
    """Returns the differences between and within the programs, and PyElastica's fine result."""

    def here(cells, steps):
        series, ok = jax.jit(lambda m: run(m, cells, steps))(strip(in_water))
        assert ok
        return np.array(series)

    coarse, fine, timed = here(*COARSE), here(*FINE), here(*TIMED)
    peer_coarse, peer_fine = (peer_run(in_water, *x, SECTION) for x in (PEER_COARSE, PEER_FINE))
    slender = peer_run(in_water, *PEER_SLENDER, SLENDER)
    report = {
        "tip_range_over_length": np.ptp(fine[:, :3], axis=0) / LENGTH,
        "largest_twist_rad": np.abs(fine[:, 3]).max(),
        "change_by_refinement": difference(coarse, fine),
        "change_by_refinement_of_peer": difference(peer_coarse, peer_fine),
        "difference_from_peer": difference(fine, peer_fine),
        "difference_from_slender_peer": difference(fine, slender),
        "error_of_timed": difference(timed, fine),
    }
    return report, peer_fine


def peer_setting(in_water, elements, name, fine) -> dict:
    """Returns the largest stable step of PyElastica with `elements` and the section `name`."""

    def error(step):
        series = peer_run(in_water, elements, step, SECTIONS[name])
        return math.inf if series is None else difference(series, fine)["path"]

    step = largest_step(lambda h: error(h) <= TOLERANCE, 8e-5)
    return {"elements": elements, "section": name, "step_s": step, "error": error(step)}


def least_in_turns(measurements, rounds: int) -> dict[str, float]:
    """Returns the smallest value of each measurement. The first value, with compilation, is lost.

    All measurements are repeated in turns, so that the computer's other load affects them alike.
    """
    for measure in measurements.values():
        measure()
    values = [{name: f() for name, f in measurements.items()} for _ in range(rounds)]
    return {name: min(x[name] for x in values) for name in measurements}


def one_strip(in_water: bool, steps: int):
    """Returns a measurement of the cost of one strip."""
    model = strip(in_water)
    call = jax.jit(lambda m: run(m, TIMED[0], steps))
    return lambda: least_cpu_seconds(lambda: call(model), 1) / SECONDS


def batch_of_strips(steps: int):
    """Returns a measurement of the cost per strip of a batch in water, in chunks of eight."""
    base = strip(True)

    def member(scale):
        where = lambda m: (m.robot.body.EI, m.robot.tail.EI)  # noqa: E731
        series, ok = run(eqx.tree_at(where, base, (scale * EI_B, scale * EI_B)), TIMED[0], steps)
        return series[-1], ok

    call = jax.jit(lambda x: jax.lax.map(member, x, batch_size=CHUNK))
    scales = jnp.linspace(1.0, 0.9, MEMBERS)
    assert call(scales)[1].all()
    return lambda: least_cpu_seconds(lambda: call(scales), 1) / (MEMBERS * SECONDS)


def peer_strips(in_water, members, setting, window):
    """Returns a measurement of PyElastica's cost per strip."""
    section = SECTIONS[setting["section"]]
    simulator, _ = peer_strip(in_water, setting["elements"], section, members)
    return lambda: core_seconds(simulator, setting["step_s"], window, 1)[0][0] / members


def costs_of_strips(settings: dict[str, list[dict]], rounds: int) -> dict[str, float]:
    """Returns the costs of both programs."""
    calls = {}
    for steps in (TIMED[1], 4 * TIMED[1]):
        label = f"this simulator, step {SAMPLE / steps * 1e3:g} ms"
        for medium in settings:
            calls[f"{label}, {medium}"] = one_strip(medium == "water", steps)
        calls[f"{label}, water, batch"] = batch_of_strips(steps)
    for medium, found in settings.items():
        for x in found:
            label = f"PyElastica, {x['elements']} elements, {x['section']}, {medium}"
            calls[label] = peer_strips(medium == "water", 1, x, 0.05)
            if medium == "water":
                calls[f"{label}, batch"] = peer_strips(True, MEMBERS, x, 0.005)
    return least_in_turns(calls, rounds)


def costs_of_the_dimensions(rounds: int) -> dict:
    """Returns the costs of the robot of the speed benchmark in the plane and in space."""
    plane = cases.model()
    robot = plane.robot.with_parts(
        lambda p: replace(p, GJ=0.05, EI_n=4.0 * p.EI, polar_inertia=2e-5, width=0.03)
    )
    space = jax.tree.map(lambda x: jnp.asarray(x, float), replace(plane, robot=robot))
    strides = 2
    times = TimeGrid.per_stride(cases.FREQUENCY, cases.STEPS, strides)
    mesh = cases.numerics(cases.NODES)
    options = {"save": lambda x: x.y[0, -1], "numerics": mesh, "checkpoint": False}

    def in_plane(amplitude, _):
        out = rollout(cases.with_amplitude(plane, amplitude), times, **options)
        return out.ok, out.final.factorisations

    def in_space(amplitude, angles):
        model = replace(cases.with_amplitude(space, amplitude), space=SpaceSettings(angles))
        out = spatial_rollout(model, times, **options)
        return out.ok, out.final.factorisations

    factorisations, calls = {}, {}

    def add(name, call, amplitudes, angles):
        ok, count = call(amplitudes, angles)
        assert ok.all()
        factorisations[name] = float(jnp.mean(count)) / (2 * times.steps)  # two stages per step
        size = jnp.size(amplitudes) * strides / cases.FREQUENCY
        calls[name] = lambda: least_cpu_seconds(lambda: call(amplitudes, angles), 1) / size

    many = jnp.linspace(150e3, 300e3, MEMBERS)
    straight, oblique = jnp.zeros(2), jnp.array([0.7, -0.7])  # rad, directions of the chambers
    for name, function in (("plane", in_plane), ("space", in_space)):
        one = jax.jit(function)
        batch = jax.jit(
            lambda a, angles, f=function: jax.lax.map(lambda x: f(x, angles), a, batch_size=CHUNK)
        )
        add(name, one, 250e3, straight)
        add(f"{name}, batch", batch, many, straight)
        if name == "space":
            add("space, out of plane", one, 250e3, oblique)
            add("space, out of plane, batch", batch, many, oblique)
    cost = least_in_turns(calls, rounds)
    ratios = {
        name: cost[name] / cost["plane, batch" if "batch" in name else "plane"] for name in cost
    }
    return {"cost": cost, "factorisations_per_stage": factorisations, "over_plane": ratios}


def plain(x):
    return x.tolist() if hasattr(x, "tolist") else float(x)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", metavar="FILE.json", help="JSON file for the results")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of the timings (default: 3)")
    args = parser.parse_args()
    report: dict = {"machine": machine_line(), "load": os.getloadavg(), "versions": versions()}
    report["versions"] |= {name: version(name) for name in ("pyelastica", "numba")}
    settings = {}
    for medium in ("air", "water"):
        report[medium], peer = compare(medium == "water")
        print(medium, json.dumps(report[medium], indent=1, default=plain), flush=True)
        settings[medium] = [
            peer_setting(medium == "water", elements, name, peer)
            for elements, name in itertools.product(PEER_MESHES, SECTIONS)
        ]
    report["peer_settings"] = settings
    report["core_seconds_per_simulated_second"] = costs_of_strips(settings, args.rounds)
    report["dimensions"] = costs_of_the_dimensions(args.rounds)
    for name in ("peer_settings", "core_seconds_per_simulated_second", "dimensions"):
        print(name, json.dumps(report[name], indent=1, default=plain))
    if args.out:
        with open(args.out, "w") as file:
            file.write(json.dumps(report, indent=1, default=plain) + "\n")


if __name__ == "__main__":
    main()

"""Measures the speed of PyElastica on the robot's rod, for comparison in the speed benchmark.

    python -m venv venv && venv/bin/pip install pyelastica
    taskset -c 1 venv/bin/python benchmarks/peer_pyelastica.py --out peer_pyelastica.json

The script uses the documented stable time steps (STEP_S below); ``--bisect`` searches for them.
``--quick`` uses shorter windows and omits the comparison with a quarter of the time step.

The rod is clamped at the head. It is a typical PyElastica model of this robot:
  * The rod has 50 equal elements over 0.37 m. The tail's bending stiffness begins at 0.2997 m,
    which is the edge of the cell of the Voronoi node at 0.3034 m.
  * The section is circular with a radius R of 15 mm, which is half the body's height. The density
    gives the structural mass plus the lateral added mass. The added mass therefore also acts along
    the rod. Young's modulus is E = 4 EI / (pi R^4), and the shear modulus is G = E / 3. The stable
    time step is proportional to R.
  * Case "sheet": the tail has the stretch, shear and bend matrices of a thin plate, but the mass
    and rotary inertia of the 15 mm section. The plate's rotary inertia would need a time step about
    eight times smaller. Motion is planar, so both bend entries have the smaller value.
  * AnalyticalLinearDamper replaces Kelvin-Voigt damping. The rate tau * (2 pi f)^2 is the rate of a
    mode at the drive frequency f with the Kelvin-Voigt time tau.
  * One custom forcing class with numba kernels applies drag and actuation. A Python loop calls
    PositionVerlet without callbacks. In a batch, each rod has its own pressure.
"""

import argparse
import json
import math
import os
import platform
import statistics
import time
from importlib.metadata import version

for _name in ("OPENBLAS", "OMP", "MKL", "NUMBA"):  # before numpy and numba are imported
    os.environ[f"{_name}_NUM_THREADS"] = "1"
if hasattr(os, "sched_setaffinity"):  # use one core, the last of the allowed cores
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import elastica as ea  # noqa: E402
import numpy as np  # noqa: E402
from numba import njit  # noqa: E402

# Largest stable time steps [s] from --bisect (PyElastica 1.0.0, 50 elements), accurate to 5 %.
STEP_S = {"robot": 3.1e-4, "sheet": 3.0e-5}

N_ELEMENTS = 50
LENGTH, BODY_LENGTH = 0.37, 0.30  # m
EI_BODY, EI_TAIL = 0.038, 0.0058  # N m^2
RHO_WATER, HEIGHT, C_DRAG, C_ADDED = 1000.0, 0.03, 3.0, 1.0
LINE_MASS = 0.7 + C_ADDED * math.pi * RHO_WATER * HEIGHT**2 / 4  # kg/m, with the added mass
RADIUS = 0.015  # m, of the circular section
SHEET_E, SHEET_T, SHEET_POISSON = 2.9e9, 0.93e-3, 0.3  # Pa, m, -
EA_SHEET = SHEET_E * HEIGHT * SHEET_T  # N
EI_SHEET = SHEET_E * HEIGHT * SHEET_T**3 / 12  # N m^2
CHAMBERS = ((0.02, 0.145), (0.155, 0.28))  # m from the clamp
K_Q, P_LAG = 4.79e-7, 0.087  # m^3, s
P_SET = np.array([250e3, 0.9 * 250e3])  # Pa, front and rear
FREQUENCY, REAR_DELAY = 4.8, 0.15  # Hz, periods
DAMPING_RATE = 2e-3 * (2 * math.pi * FREQUENCY) ** 2  # 1/s


@njit
def _drag(velocity, tangents, node_lengths, coefficient, external_forces):
    """Adds the quadratic drag of the velocity normal to the rod to the nodes' forces."""
    last = velocity.shape[1] - 1
    for k in range(last + 1):
        before, after = max(k - 1, 0), min(k, last - 1)
        t0 = tangents[0, before] + tangents[0, after]
        t1 = tangents[1, before] + tangents[1, after]
        t2 = tangents[2, before] + tangents[2, after]
        v0, v1, v2 = velocity[0, k], velocity[1, k], velocity[2, k]
        along = (v0 * t0 + v1 * t1 + v2 * t2) / (t0 * t0 + t1 * t1 + t2 * t2)
        n0, n1, n2 = v0 - along * t0, v1 - along * t1, v2 - along * t2
        factor = -coefficient * node_lengths[k] * math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        external_forces[0, k] += factor * n0
        external_forces[1, k] += factor * n1
        external_forces[2, k] += factor * n2


@njit
def _couples(now, state, p_set, frequency, delay, lag, weights, external_torques):
    """Advances the chamber pressures (state: front, rear, time) and applies their couples."""
    decay = math.exp(-(now - state[2]) / lag)
    state[2] = now
    for c in range(2):
        target = p_set[c]
        if frequency > 0.0:
            phase = now * frequency - c * delay
            target *= 1.0 if phase - math.floor(phase) < 0.5 else -1.0
        state[c] = target + (state[c] - target) * decay
    for k in range(external_torques.shape[1]):  # about d1, which is the normal of the plane
        external_torques[0, k] += weights[0, k] * state[0] + weights[1, k] * state[1]


class SwimmerForcing(ea.NoForces):
    """Drag and actuation by the two chambers. With ``frequency=0``, set pressures are constant."""

    def __init__(self, p_set, frequency, drag_coefficient):
        self.p_set, self.frequency, self.drag_coefficient = p_set, frequency, drag_coefficient
        self.state = np.zeros(3)  # the two pressures and their time
        length = LENGTH / N_ELEMENTS
        self.node_lengths = np.full(N_ELEMENTS + 1, length)
        self.node_lengths[[0, -1]] *= 0.5
        # A couple between two element centres is divided between these elements. Its first moment
        # is conserved.
        self.weights = np.zeros((2, N_ELEMENTS))
        for c, ends in enumerate(CHAMBERS):
            for end, sign in zip(ends, (-1.0, 1.0), strict=True):
                k, share = divmod(end / length - 0.5, 1.0)
                self.weights[c, int(k)] += sign * K_Q * (1.0 - share)
                self.weights[c, int(k) + 1] += sign * K_Q * share

    def apply_forces(self, system, time=0.0):
        _drag(system.velocity_collection, system.tangents, self.node_lengths,
              self.drag_coefficient, system.external_forces)  # fmt: skip

    def apply_torques(self, system, time=0.0):
        _couples(time, self.state, self.p_set, self.frequency, REAR_DELAY, P_LAG, self.weights,
                 system.external_torques)  # fmt: skip


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


def make_rod(case):
    """Returns a straight rod along x that bends in the x-y plane (d1 = z)."""
    density, young = LINE_MASS / (math.pi * RADIUS**2), 4 * EI_BODY / (math.pi * RADIUS**4)
    rod = ea.CosseratRod.straight_rod(
        N_ELEMENTS, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]),
        LENGTH, RADIUS, density, youngs_modulus=young, shear_modulus=young / 3,
    )  # fmt: skip
    nodes = np.linspace(0.0, LENGTH, N_ELEMENTS + 1)
    in_tail = (nodes[1:] + nodes[:-1]) / 2 > BODY_LENGTH
    bends_tail = nodes[1:-1] > BODY_LENGTH
    if case == "robot":  # the same section in a softer material
        rod.shear_matrix[..., in_tail] *= EI_TAIL / EI_BODY
        rod.bend_matrix[..., bends_tail] *= EI_TAIL / EI_BODY
    else:  # a thin plate, whose shear modulus is E / (2 + 2 nu)
        ga = 5 / 6 * EA_SHEET / (2 + 2 * SHEET_POISSON)
        gj = 4 * EI_SHEET / (2 + 2 * SHEET_POISSON)
        rod.shear_matrix[..., in_tail] = np.diag([ga, ga, EA_SHEET])[..., None]
        rod.bend_matrix[..., bends_tail] = np.diag([EI_SHEET, EI_SHEET, gj])[..., None]
    return rod


def make_simulator(case, step, members=1, p_set=P_SET, frequency=FREQUENCY, rate=DAMPING_RATE):
    """Returns one simulator with all rods in one memory block, and the rods."""
    simulator, rods = Simulator(), []
    drag = RHO_WATER * C_DRAG * HEIGHT / 2
    for scale in np.linspace(1.0, 0.9, members):
        rod = make_rod(case)
        simulator.append(rod)
        simulator.constrain(rod).using(
            ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        simulator.add_forcing_to(rod).using(SwimmerForcing, p_set * scale, frequency, drag)
        simulator.dampen(rod).using(
            ea.AnalyticalLinearDamper, uniform_damping_constant=rate, time_step=step
        )
        rods.append(rod)
    simulator.finalize()
    return simulator, rods


def tip_position(rod):
    return rod.position_collection[:, -1]


def march(simulator, rod, step, duration, read=tip_position):
    """Returns `read(rod)` after every step, (steps, n), or None if the rod becomes unstable."""
    stepper, now = ea.PositionVerlet(), 0.0
    limit = 1.5 * rod.rest_lengths.sum()
    series = np.empty((math.ceil(duration / step - 1e-9), read(rod).size))
    np.seterr(all="ignore")
    for i in range(len(series)):
        try:
            now = stepper.step(simulator, now, step)
        except ZeroDivisionError:  # compiled kernels raise it after the rod becomes unstable
            return None
        if not np.abs(tip_position(rod)).max() < limit:  # also true for nan
            return None
        series[i] = read(rod)
    return series if np.isfinite(rod.velocity_collection).all() else None


def tip_history(case, step, duration=1.0, **kwargs):
    """Returns the lateral tip position after every step, or None if a value is not finite."""
    simulator, rods = make_simulator(case, step, **kwargs)
    tip = march(simulator, rods[0], step, duration)
    return None if tip is None else tip[:, 1]


def tip_range(case, step):
    """Returns the tip's peak-to-peak lateral motion [m] over the last stride of 1 s, or None."""
    tip, stride = tip_history(case, step), round(1 / FREQUENCY / step)
    return None if tip is None else float(np.ptp(tip[-stride:]))


def check_step(case, step):
    """Returns whether the step is usable, and the tip ranges with this step and a quarter of it."""
    if (here := tip_range(case, step)) is None:
        return False, None, None
    fine = tip_range(case, step / 4)
    return fine is not None and abs(here - fine) <= 0.02 * fine, here, fine


def largest_step(usable, start):
    """Returns the largest usable step with an error of 5 %, by bisection around `start`."""
    low, high = start / 2, start * 2
    while not usable(low):
        low, high = low / 2, low
    while usable(high):
        low, high = high, high * 2
    while high / low > 1.05:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if usable(middle) else (low, middle)
    return low


def bisect_step(case):
    """Returns the largest usable step of the case; see `check_step`."""

    def usable(step):
        good, *ranges = check_step(case, step)
        print(f"  {case}: {step:.3e} s,", *map(millimetres, ranges), good)
        return good

    return largest_step(usable, STEP_S[case])


def core_seconds(simulator, step, window, repeats):
    """Returns CPU and wall seconds per simulated second of each repeat, without compilation."""
    stepper, now, cpu, wall = ea.PositionVerlet(), 0.0, [], []
    n_steps = round(window / step)
    for _ in range(20):  # compiles and warms up
        now = stepper.step(simulator, now, step)
    for _ in range(repeats):
        c0, w0 = time.process_time(), time.perf_counter()
        for _ in range(n_steps):
            now = stepper.step(simulator, now, step)
        cpu.append((time.process_time() - c0) / (n_steps * step))
        wall.append((time.perf_counter() - w0) / (n_steps * step))
    return cpu, wall


def static_tip(pressure=45e3):
    """Returns the static tip [m] at a constant front pressure: simulated, and for small slopes."""
    load = {"p_set": np.array([pressure, 0.0]), "frequency": 0.0, "rate": 8.4}  # nearly critical
    settled = tip_history("robot", STEP_S["robot"], 3.0, **load)
    start, end = CHAMBERS[0]
    beam = K_Q * pressure / EI_BODY * (end - start) * (LENGTH - (start + end) / 2)
    return {"simulated_m": None if settled is None else float(settled[-1]), "beam_theory_m": beam}


def millimetres(value):
    return "none" if value is None else f"{value * 1e3:.2f} mm"


def machine_line():
    names = [platform.processor()]
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo") as lines:
            names = [x.split(":")[1].strip() for x in lines if x.startswith("model name")] + names
    return f"{names[0]}, {os.cpu_count()} logical cores, {platform.platform()}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", metavar="FILE.json", help="JSON file for the results")
    parser.add_argument(
        "--quick", action="store_true", help="use short windows, check no time step"
    )
    parser.add_argument("--bisect", action="store_true", help="search for the stable time steps")
    for case in STEP_S:
        text = f"stable time step of this case, in s (default: {STEP_S[case]:g})"
        parser.add_argument(f"--step-{case}", type=float, default=STEP_S[case], help=text)
    args = parser.parse_args()

    versions = {name: version(name) for name in ("pyelastica", "numba", "numpy")}
    report = {
        "versions": {"python": platform.python_version()} | versions,
        "machine": machine_line(),
        "rod": {"elements": N_ELEMENTS, "radius_m": RADIUS, "line_mass_kg_m": LINE_MASS,
                "ea_body_n": 4 * EI_BODY / RADIUS**2, "ea_tail_n": 4 * EI_TAIL / RADIUS**2,
                "ea_sheet_n": EA_SHEET, "ei_sheet_n_m2": EI_SHEET,
                "damping_rate_per_s": DAMPING_RATE},
        "tip_range_m": {}, "tip_range_fine_m": {}, "quick": args.quick,
    }  # fmt: skip
    print(report["machine"])
    print(", ".join(f"{name} {number}" for name, number in report["versions"].items()))
    repeats, shorten = (3, 4) if args.quick else (9, 1)
    for case in STEP_S:
        step = bisect_step(case) if args.bisect else getattr(args, f"step_{case}")
        here, fine = (tip_range(case, step), None) if args.quick else check_step(case, step)[1:]
        report["tip_range_m"][case], report["tip_range_fine_m"][case] = here, fine
        window = {"robot": 0.5, "sheet": 0.2}[case] / shorten
        simulator, _ = make_simulator(case, step)
        cpu, wall = core_seconds(simulator, step, window, repeats)
        result = {"step_s": step, "single_core_s_per_sim_s": min(cpu),
                  "single_core_s_per_sim_s_median": statistics.median(cpu),
                  "single_wall_s_per_sim_s_min": min(wall)}  # fmt: skip
        print(f"\n{case}: step {step:.3e} s, tip range {millimetres(here)} over the last stride"
              f" (at a quarter of the step: {millimetres(fine)})")  # fmt: skip
        print("  members   core-s per simulated s and member: min    median   (wall min)")
        print(f"  {1:7d} {min(cpu):40.4f} {statistics.median(cpu):9.4f} {min(wall):9.4f}")
        if case == "robot":
            result["batch"], result["batch_median"] = {}, {}
            for members in (16, 112):
                window = min(0.2, 11.2 / members) / shorten
                simulator, _ = make_simulator(case, step, members)
                cpu, wall = core_seconds(simulator, step, window, repeats)
                low, middle = min(cpu) / members, statistics.median(cpu) / members
                result["batch"][str(members)], result["batch_median"][str(members)] = low, middle
                print(f"  {members:7d} {low:40.4f} {middle:9.4f} {min(wall) / members:9.4f}")
        report[case] = result
    report["static_tip_45kpa_front"] = rest = static_tip()
    print("\nstatic tip at 45 kPa front:", ", ".join(f"{k} {v}" for k, v in rest.items()))
    if args.out:
        with open(args.out, "w") as file:
            file.write(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()

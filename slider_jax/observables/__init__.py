"""Pure, differentiable functions of a `Snapshot`, or of series saved by a rollout, that compute
forces, shapes, energies and waves. May import `dynamics` and the rooms below it."""

from slider_jax.observables.energy import (
    EnergyRates,
    StoredEnergy,
    chamber_power,
    clamp_power,
    energy_rates,
    stored_energy,
)
from slider_jax.observables.measured import carriage_force, lateral, midline, recoil, thrust, tip
from slider_jax.observables.strides import (
    force_efficiency,
    froude_efficiency,
    stride_means,
    strouhal_number,
    tail_slope,
)
from slider_jax.observables.wave import (
    BodyWave,
    body_wave,
    fundamental_mode,
    orthogonal_mode,
    shape_wavelength,
    travelling_index,
)

__all__ = [
    "BodyWave",
    "EnergyRates",
    "StoredEnergy",
    "body_wave",
    "carriage_force",
    "chamber_power",
    "clamp_power",
    "energy_rates",
    "force_efficiency",
    "froude_efficiency",
    "fundamental_mode",
    "lateral",
    "midline",
    "orthogonal_mode",
    "recoil",
    "shape_wavelength",
    "stored_energy",
    "stride_means",
    "strouhal_number",
    "tail_slope",
    "thrust",
    "tip",
    "travelling_index",
]

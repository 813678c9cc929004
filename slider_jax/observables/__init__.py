"""What is read off a rollout, by pure and differentiable functions.

Those of a `Snapshot` can be saved at every step; those of series work on what was saved.
"""

from slider_jax.observables.efficiency import (
    force_efficiency,
    froude_efficiency,
    strouhal_number,
    tail_slope,
)
from slider_jax.observables.energy import (
    EnergyRates,
    StoredEnergy,
    chamber_power,
    clamp_power,
    energy_rates,
    stored_energy,
)
from slider_jax.observables.forces import (
    carriage_force,
    recoil,
    thrust,
)
from slider_jax.observables.shape import (
    lateral,
    midline,
    tail_excursion,
    tip,
)
from slider_jax.observables.strides import (
    stride_means,
    stride_ranges,
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
    "stride_ranges",
    "strouhal_number",
    "tail_excursion",
    "tail_slope",
    "thrust",
    "tip",
    "travelling_index",
]

"""Computes forces, shapes, energies and waves from a `Snapshot` or a saved series, differentiably.
This package may import `dynamics` and packages of lower layers."""

from slider_jax.observables.energy import (
    Losses as Losses,
    StoredEnergy as StoredEnergy,
    chamber_power as chamber_power,
    losses as losses,
    power_given_to as power_given_to,
    stored_energy as stored_energy,
)
from slider_jax.observables.measured import (
    AnySnapshot as AnySnapshot,
    angle_at as angle_at,
    curvature_at as curvature_at,
    forward_speed as forward_speed,
    lateral as lateral,
    lateral_at as lateral_at,
    midline as midline,
    point as point,
    recoil as recoil,
    thrust as thrust,
    tip as tip,
    turning_rate_at as turning_rate_at,
    yaw_moment as yaw_moment,
)
from slider_jax.observables.strides import (
    force_efficiency as force_efficiency,
    froude_efficiency as froude_efficiency,
    stride_means as stride_means,
    strouhal_number as strouhal_number,
    tail_slope as tail_slope,
)
from slider_jax.observables.wave import (
    BodyWave as BodyWave,
    body_wave as body_wave,
    fundamental_mode as fundamental_mode,
    shape_wavelength as shape_wavelength,
    travelling_index as travelling_index,
)

"""Computes wavelength, speed and travelling index of the body wave.

A lateral motion y(s, t) = Re( c(s) exp(2 pi i f t) ) has an amplitude |c| and a phase arg c at each
point s, measured from the tail. A wave whose phase increases towards the head travels from head to
tail.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float


def _over(a, b):
    """Returns a/b for a real b; 0 with zero derivatives where b = 0."""
    inverse = jnp.where(b == 0.0, 0.0, 1.0 / jnp.where(b == 0.0, 1.0, b))
    return a * inverse.astype(jnp.result_type(a))


def _root(x):
    """Returns sqrt(x); 0 with a zero derivative where x <= 0."""
    return jnp.where(x > 0.0, jnp.sqrt(jnp.where(x > 0.0, x, 1.0)), 0.0)


class BodyWave(eqx.Module):
    """Wavelength and speed (scalars), both positive for a wave that travels from head to tail."""

    wavelength: Float[Array, ""]
    """Wavelength lambda [m] along the body."""
    speed: Float[Array, ""]
    """Wave speed V = lambda f [m/s]."""


def fundamental_mode(
    y: Float[Array, "times points"], t: Float[Array, " times"], frequency
) -> Complex[Array, " points"]:
    """Returns c(s) [m], the Fourier coefficient of `y` [m] at the drive's `frequency` f [Hz].

    c = (2/n) sum_t y exp(-2 pi i f t). The n times `t` [s] are evenly spaced over whole strides.
    """
    angle = 2.0 * math.pi * frequency * t[:, None]
    return 2.0 * jax.lax.complex(
        jnp.mean(y * jnp.cos(angle), axis=0), -jnp.mean(y * jnp.sin(angle), axis=0)
    )


def body_wave(mode: Complex[Array, " points"], s: Float[Array, " points"], frequency) -> BodyWave:
    """Returns wavelength and speed of a mode c(s) with `frequency` [Hz]; `s` [m] is from the tail.

    The wavelength is 2 pi/wavenumber, and the wavenumber is the slope of a line fitted to the phase
    along the body. The fit has weights |c|^2, since the phase is uncertain where |c| is small.
    The phase must change by less than half a turn between neighbouring points. In a nearly standing
    wave (`travelling_index` below about 0.2), the phase jumps by half a turn, in either direction,
    at each wave node. The wavelength and its sign are then unreliable.
    """
    turned = mode[1:] * jnp.conj(mode[:-1])
    # At a clamped head, the amplitude is zero, so the phase is undefined. Its weight is zero.
    still = jnp.abs(turned) == 0.0
    phase_steps = jnp.where(still, 0.0, jnp.angle(jnp.where(still, 1.0, turned)))
    phase = jnp.concatenate([jnp.zeros(1), jnp.cumsum(phase_steps)])
    weight = jnp.real(mode * jnp.conj(mode))
    weight = _over(weight, jnp.sum(weight))
    ds, dphase = s - jnp.sum(weight * s), phase - jnp.sum(weight * phase)
    wavenumber = _over(jnp.sum(weight * ds * dphase), jnp.sum(weight * ds**2))
    wavelength = jnp.where(wavenumber == 0.0, jnp.inf, _over(2.0 * math.pi, wavenumber))
    return BodyWave(wavelength=wavelength, speed=wavelength * frequency)


def shape_wavelength(
    mode: Complex[Array, " points"], s: Float[Array, " points"]
) -> Float[Array, ""]:
    """Returns the wavelength lambda [m] of a mode c(s) from the ratio of lateral motion to slope.

        lambda = 2 pi sqrt( int |c|^2 ds / int |dc/ds|^2 ds ),    `s` [m] from the tail

    For a travelling wave of constant amplitude, lambda is exact on a body of any length. For a
    standing or mixed wave, lambda is exact if the body length is a multiple of lambda/2. lambda is
    never negative; the sign from `body_wave` gives the direction. lambda is infinite if all points
    move equally.
    """
    ds = s[1:] - s[:-1]
    size, step = (jnp.real(c * jnp.conj(c)) for c in (mode, mode[1:] - mode[:-1]))
    swing, slope = jnp.sum(0.5 * (size[1:] + size[:-1]) * ds), jnp.sum(step / ds)
    wavenumber = _root(_over(slope, swing))
    return jnp.where(wavenumber == 0.0, jnp.inf, _over(2.0 * math.pi, wavenumber))


def travelling_index(mode: Complex[Array, " points"]) -> Float[Array, ""]:
    """Returns the travelling index [-]: 1 for a pure travelling wave, 0 for a pure standing wave.

    The index is the smaller singular value of [Re c, Im c] divided by the larger singular value
    (Feeny 2008: the reciprocal condition number). For a body at rest, the index is 0.
    """
    a, b = jnp.real(mode), jnp.imag(mode)
    mean, cross = 0.5 * (a @ a + b @ b), a @ b
    half = _root((0.5 * (a @ a - b @ b)) ** 2 + cross**2)
    return _over(_root((a @ a) * (b @ b) - cross**2), mean + half)

"""The travelling wave of the body: its wavelength, speed, and how purely it travels.

A lateral motion y(s, t) = Re( c(s) exp(2 pi i f t) ) has at each point an amplitude |c| and a phase
arg c. Where the phase grows towards the head (s is from the tail) the wave runs from head to tail.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float


def _over(a, b):
    """a/b for a real b, and 0 with zero derivatives where b = 0."""
    inverse = jnp.where(b == 0.0, 0.0, 1.0 / jnp.where(b == 0.0, 1.0, b))
    return a * inverse.astype(jnp.result_type(a))


def _root(x):
    """sqrt(x), and 0 with a zero derivative where x <= 0."""
    return jnp.where(x > 0.0, jnp.sqrt(jnp.where(x > 0.0, x, 1.0)), 0.0)


class BodyWave(eqx.Module):
    """A body wave; scalars. Both are positive for a wave that runs from head to tail."""

    wavelength: Float[Array, ""]
    """lambda [m], along the body."""
    speed: Float[Array, ""]
    """V = lambda f [m/s]."""


def fundamental_mode(
    y: Float[Array, "times points"], t: Float[Array, " times"], frequency
) -> Complex[Array, " points"]:
    """c(s) [m] of the stride's fundamental: the Fourier coefficient at `frequency` [Hz].

    c = (2/n) sum_t y exp(-2 pi i f t). `t` [s] are equal steps over whole strides.
    """
    angle = 2.0 * math.pi * frequency * t[:, None]
    return 2.0 * jax.lax.complex(
        jnp.mean(y * jnp.cos(angle), axis=0), -jnp.mean(y * jnp.sin(angle), axis=0)
    )


def orthogonal_mode(y: Float[Array, "times points"]) -> Complex[Array, " points"]:
    """c(s) [m] of the first complex orthogonal mode, with the phases of t = the first sample.

    The dominant eigenvector of the covariance of the analytic signal of y - mean(y), scaled by its
    rms in time so that |c| is its amplitude; zero where nothing moves. Needs no frequency; equal
    steps over whole strides.

    Source: Feeny, B. F. (2008), A complex orthogonal decomposition for wave motion analysis, J.
    Sound Vib. 310, 77-90.
    """
    steps = y.shape[0]
    spectrum = jnp.fft.fft(y - jnp.mean(y, axis=0), axis=0)
    index = jnp.arange(float(steps))
    keep = jnp.where(
        (index > 0) & (2 * index < steps), 2.0, jnp.where(2 * index == steps, 1.0, 0.0)
    )
    analytic = jnp.fft.ifft(spectrum * keep[:, None].astype(spectrum.dtype), axis=0)
    covariance = analytic.T @ jnp.conj(analytic) / float(steps)
    # The projector on the dominant eigenvector, by squaring: an SVD has no derivative where other
    # singular values coincide, and all but a few of these are zero.
    projector = covariance
    for _ in range(12):
        projector = _over(projector, jnp.real(jnp.trace(projector)))
        projector = projector @ projector
    projector = _over(projector, jnp.real(jnp.trace(projector)))
    first = projector @ analytic[0]
    size = _root(jnp.real(jnp.trace(projector @ covariance)))
    return _over(first, _root(jnp.real(jnp.vdot(first, first)))) * size.astype(first.dtype)


def body_wave(mode: Complex[Array, " points"], s: Float[Array, " points"], frequency) -> BodyWave:
    """Wavelength and speed from a mode c(s) at `s` [m] from the tail, and its `frequency` [Hz].

    The wavenumber is the slope of the straight line through the phase along the body, fitted with
    weights |c|^2, as the phase of a point that hardly moves means little; lambda = 2 pi/wavenumber.
    Points must be close enough that the phase turns by less than half a turn between neighbours.
    Of a nearly standing wave (`travelling_index` below about 0.2) the phase jumps by half a turn at
    each node, one way or the other, and neither length nor sign means much.
    """
    turned = mode[1:] * jnp.conj(mode[:-1])
    # A clamped head does not move: where both are zero the phase is undefined, and weightless.
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
    """lambda [m] of the shape: how far the body swings for how steep it is, over a stride.

        lambda = 2 pi sqrt( int |c|^2 ds / int |dc/ds|^2 ds ),    `s` [m] from the tail

    That of the wave where it travels with one amplitude, on any length of body; and where it
    stands, or does both, on a body of whole half waves. Unlike the phase of `body_wave` it means
    the same for all of these, and tells no direction. Infinite where all points move alike.
    """
    ds = s[1:] - s[:-1]
    size, step = (jnp.real(c * jnp.conj(c)) for c in (mode, mode[1:] - mode[:-1]))
    swing, slope = jnp.sum(0.5 * (size[1:] + size[:-1]) * ds), jnp.sum(step / ds)
    wavenumber = _root(_over(slope, swing))
    return jnp.where(wavenumber == 0.0, jnp.inf, _over(2.0 * math.pi, wavenumber))


def travelling_index(mode: Complex[Array, " points"]) -> Float[Array, ""]:
    """1 for a pure travelling wave, 0 for a pure standing one.

    The ratio of the singular values of [Re c, Im c] (Feeny 2008, the reciprocal condition number);
    0 where nothing moves.
    """
    a, b = jnp.real(mode), jnp.imag(mode)
    mean, cross = 0.5 * (a @ a + b @ b), a @ b
    half = _root((0.5 * (a @ a - b @ b)) ** 2 + cross**2)
    return _over(_root((a @ a) * (b @ b) - cross**2), mean + half)

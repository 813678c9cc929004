"""The exact motion of an animal that swims with a known wave."""

import math

import numpy as np

from calibration.lamprey.animal import CrossSections
from calibration.lamprey.motion import motion_from_angles

SHAPE = CrossSections(np.linspace(0.0, 1.0, 11), np.linspace(0.036, 0.01, 11))

L, F, U = 0.15, 4.0, 0.3

WAVES = 1.4


def wave(amplitude, t, nodes=161, speed=U, grow=0.0):
    """Returns exact motion with the head at y = a(s) cos(k s + w t) and phi the wave's slope."""
    s = np.linspace(0.0, L, nodes)
    k, w = 2.0 * math.pi * WAVES / L, 2.0 * math.pi * F
    envelope = amplitude * (1.0 - grow * s / L)
    phase = k * s + w * t[:, None]
    slope = [
        w**i * (-k * envelope * _sine(phase, i) - grow * amplitude / L * _cosine(phase, i))
        for i in range(3)
    ]
    head = [
        np.stack([x, w**i * envelope[-1] * _cosine(k * L + w * t, i)], axis=1)
        for i, x in enumerate((speed * t, np.full_like(t, speed), 0.0 * t))
    ]
    return motion_from_angles(t, s, slope, head)


def one_stride(count=48):
    return np.arange(count) / (count * F)


def _sine(x, derivative):
    return np.sin(x + 0.5 * math.pi * derivative)


def _cosine(x, derivative):
    return np.cos(x + 0.5 * math.pi * derivative)

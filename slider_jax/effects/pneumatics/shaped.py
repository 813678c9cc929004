"""A set pressure through a static curve."""

from collections.abc import Callable

from jaxtyping import Array

from slider_jax.actuation.waveform import Segment, Waveform


class Shaped(Waveform):
    """curve(wave); exact for straight curves and for set pressures that are constant in steps.

    `curve` takes and gives a set pressure [Pa]; it is a pytree, as a method of an effect is.
    """

    wave: Waveform
    curve: Callable[[Array], Array]

    def segment(self, t0, t1):
        x = self.wave.segment(t0, t1)
        ends = (self.curve(p) for p in (x.a0, x.a1, x.b0, x.b1))
        return Segment(x.t0, x.t_break, x.t1, *ends)

"""From what is there to what is recorded: a model's instruments, applied to whole series."""

from slider_jax.effects import Effect, Instrument, Readings, of_place


def recorded(effects: tuple[Effect, ...], true: Readings) -> Readings:
    """What the sensors record; the model's instruments read in their order."""
    for effect in of_place(effects, Instrument):
        true = effect.read(true)
    return true

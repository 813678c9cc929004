"""What a line and its sensors do wrong, by chance that can be repeated."""

from dataclasses import dataclass, field
from random import Random


@dataclass(frozen=True)
class LineFaults:
    """Shares of bytes flipped, dropped and inserted, either way; and what happens at times [s]."""

    flipped: float = 0.0
    dropped: float = 0.0
    inserted: float = 0.0
    reset_at: float | None = None
    """The manifold starts anew."""
    silent: tuple[float, float] | None = None
    """From when to when it sends nothing; all of it comes at the end, late."""
    stuck: tuple[int, float] | None = None
    """A channel, and from when it reads the same."""
    noise: float = 0.0
    """Standard deviation of the chambers' pressures [Pa]."""
    tip_noise: float = 0.0
    """Of the tip's place [m]."""
    seed: int = 0


@dataclass
class FaultyLine:
    """Damages bytes as a `LineFaults` says, and counts how many it touched."""

    faults: LineFaults
    touched: int = 0
    _random: Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = Random(self.faults.seed)

    def damage(self, piece: bytes) -> bytes:
        """What arrives of a piece."""
        m = self.faults
        share = m.flipped + m.dropped + m.inserted
        if not share or not piece:
            return piece
        arrived = bytearray()
        for byte in piece:
            chance = self._random.random()
            if chance >= share:
                arrived.append(byte)
                continue
            self.touched += 1
            if chance < m.flipped:
                arrived.append(byte ^ (1 << self._random.randrange(8)))
            elif chance < m.flipped + m.inserted:
                arrived += bytes([self._random.randrange(256), byte])
        return bytes(arrived)

"""What a manifold does: limits, watchdog, waveforms and venting, in virtual time."""

import pytest

from rig.protocol.messages import (
    Ack,
    Answer,
    Arm,
    Cause,
    Event,
    Follows,
    FrameDecoder,
    Heartbeat,
    Hello,
    Ident,
    ManifoldState,
    Reading,
    SetLimits,
    SetPressures,
    Stop,
    WaveBegin,
    WavePiece,
    WavePlay,
    encode_frame,
)
from rig.simulated.manifold import ManifoldCore

LIMITS = SetLimits(1, 1000, 2000, 3000, 4000)
REST = (0, 0, 0, 0, 600_000, 0, 0, 0)


class Bench:
    """A core, its clock, and what it said that was no reading."""

    def __init__(self, *messages):
        self.core, self.now, self._decoder = ManifoldCore(), 0, FrameDecoder()
        self.readings = []
        self.said = self._heard(self.core.tick(0, REST))
        for message in messages:
            self.say(message)

    def _heard(self, wire):
        found = self._decoder.feed(wire)
        self.readings += [m for m in found if isinstance(m, Reading)]
        return [m for m in found if not isinstance(m, Reading)]

    def say(self, message):
        self.said = self._heard(self.core.feed(encode_frame(message), self.now))
        return self.said

    def wait(self, seconds, channels=REST, step=1000):
        said = []
        for _ in range(round(seconds * 1e6) // step):
            self.now += step
            said += self._heard(self.core.tick(self.now, channels))
        self.said = said
        return said


def test_it_says_that_it_was_reset_and_who_it_is():
    bench = Bench()
    assert bench.said == [Event(0, Cause.RESET, 0)] and bench.core.state == ManifoldState.BOOT
    assert bench.say(Hello(9)) == [Ident(1, 1, 1, 0, 2000, 500, *[500_000] * 4)]


def test_nothing_is_set_before_limits_and_arming():
    bench = Bench()
    for message in (Arm(1), SetPressures(1, 1, 1, 1, 1), WavePlay(1, 0), WaveBegin(1, 2, 500)):
        (ack,) = bench.say(message)
        assert ack.answer == Answer.WRONG_STATE and bench.core.set_pressures is None
    bench.say(LIMITS)
    (ack,) = bench.say(SetPressures(1, 1, 1, 1, 1))
    assert ack.answer == Answer.WRONG_STATE and bench.core.set_pressures is None
    assert bench.say(Arm(2)) == [Ack(2, 3, Answer.DONE, 0), Follows(0, 0, 0, 0, 0, 0)]
    assert bench.core.set_pressures == (0, 0, 0, 0)


def test_set_pressures_are_followed_up_to_their_limits():
    bench = Bench(LIMITS, Arm(2))
    assert bench.say(SetPressures(77, 1000, 0, 3000, 4000)) == [Follows(1, 0, 1000, 0, 3000, 4000)]
    # The same ones again are no change.
    assert bench.say(SetPressures(77, 1000, 0, 3000, 4000)) == []
    assert bench.core.set_pressures == (1000, 0, 3000, 4000)
    bench.wait(0.004)
    assert [r.command for r in bench.readings] == [77, 77]


@pytest.mark.parametrize(
    ("pressures", "answer", "chamber"),
    [
        ((1001, 0, 0, 0), Answer.ABOVE_LIMIT, 0),
        ((0, 0, 0, 2**31 - 1), Answer.ABOVE_LIMIT, 3),
        ((0, 0, -1, 0), Answer.BELOW_ZERO, 2),
    ],
)
def test_a_pressure_outside_its_limits_is_refused_and_vents(pressures, answer, chamber):
    bench = Bench(LIMITS, Arm(2), SetPressures(3, 5, 5, 5, 5))
    assert bench.say(SetPressures(4, *pressures)) == [
        Ack(4, 4, answer, chamber),
        Event(0, Cause.REFUSED, chamber),
    ]
    assert bench.core.state == ManifoldState.FAULT and bench.core.set_pressures is None
    (ack,) = bench.say(Arm(5))
    assert ack.answer == Answer.WRONG_STATE
    bench.say(LIMITS)
    assert bench.core.state == ManifoldState.READY


def test_no_limit_can_be_above_the_hard_one():
    bench = Bench()
    assert bench.say(SetLimits(1, 1, 1, 500_001, 1)) == [Ack(1, 2, Answer.ABOVE_LIMIT, 2)]
    assert bench.core.state == ManifoldState.BOOT
    bench.say(LIMITS)
    bench.say(Arm(2))
    said = bench.say(SetLimits(3, 1, -1, 1, 1))
    assert said == [Ack(3, 2, Answer.BELOW_ZERO, 1), Event(0, Cause.REFUSED, 1)]
    assert bench.core.set_pressures is None


def test_silence_of_a_tenth_of_a_second_vents():
    bench = Bench(LIMITS, Arm(2), SetPressures(3, 5, 5, 5, 5))
    assert bench.wait(0.099) == [] and bench.core.set_pressures is not None
    assert bench.wait(0.001) == [Event(100_000, Cause.WATCHDOG, 100)]
    assert bench.core.set_pressures is None


def test_any_sound_frame_keeps_it_going_and_noise_does_not():
    bench = Bench(LIMITS, Arm(2))
    for _ in range(5):
        bench.wait(0.09)
        bench.say(Heartbeat(9))
    assert bench.core.state == ManifoldState.ARMED
    for _ in range(3):
        bench.wait(0.04)
        bench.core.feed(b"\x07noise\0" + encode_frame(Event(1, 2, 3)), bench.now)
    assert bench.core.state == ManifoldState.FAULT and bench.core.damaged == 6


def test_stop_vents_in_every_state():
    for before in (
        (),
        (LIMITS,),
        (LIMITS, Arm(2)),
        (LIMITS, Arm(2), SetPressures(3, 9999, 0, 0, 0)),
    ):
        bench = Bench(*before)
        state = bench.core.state
        assert bench.say(Stop(8)) == [Ack(8, 6, Answer.DONE, 0), Event(0, Cause.STOPPED, 0)]
        assert bench.core.set_pressures is None
        left = {ManifoldState.ARMED: ManifoldState.READY}.get(state, state)
        assert bench.core.state == left


def test_a_chamber_above_its_limit_vents():
    bench = Bench(LIMITS, Arm(2))
    allowed = (1100 + 5000, 2200 + 5000, 3300 + 5000, 4400 + 5000, 0, 0, 0, 0)
    assert bench.wait(0.01, allowed) == []
    over = (*allowed[:3], allowed[3] + 1, 0, 0, 0, 0)
    assert bench.wait(0.001, over) == [Event(11_000, Cause.OVER_PRESSURE, 3)]
    assert bench.core.state == ManifoldState.FAULT


def test_a_waveform_is_played_sample_by_sample_and_ends_armed():
    wave = tuple((100 * i, 0, 10 * i, 0) for i in range(5))
    flat = tuple(p for row in wave for p in row)
    bench = Bench(LIMITS, WaveBegin(2, 5, 2000), WavePiece(3, 3, flat[12:]))
    assert bench.say(Arm(4))[0].answer == Answer.DONE
    assert bench.say(WavePlay(5, 2)) == [Ack(5, 9, Answer.WRONG_PLACE, 0)]
    assert bench.say(WavePiece(6, 0, flat[:12])) == [Ack(6, 8, Answer.DONE, 0)]
    bench.say(WavePlay(7, 2))
    followed = [bench.core.set_pressures]
    for _ in range(9):
        bench.wait(0.002)
        followed.append(bench.core.set_pressures)
    assert followed == [*wave, *wave] and bench.core.state == ManifoldState.PLAYING
    assert bench.wait(0.002) == [Event(20_000, Cause.PLAYED, 0)]
    assert bench.core.state == ManifoldState.ARMED and bench.core.set_pressures == wave[-1]


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        (WaveBegin(9, 1, 2000), Answer.WRONG_PLACE),
        (WaveBegin(9, 2001, 2000), Answer.WRONG_PLACE),
        (WaveBegin(9, 5, 499), Answer.WRONG_PLACE),
        (WavePiece(9, 2, (0,) * 4), Answer.WRONG_PLACE),
        (WavePiece(9, 0, (0, 0, 3001, 0)), Answer.ABOVE_LIMIT),
        (WavePiece(9, 0, (0, 0, 0, -1)), Answer.BELOW_ZERO),
    ],
)
def test_a_waveform_outside_its_place_or_its_limits_is_refused(message, answer):
    bench = Bench(LIMITS, WaveBegin(2, 2, 2000))
    (ack,) = bench.say(message)
    assert ack.answer == answer


def test_readings_are_numbered_and_none_is_left_out_of_a_late_pass():
    bench = Bench()
    bench.wait(0.01)
    bench.wait(0.05, step=50_000)
    assert [r.seq for r in bench.readings] == list(range(30))
    assert [r.device_us for r in bench.readings] == [2000 * i for i in range(1, 31)]

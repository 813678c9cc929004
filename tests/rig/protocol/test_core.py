"""The manifold's state machine: limits, watchdog, waveforms and venting, in virtual time."""

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

LIMITS = SetLimits(1, (1000, 2000, 3000, 4000))
REST = (0, 0, 0, 0, 600_000, 0, 0, 0)


class Bench:
    """A core with a virtual clock; `replies` are its last messages that are not readings."""

    def __init__(self, *messages, core=None):
        self.core, self.now, self._decoder = core or ManifoldCore(), 0, FrameDecoder()
        self.readings = []
        self.replies = self._decode(self.core.tick(0, REST))
        for message in messages:
            self.send(message)

    def _decode(self, sent):
        messages = self._decoder.feed(sent)
        self.readings += [m for m in messages if isinstance(m, Reading)]
        return [m for m in messages if not isinstance(m, Reading)]

    def send(self, message):
        self.replies = self._decode(self.core.feed(encode_frame(message), self.now))
        return self.replies

    def wait(self, seconds, channels=REST, step=1000):
        self.replies = []
        for _ in range(round(seconds * 1e6) // step):
            self.now += step
            self.replies += self._decode(self.core.tick(self.now, channels))
        return self.replies


def test_it_reports_its_reset_and_its_identity():
    bench = Bench()
    assert bench.replies == [Event(0, Cause.RESET, 0)] and bench.core.state == ManifoldState.BOOT
    assert bench.send(Hello(9)) == [Ident(1, 1, 1, 0, 2000, 500, (500_000,) * 4)]


def test_the_valves_follow_no_pressure_before_limits_and_arming():
    bench = Bench()
    for message in (Arm(1), SetPressures(1, (1, 1, 1, 1)), WavePlay(1, 0), WaveBegin(1, 2, 500)):
        (ack,) = bench.send(message)
        assert ack.answer == Answer.WRONG_STATE and bench.core.set_pressures is None
    bench.send(LIMITS)
    (ack,) = bench.send(SetPressures(1, (1, 1, 1, 1)))
    assert ack.answer == Answer.WRONG_STATE and bench.core.set_pressures is None
    assert bench.send(Arm(2)) == [Ack(2, 3, Answer.DONE, 0), Follows(0, 0, (0, 0, 0, 0))]
    assert bench.core.set_pressures == (0, 0, 0, 0)


def test_set_pressures_are_followed_up_to_their_limits():
    bench = Bench(LIMITS, Arm(2))
    assert bench.send(SetPressures(77, (1000, 0, 3000, 4000))) == [
        Follows(1, 0, (1000, 0, 3000, 4000))
    ]
    # Equal pressures are not a change.
    assert bench.send(SetPressures(77, (1000, 0, 3000, 4000))) == []
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
    bench = Bench(LIMITS, Arm(2), SetPressures(3, (5, 5, 5, 5)))
    assert bench.send(SetPressures(4, pressures)) == [
        Ack(4, 4, answer, chamber),
        Event(0, Cause.REFUSED, chamber),
    ]
    assert bench.core.state == ManifoldState.FAULT and bench.core.set_pressures is None
    (ack,) = bench.send(Arm(5))
    assert ack.answer == Answer.WRONG_STATE
    bench.send(LIMITS)
    assert bench.core.state == ManifoldState.READY


def test_no_limit_can_exceed_the_hard_limit():
    bench = Bench()
    assert bench.send(SetLimits(1, (1, 1, 500_001, 1))) == [Ack(1, 2, Answer.ABOVE_LIMIT, 2)]
    assert bench.core.state == ManifoldState.BOOT
    bench.send(LIMITS)
    bench.send(Arm(2))
    replies = bench.send(SetLimits(3, (1, -1, 1, 1)))
    assert replies == [Ack(3, 2, Answer.BELOW_ZERO, 1), Event(0, Cause.REFUSED, 1)]
    assert bench.core.set_pressures is None


def test_a_tenth_of_a_second_without_commands_vents():
    bench = Bench(LIMITS, Arm(2), SetPressures(3, (5, 5, 5, 5)))
    assert bench.wait(0.099) == [] and bench.core.set_pressures is not None
    assert bench.wait(0.001) == [Event(100_000, Cause.WATCHDOG, 100)]
    assert bench.core.set_pressures is None


def test_valid_frames_keep_it_armed_and_noise_does_not():
    bench = Bench(LIMITS, Arm(2))
    for _ in range(5):
        bench.wait(0.09)
        bench.send(Heartbeat(9))
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
        (LIMITS, Arm(2), SetPressures(3, (9999, 0, 0, 0))),
    ):
        bench = Bench(*before)
        state = bench.core.state
        assert bench.send(Stop(8)) == [Ack(8, 6, Answer.DONE, 0), Event(0, Cause.STOPPED, 0)]
        assert bench.core.set_pressures is None
        expected = {ManifoldState.ARMED: ManifoldState.READY}.get(state, state)
        assert bench.core.state == expected


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
    assert bench.send(Arm(4))[0].answer == Answer.DONE
    assert bench.send(WavePlay(5, 2)) == [Ack(5, 9, Answer.WRONG_PLACE, 0)]
    assert bench.send(WavePiece(6, 0, flat[:12])) == [Ack(6, 8, Answer.DONE, 0)]
    bench.send(WavePlay(7, 2))
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
def test_a_waveform_of_wrong_size_or_above_its_limits_is_refused(message, answer):
    bench = Bench(LIMITS, WaveBegin(2, 2, 2000))
    (ack,) = bench.send(message)
    assert ack.answer == answer


def test_a_manifold_ignores_commands_for_another_number_of_chambers():
    bench = Bench(core=ManifoldCore((5000,) * 3))
    assert bench.send(Hello(1))[0].limits == (5000,) * 3
    for wrong in (SetLimits(1, (9,) * 4), SetPressures(1, (9,) * 2), WavePiece(1, 0, (9,) * 4)):
        assert bench.send(wrong) == []
    assert bench.core.damaged == 3
    bench.send(SetLimits(2, (1000, 2000, 3000)))
    bench.send(WaveBegin(3, 2, 2000))
    assert bench.send(WavePiece(4, 0, (1, 2, 3, 4, 5, 6))) == [Ack(4, 8, Answer.DONE, 0)]
    assert bench.send(Arm(5))[1] == Follows(0, 0, (0, 0, 0))
    bench.send(WavePlay(6, 1))
    assert bench.core.set_pressures == (1, 2, 3)
    bench.wait(0.002, (0, 0, 0, 600_000, 0, 0, 0))
    assert bench.core.set_pressures == (4, 5, 6)


def test_readings_are_numbered_and_a_late_pass_skips_none():
    bench = Bench()
    bench.wait(0.01)
    bench.wait(0.05, step=50_000)
    assert [r.seq for r in bench.readings] == list(range(30))
    assert [r.device_us for r in bench.readings] == [2000 * i for i in range(1, 31)]

"""Tests of a swimming animal's axial force balance: closed forms for known motions, and data."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.lamprey import balance as lamprey
from calibration.lamprey.animal import CrossSections, force_on_body, inertia, momentum, prescribe
from calibration.lamprey.axial_balance import EFFECTS, central_interval, stride_weights
from calibration.lamprey.balance import analyse_midlines, balance_verdict, imbalance_errors
from calibration.lamprey.midlines import Midlines, read_midlines, read_width
from calibration.lamprey.motion import (
    Smoothing,
    choose_smoothing,
    midline_motion,
    twicing_spline,
    white_noise,
)
from calibration.lamprey.strides import animal_gait, whole_strides
from slider_jax.cli.main import main
from slider_jax.effects import NormalDrag, ReactiveForce
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.effects.water.thinned_friction import ThinnedFriction
from slider_jax.errors import InputError
from tests.support.swimming_animal import SHAPE, WAVES, F, L, U, one_stride, wave


def traced(amplitude=0.012, noise=1e-4, frames=80, points=20):
    """Returns midlines of a swimming wave as a 50 Hz camera traces them, and the exact motion."""
    t = 0.02 * np.arange(frames)
    exact = wave(amplitude, t, grow=0.7)
    at = np.linspace(L, 0.0, points)
    r = np.stack([np.stack([np.interp(at, exact.s, x) for x in frame.T], 1) for frame in exact.r])
    rng = np.random.default_rng(3)
    return Midlines(t, r + noise * rng.standard_normal(r.shape), 0), exact


def test_mean_thrust_of_a_small_wave_equals_lighthills_formula():
    """m_A (h_t^2 - U^2 h_x^2)/2 at the tail's end; the rounded snout has no added mass."""
    a, t = 1e-4, one_stride()
    prescribed = prescribe(wave(a, t), SHAPE)
    found = float(np.asarray(force_on_body(ReactiveForce(1.0), prescribed))[:, 0].mean())
    m_A = math.pi * 1000.0 * (SHAPE.tail_depth * L) ** 2 / 4.0
    k, w = 2.0 * math.pi * WAVES / L, 2.0 * math.pi * F
    known = 0.5 * m_A * 0.5 * a**2 * (w**2 - (U * k) ** 2)
    print(f"{found:.4e} N, Lighthill {known:.4e} N")
    assert found == pytest.approx(known, rel=0.02)


def test_mean_reactive_force_is_minus_the_momentum_flux_at_the_tail():
    """For a wave of large amplitude, over one stride."""
    t = one_stride(96)
    moved = wave(0.01, t)
    found = np.asarray(force_on_body(ReactiveForce(1.0), prescribe(moved, SHAPE))).mean(axis=0)
    phi, V = moved.phi[:, 0], moved.V[:, 0]
    tau, n = np.stack([np.cos(phi), np.sin(phi)], 1), np.stack([-np.sin(phi), np.cos(phi)], 1)
    u_tau, u_n = ((V * e).sum(axis=1)[:, None] for e in (tau, n))
    m_A = math.pi * 1000.0 * (SHAPE.tail_depth * L) ** 2 / 4.0
    flux = m_A * (u_tau * u_n * n - 0.5 * u_n**2 * tau)
    # The momentum of the water beside the body is periodic, so only the flux at the tail remains.
    print(found, -flux.mean(axis=0))
    np.testing.assert_allclose(found, -flux.mean(axis=0), rtol=0.01, atol=1e-3 * abs(found[0]))


def test_inertia_is_the_rate_of_momentum():
    t = one_stride(192)
    prescribed = prescribe(wave(0.01, t), SHAPE)
    P, rate = np.asarray(momentum(prescribed)), np.asarray(inertia(prescribed))
    numeric = (np.roll(P, -1, axis=0) - np.roll(P, 1, axis=0)) / (2.0 * (t[1] - t[0]))
    np.testing.assert_allclose(rate, numeric, atol=2e-3 * np.abs(rate).max())


def test_no_force_acts_on_a_body_at_rest_and_only_friction_on_a_gliding_body():
    t = one_stride(8)
    still, gliding = (prescribe(wave(0.0, t, speed=x), SHAPE) for x in (0.0, U))
    for effect in EFFECTS.values():
        assert np.abs(np.asarray(force_on_body(effect, still))).max() < 1e-15
    for effect in (ReactiveForce(1.0), NormalDrag(3.0)):
        assert np.abs(np.asarray(force_on_body(effect, gliding))).max() < 1e-12
    H, ds = gliding.body.structure.height, gliding.body.structure.ds
    area = float((H * ds).sum())
    along = np.asarray(force_on_body(TangentialFriction(0.02), gliding))[:, 0]
    np.testing.assert_allclose(along, -0.5 * 1000.0 * 0.02 * (2.0 * area) * U**2)
    np.testing.assert_allclose(
        np.asarray(force_on_body(HeadDrag(3e-5), gliding))[:, 0], -0.5 * 1000.0 * 3e-5 * U**2
    )


def test_taylors_friction_of_a_yawed_cylinder():
    """2.7 rho d U^2 R^(-1/2) cos(a) sin(a)^(1/2) per length, from Taylor's paper, at 30 degrees."""
    prescribed = prescribe(wave(0.0, one_stride(4), speed=U), SHAPE)
    a = math.radians(30.0)
    x = replace_section(prescribed.x, u_tau=U * math.cos(a), u_n=U * math.sin(a))
    F_tau, _ = ThinnedFriction(1.0).force(x)
    d = np.asarray(x.height)
    R = U * d / 1e-6
    known = 2.7 * 1000.0 * d * U**2 * R**-0.5 * math.cos(a) * math.sin(a) ** 0.5
    np.testing.assert_allclose(-np.asarray(F_tau), known, rtol=1e-4)


def replace_section(x, **values):
    return replace(x, **{n: 0.0 * x.u_n + v for n, v in values.items()})


def test_smoothing_keeps_half_of_an_amplitude_at_the_cutoff_and_all_far_below():
    t = 0.01 * np.arange(400)
    inner = slice(100, 300)
    for f, share in ((4.0, 0.5), (1.0, 1.0), (16.0, 0.0)):
        y = np.sin(2.0 * math.pi * f * t)
        kept = twicing_spline(t, y, 4.0)(t, 0)
        gain = (kept * y)[inner].sum() / (y * y)[inner].sum()
        assert gain == pytest.approx(share, abs=0.02), f


def test_motion_is_recovered_from_traced_midlines():
    """With noise of 0.1 mm, and also if the traced length of every other frame is 3 % short."""
    midlines, exact = traced()
    cut = np.linspace(0.0, 1.0, 20)[None, :, None] * np.where(np.arange(80) % 2, 0.97, 1.0)[
        :, None, None
    ]  # fmt: skip
    shorter = np.stack(
        [
            np.stack([np.interp(c[:, 0], np.linspace(0, 1, 20), x) for x in frame.T], 1)
            for c, frame in zip(cut, midlines.points, strict=True)
        ]
    )
    for points in (midlines.points, shorter):
        found = midline_motion(replace(midlines, points=points), Smoothing(0.2, 13.0), L)
        inner = (slice(6, -6), slice(None))
        at = [int(np.argmin(np.abs(exact.s - s))) for s in found.s]
        off = np.abs(found.r - exact.r[:, at])[inner]
        speed = np.sqrt(np.mean((found.V - exact.V[:, at])[inner] ** 2))
        print(f"largest error {1e3 * off.max():.2f} mm, rms error of velocity {speed:.4f} m/s")
        assert off.max() < 1e-3
        assert speed < 0.012
    lengths = np.hypot(*np.diff(found.r, axis=1).transpose(2, 0, 1)).sum(axis=1)
    np.testing.assert_allclose(lengths, L, rtol=1e-12)


def test_smoothing_is_stronger_for_noisier_midlines():
    clean, rough = (choose_smoothing(traced(noise=x)[0]) for x in (2e-5, 4e-4))
    print(clean, rough)
    assert rough.wavelength > clean.wavelength and rough.cutoff <= clean.cutoff
    assert 1.5 * F < rough.cutoff <= clean.cutoff < 25.0
    series = 0.3 * np.random.default_rng(0).standard_normal(4000)
    assert white_noise(series) == pytest.approx(0.3, rel=0.05)


def test_strides_and_gait_of_a_known_wave_are_recovered():
    midlines, exact = traced()
    found = midline_motion(midlines, choose_smoothing(midlines))
    strides = whole_strides(found)
    gait = animal_gait(found, strides, 1e-6)
    assert strides.number == 5 and strides.frequency == pytest.approx(F, rel=0.01)
    assert np.ptp(np.diff(strides.marks)) < 0.02
    course = exact.r.mean(axis=1)
    U_exact = np.hypot(*(course[-1] - course[0])) / (exact.t[-1] - exact.t[0])
    assert gait.speed == pytest.approx(U_exact, rel=0.02)
    assert gait.tail_amplitude == pytest.approx(0.012, rel=0.15)
    assert gait.wavelength == pytest.approx(L / WAVES, rel=0.1)
    assert gait.travelling_index > 0.7


@pytest.fixture(scope="module")
def analysis():
    return analyse_midlines(traced()[0], SHAPE, samples=40)


@pytest.mark.slow
def test_the_closing_coefficient_closes_the_balance(analysis):
    """In every sample, the imbalance is zero with an effect at its closing coefficient."""
    d = analysis.samples
    for name in EFFECTS:
        current = {"reactive_force": d.m_a, "normal_drag": d.C_d}.get(name, 0.0)
        imbalance = d.imbalance + (d.closing(name) - current) * d.unit(name)
        np.testing.assert_allclose(imbalance, 0.0, atol=1e-9 * np.abs(d.imbalance).max())


def test_the_verdict_follows_from_interval_and_priors(analysis):
    verdict, candidates = balance_verdict(analysis)
    low, high = central_interval(analysis.samples.imbalance)
    assert low > 0.0 and verdict == "class" and "tangential_friction" in candidates
    rms = imbalance_errors(analysis, "tangential_friction")
    assert 0.0 < rms["floor"] < rms["before"] and rms["after"] < 0.3 * rms["before"]
    samples = analysis.samples
    sampled = zip(samples.stride_forces, samples.C_d, samples.m_a, strict=True)
    complete = samples._replace(
        stride_forces=[
            x._replace(gain=x.imbalance(*c) + x.gain + 1e-6 * (i % 3 - 1))
            for i, (x, *c) in enumerate(sampled)
        ]
    )
    assert balance_verdict(replace(analysis, samples=complete)) == ("nothing_missing", [])
    backward = samples._replace(
        stride_forces=[x._replace(gain=x.gain + 0.1) for x in samples.stride_forces]
    )
    assert balance_verdict(replace(analysis, samples=backward)) == ("unexplained", [])


def test_bootstrap_of_few_strides_has_students_interval():
    weights = stride_weights(5, 20000, np.random.default_rng(1))
    sample = np.array([1.0, -0.4, 0.2, 0.9, -0.3])
    low, high = np.quantile(weights @ sample, [0.025, 0.975])
    half = 2.776 * sample.std(ddof=1) / math.sqrt(5.0)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert high - low == pytest.approx(2.0 * half, rel=0.1)


def write_animal(folder, midlines, edit=lambda rows: rows):
    folder.mkdir(exist_ok=True)
    rows = [
        f"{t:.2f},{i + 1},{j + 1},{1e3 * x:.5f},{1e3 * y:.5f}"
        for i, (t, frame) in enumerate(zip(midlines.t, midlines.points, strict=True))
        for j, (x, y) in enumerate(frame)
    ]
    rows = edit(["t,frame,point,mxmm,mymm", *rows])
    (folder / "lampreydata.csv").write_text("\n".join(rows) + "\n")
    widths = [f"{s:g},{w / 2:g}" for s, w in zip(SHAPE.positions, SHAPE.width, strict=True)]
    (folder / "fishwidth.csv").write_text("\n".join(["s,ammowidth", *widths]) + "\n")
    return folder / "lampreydata.csv"


def _blank(rows, frames):
    return [
        ",".join([*r.split(",")[:3], "", ""]) if i and (i - 1) // 20 in frames else r
        for i, r in enumerate(rows)
    ]


def _scaled(rows, factor):
    cells = [r.split(",") for r in rows[1:]]
    return [rows[0], *(",".join([*c[:3], *(str(factor * float(x)) for x in c[3:])]) for c in cells)]


def _reversed(rows):
    frames = [rows[1 + 20 * i : 21 + 20 * i] for i in range(80)]
    cells = [[r.split(",") for r in f] for f in frames]
    return [rows[0], *(",".join([*a[:3], *b[3:]]) for f in cells
                       for a, b in zip(f, f[::-1], strict=True))]  # fmt: skip


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda r: _scaled(r, 1e-3), "give the columns in mm"),
        (lambda r: r[:200] + r[201:], "must have one row for each"),
        (lambda r: _blank(r, range(15, 65)), ": 15 consecutive frames"),
        (lambda r: _blank(r, range(0, 80, 4)), ": 3 consecutive frames"),
        (_reversed, "number the points from the head"),
        (lambda r: [x.replace("mymm", "y") for x in r], "column mymm is missing"),
        (lambda r: [*r[:801], *(x.replace(x.split(",")[0], f"{float(x.split(',')[0]) + 0.5:g}", 1)
                                for x in r[801:])], "equal times"),
        (lambda r: [*r[:5], r[5].rsplit(",", 2)[0] + ",9000,0", *r[6:]], "does not stretch"),
        (lambda r: [*r[:5], r[5].rsplit(",", 1)[0] + ",abc", *r[6:]], "line 6, column mymm"),
    ],
)  # fmt: skip
def test_bad_midlines_are_rejected_with_the_reason(tmp_path, edit, says):
    path = write_animal(tmp_path, traced()[0], edit)
    with pytest.raises(InputError, match=says):
        read_midlines(path)


def test_blank_ends_are_omitted_and_widths_are_checked(tmp_path):
    path = write_animal(tmp_path, traced()[0], lambda r: _blank(r, (0, 1, 79)))
    found = read_midlines(path)
    assert found.incomplete_frames == 3 and len(found.t) == 77 and found.t[0] == pytest.approx(0.04)
    width = tmp_path / "fishwidth.csv"
    width.write_text("s,ammowidth\n0,18\n1,2\n")
    with pytest.raises(InputError, match="widths in body lengths"):
        read_width(width, "ammowidth")


def test_the_command_writes_its_report(tmp_path, capsys, monkeypatch, analysis):
    """The command reads the files; the analysis itself is that of another test."""
    given = []

    def analyse_once(midlines, shape, seed, samples):
        given.append((midlines, shape))
        return analysis

    monkeypatch.setattr(lamprey, "analyse_midlines", analyse_once)
    write_animal(tmp_path / "animal", traced()[0])
    out = tmp_path / "out"
    assert main(["lamprey", str(tmp_path / "animal"), "--out", str(out), "--draws", "20"]) == 0
    record = json.loads((out / "report.json").read_text())
    (midlines, shape) = given[0]
    np.testing.assert_allclose(midlines.points, traced()[0].points, atol=1e-8)
    np.testing.assert_allclose(shape.width, SHAPE.width, rtol=1e-5)
    assert record["verdict"] == "class" and record["said"] in capsys.readouterr().out
    row = record["errors"]["mean_axial_force_of_a_stride"]
    assert set(row) >= {"before", "after", "floor"}
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64") == 3
    assert main(["lamprey", str(tmp_path / "animal"), "--out", str(out), "--draws", "3"]) == 2
    assert "20 or more" in capsys.readouterr().err


def test_the_measured_lamprey(data):
    """The figures of explanation/real_animals_and_published_speeds.md without their samples."""
    folder = data / "lamprey"
    if not folder.is_dir():
        pytest.skip("the lamprey's midlines are absent; set SLIDER_DATA to a folder with lamprey/")
    midlines = read_midlines(folder / "lampreydata.csv")
    positions, width = read_width(folder / "fishwidth.csv", "ammowidth")
    found = analyse_midlines(midlines, CrossSections(positions, 2.0 * width), samples=40)
    assert found.strides.number == 5 and found.gait.frequency == pytest.approx(3.83, abs=0.05)
    assert found.gait.speed == pytest.approx(0.269, abs=0.005)
    assert found.imbalance.mean() == pytest.approx(1.19e-3, abs=0.1e-3)
    low, high = found.by_source["strides"]
    assert 0.0 < low < 1.19e-3 < high < 3e-3
    assert balance_verdict(found)[1][0] in ("tangential_friction", "thinned_friction", "head_drag")

"""The camera: markers in rendered images, tracking, dropped frames, scale, and errors."""

import sys
import threading

import numpy as np
import pytest

from rig.camera.ellipse_fit import SoftEllipse, ellipse_model, fit_ellipse
from rig.camera.marker_records import pack_record, read_records
from rig.camera.markers import Marker, find_markers, import_opencv
from rig.camera.scale import (
    Lens,
    Scale,
    scale_of_aruco,
    scale_of_checkerboard,
    scale_of_points,
    tip_excursion,
)
from rig.camera.source import Camera, OpenCvSource, Shot, frames_between, record_markers
from rig.camera.tracking import Tracker, order_at_rest
from rig.errors import RigError
from rig.simulated.camera import AVI_FRAMES, AVI_LENGTH, Scene, SimulatedCamera, write_video

cv2 = pytest.importorskip("cv2", reason="OpenCV (opencv-python-headless) is not installed")

MARKERS, GATE = 5, 30.0
BLUR, GLARE, NOISE = {"exposure": 0.006}, {"glare": 0.6}, {"noise": 5.0}


def swimming(t):
    """Returns marker positions; the tip, at the image's left, swings by 36 px at 3 Hz."""
    s = np.linspace(1.0, 0.0, MARKERS)
    x = np.broadcast_to(50.0 + 300.0 * (1 - s), (len(t), MARKERS))
    y = 120.3 + 36.0 * s**2 * np.sin(2 * np.pi * (3.0 * t[:, None] + 0.6 * s))
    return np.stack([x, y], axis=-1)


def scene(**disturbances):
    return Scene(swimming, **{"frames": 34, "size": (240, 400), **disturbances})


def track(scene, camera=None):
    """Returns the tracks from the records of a scene."""
    records = []
    with Camera(camera or SimulatedCamera(scene)) as frames:
        tracker = Tracker(scene.truth(0), GATE)
        record_markers(frames, tracker, lambda _, record: records.append(record))
    return read_records(records)


def errors(scene, tracks):
    """Returns the distances (frames, markers) [px] from the true positions."""
    truth = np.array([scene.truth(number) for number in tracks.number])
    return np.hypot(*np.moveaxis(tracks.xy - truth, -1, 0))


def rms(x):
    return np.sqrt(np.nanmean(x**2))


@pytest.mark.parametrize(
    ("disturbances", "bar"),
    [({}, 0.05), (BLUR, 0.1), (GLARE, 0.05), (NOISE, 0.13)],
    ids=["clean", "blur", "glare", "noise"],
)
def test_the_tip_is_found_to_a_fraction_of_a_pixel(disturbances, bar):
    seen = scene(**disturbances)
    off = errors(seen, track(seen))
    assert rms(off[:, 0]) < bar
    assert np.mean(np.isnan(off)) < 0.05


def test_on_video_with_blur_glare_and_noise_the_tip_is_within_half_a_pixel(tmp_path):
    seen = scene(**BLUR, **GLARE, **NOISE, dropped=frozenset({7, 8, 20}))
    write_video(tmp_path / "swim.avi", seen)
    tracks = track(seen, OpenCvSource(tmp_path / "swim.avi"))
    off = errors(seen, tracks)
    assert rms(off[:, 0]) < 0.5 and np.nanmax(off) < 1.5
    assert np.mean(np.isnan(off)) < 0.1
    assert set(range(tracks.number[-1])) - set(tracks.number.tolist()) == {7, 8, 20}
    np.testing.assert_allclose(np.diff(tracks.source_ns) * 1e-9, np.diff(tracks.number) / seen.fps)


def test_a_hidden_marker_is_lost_and_found_again_as_the_same():
    hidden = {(n, 0) for n in range(10, 22)} | {(n, 2) for n in range(15, 18)}
    seen = scene(hidden=frozenset(hidden))
    tracks = track(seen)
    lost = np.isnan(tracks.xy[..., 0])
    assert {(int(n), int(m)) for n, m in zip(*np.nonzero(lost), strict=True)} == hidden
    assert np.all((tracks.quality == 0) == lost)
    assert np.nanmax(errors(seen, tracks)) < 0.2


@pytest.mark.parametrize("turn", range(6))
def test_a_marker_with_a_third_covered_is_rejected(turn):
    seen = scene(**NOISE)
    image, (x, y) = seen.image(0), seen.truth(0)[1]
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    away = (u - x) * np.cos(turn) + (v - y) * np.sin(turn)
    image[(away < -0.3 * seen.radius) & (np.hypot(u - x, v - y) < 12)] = (66, 62, 58)
    places = np.array([marker[:2] for marker in find_markers(image)])
    off = np.hypot(*(seen.truth(0)[:, None] - places).transpose(2, 0, 1)).min(axis=1)
    assert off[1] > 20 and np.all(np.delete(off, 1) < 0.5)


def test_a_marker_cut_by_the_images_edge_is_rejected():
    seen = scene()
    image, (x, _) = seen.image(0), seen.truth(0)[0]
    assert len(find_markers(image)) == MARKERS
    assert len(find_markers(image[:, round(x) - 3 :])) == MARKERS - 1


def test_no_marker_is_found_in_water_alone():
    hidden = frozenset((0, marker) for marker in range(MARKERS))
    assert find_markers(scene(hidden=hidden, noise=8.0).image(0)) == []


def test_random_blue_white_and_dark_patterns_cause_no_error():
    rng = np.random.default_rng(4)
    colours = np.array([[255, 60, 0], [196, 78, 26], [255, 255, 255], [0, 0, 0], [138, 120, 72]])
    for _ in range(60):
        image = np.tile(colours[rng.integers(5)].astype(np.uint8), (90, 120, 1))
        for _ in range(rng.integers(1, 25)):
            x, y, radius, colour = rng.integers([0, 0, 1, 0], [120, 90, 25, 5])
            cv2.circle(image, (int(x), int(y)), int(radius), colours[colour].tolist(), -1)
        if rng.random() < 0.5:
            image = rng.normal(image, 20).clip(0, 255).astype(np.uint8)
        found = np.array(find_markers(image)).reshape(-1, 4)
        assert np.isfinite(found).all()
        assert np.all((found[:, :2] >= 0) & (found[:, :2] < [120, 90]))


def test_a_streak_of_glare_does_not_split_a_marker():
    seen = scene()
    image, (x, y) = seen.image(0), seen.truth(0)[1]
    image[:, round(x) - 1 : round(x) + 2] = 255
    found = [m for m in find_markers(image) if np.hypot(m.x - x, m.y - y) < 20]
    assert len(found) == 1 and np.hypot(found[0].x - x, found[0].y - y) < 0.3


def test_the_soft_ellipses_derivatives_equal_finite_differences():
    q = np.array([1.3, -0.4, 0.2, 0.05, 0.15, 6.0, 0.9, 0.1])
    x, y = np.random.default_rng(0).uniform(-9, 9, (2, 200))
    _, slopes = ellipse_model(q, x, y)
    for i, step in enumerate(1e-6 * np.eye(8)):
        differences = (ellipse_model(q + step, x, y)[0] - ellipse_model(q - step, x, y)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, i], differences, atol=1e-7)


def test_a_half_visible_ellipse_is_fitted_exactly():
    true = SoftEllipse(10.2, 9.7, 0.14, 0.02, 0.17, 7.0, 1.0, 0.05)
    y, x = np.mgrid[:21, :21].astype(float)
    seen = x + 0.3 * y > 13.0
    x, y = x[seen], y[seen]
    values = ellipse_model(np.array(true), x, y)[0]
    start = SoftEllipse(13.0, 10.0, 0.2, 0.0, 0.2, 8.0, 0.8, 0.0)
    found, error = fit_ellipse(x, y, values, start)
    np.testing.assert_allclose(found, true, rtol=1e-3, atol=1e-4)
    assert error < 1e-3


def make_marker(x, y, mass=150.0):
    return Marker(float(x), float(y), mass, 1.0)


def test_markers_keep_their_identity_in_any_order_and_over_dropped_frames():
    rng = np.random.default_rng(1)
    steps = np.cumsum(rng.integers(1, 4, 60))
    tracker = Tracker(swimming(np.zeros(1))[0], GATE)
    for passed, number in zip(np.diff(steps, prepend=0), steps, strict=True):
        truth = swimming(np.array([number / 100.0]))[0]
        shown = rng.permutation(np.flatnonzero(rng.random(MARKERS) > 0.2))
        points = tracker.follow([make_marker(*truth[i]) for i in shown], passed)
        expected = np.full_like(truth, np.nan)
        expected[shown] = truth[shown]
        np.testing.assert_array_equal(points[:, :2], expected)


def test_a_marker_beyond_the_gate_or_of_another_size_is_not_assigned():
    tracker = Tracker(np.array([[0.0, 0.0], [100.0, 0.0]]), 10.0)
    assert not np.isnan(tracker.follow([make_marker(0, 0), make_marker(100, 0)])).any()
    np.testing.assert_array_equal(
        tracker.follow([make_marker(0, 11), make_marker(101, 0, mass=60.0)])[:, 0], [np.nan, np.nan]
    )
    # After one lost frame the gate is twice as wide; its limit is the markers' distance.
    assert tracker.follow([make_marker(0, 19)])[0].tolist() == [0.0, 19.0, 1.0]
    assert np.isnan(tracker.follow([make_marker(100, 101)], passed=100)[:, 0]).all()
    assert tracker.follow([make_marker(100, 99)])[1].tolist() == [100.0, 99.0, 1.0]


def test_a_gate_that_could_confuse_two_markers_is_refused():
    with pytest.raises(RigError, match="gate: given 50 px; allowed above 0 and below 50 px"):
        Tracker(np.array([[0.0, 0.0], [100.0, 0.0]]), 50.0)


def test_markers_at_rest_are_sorted_from_the_tip_to_the_head():
    found = [make_marker(x, 0) for x in (30, 10, 20, 0)]
    assert order_at_rest(found, 4, head=(40, 5))[:, 0].tolist() == [0, 10, 20, 30]
    assert order_at_rest(found, 4, head=(-9, 5))[:, 0].tolist() == [30, 20, 10, 0]
    with pytest.raises(RigError, match="given 4; allowed 5"):
        order_at_rest(found, 5, head=(40, 5))


def test_a_lossless_video_contains_the_same_images(tmp_path):
    seen = scene(frames=7, dropped=frozenset({2, 3}), **NOISE)
    write_video(tmp_path / "swim.avi", seen)
    with Camera(OpenCvSource(tmp_path / "swim.avi")) as frames:
        numbers = []
        for frame in frames:
            np.testing.assert_array_equal(frame.image, seen.image(frame.number))
            numbers.append(frame.number)
    assert numbers == [0, 1, 4, 5, 6] and frames.dropped == 2
    assert frame.source_ns == 60_000_000
    with Camera(OpenCvSource(tmp_path / "swim.avi", fps=500.0)) as frames:
        assert [(f.number, f.source_ns) for f in frames][-1] == (6, 12_000_000)
    with pytest.raises(RigError, match="fps: given -1; allowed above 0 Hz"):
        OpenCvSource(tmp_path / "swim.avi", fps=-1)
    assert [path.name for path in tmp_path.iterdir()] == ["swim.avi"]


def test_frames_are_numbered_correctly_by_a_jittering_and_drifting_clock():
    rng = np.random.default_rng(2)
    numbers = np.cumsum(rng.choice([1, 1, 1, 1, 2, 5], 5000))
    times = (numbers * 1.003 + rng.uniform(-0.2, 0.2, len(numbers))) * 1e7
    counted = np.cumsum([frames_between(a, b, 100.0) for a, b in zip(times, times[1:])])  # noqa: B905
    np.testing.assert_array_equal(counted, numbers[1:] - numbers[0])


class LiveSource:
    """A device that delivers the given frame numbers; a number below 0 is a fault."""

    name, fps, live = "camera 7", 100.0, True

    def __init__(self, numbers):
        self._numbers, self.done = iter(numbers), threading.Event()

    def read(self):
        number = next(self._numbers, None)
        if number is None:
            self.done.set()
        elif number < 0:
            raise RigError(f"{self.name}: no more frames")
        else:
            return Shot(10_000_000 * number, 5, np.zeros((4, 4, 3), np.uint8))

    def close(self):
        pass


def test_frames_that_the_device_dropped_are_counted():
    with Camera(LiveSource([0, 1, 4, 5, 9])) as camera:
        assert [frame.number for frame in camera] == [0, 1, 4, 5, 9]
    assert camera.dropped == 5


def test_frames_that_the_full_queue_dropped_are_counted():
    source = LiveSource(range(100))
    with Camera(source, room=8) as camera:
        assert source.done.wait(20)
        assert [frame.number for frame in camera] == list(range(8))
    assert camera.dropped == 92


def test_a_device_that_fails_ends_the_loop_with_its_error():
    with Camera(LiveSource([0, 1, -1])) as camera, pytest.raises(RigError, match="no more frames"):
        for _ in camera:
            pass


def test_a_camera_can_be_closed_while_it_reads():
    camera = Camera(SimulatedCamera(scene(frames=10_000)), room=2)
    next(iter(camera))
    camera.close()
    assert not camera._thread.is_alive()
    assert list(camera) == []


def test_records_are_read_unchanged():
    points = np.array([[1.5, 2.25, 0.875], [np.nan, np.nan, 0.0]])
    records = [pack_record(n, 10 * n, points + n) for n in (0, 1, 3)]
    tracks = read_records(records)
    assert tracks.number.tolist() == [0, 1, 3] and tracks.source_ns.tolist() == [0, 10, 30]
    np.testing.assert_array_equal(tracks.xy[2], points[:, :2] + 3)
    assert read_records([]).number.size == 0


def test_an_incomplete_record_is_refused():
    record = pack_record(0, 0, np.zeros((3, 3)))
    for damaged in (record[:-1], record[:5], record + b"\0"):
        with pytest.raises(RigError, match="record 1: incomplete"):
            read_records([record, damaged])
    with pytest.raises(RigError, match="record 1: given 2 markers; allowed 3"):
        read_records([record, pack_record(1, 0, np.zeros((2, 3)))])


def checkerboard(angle=0.3, tilt=1.0, px=1500.0):
    """Returns an image of a board with 9 x 6 inner corners, 20 mm apart; `tilt` compresses it."""
    board = (np.indices((7, 10)).sum(axis=0) % 2 * 215 + 20).astype(np.uint8)
    board = np.pad(np.kron(board, np.ones((40, 40), np.uint8)), 40, constant_values=235)
    scale = px * 0.02 / 40
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn[:, 0] *= tilt
    middle = np.array(board.shape[::-1]) / 2
    shift = np.array([300.0, 240.0]) - turn @ middle
    matrix = np.column_stack([turn, shift])
    gray = cv2.warpAffine(board, matrix, (600, 480), flags=cv2.INTER_AREA, borderValue=128)
    return cv2.cvtColor(cv2.GaussianBlur(gray, (0, 0), 0.7), cv2.COLOR_GRAY2BGR)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.5, -2.5])
def test_a_checkerboard_gives_the_scale_and_its_direction(angle):
    scale = scale_of_checkerboard(checkerboard(angle), (9, 6), 0.02)
    assert abs(scale.px_per_metre / 1500.0 - 1) < 1e-3
    assert abs(np.sin(scale.angle - angle)) < 2e-3  # the direction may start at either end


def test_a_tilted_or_missing_board_is_refused():
    with pytest.raises(RigError, match="corners with an rms misfit of .* px"):
        scale_of_checkerboard(checkerboard(tilt=0.93), (9, 6), 0.02)
    with pytest.raises(RigError, match="no checkerboard with 8 x 5"):
        scale_of_checkerboard(np.full((240, 320, 3), 128, np.uint8), (8, 5), 0.02)


def test_a_partly_hidden_aruco_board_gives_the_scale():
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.GridBoard((4, 3), 0.03, 0.01, codes).generateImage((620, 460), marginSize=5)
    image = cv2.cvtColor(np.pad(board, 40, constant_values=255), cv2.COLOR_GRAY2BGR)
    image[40:200, 40:200] = 200
    scale = scale_of_aruco(image, (4, 3), 0.03, 0.01)
    assert abs(scale.px_per_metre / (610 / 0.15) - 1) < 5e-3
    assert abs(scale.angle) < 2e-3
    with pytest.raises(RigError, match="0 of 12 ArUco markers"):
        scale_of_aruco(np.full((240, 320, 3), 128, np.uint8), (4, 3), 0.03, 0.01)
    with pytest.raises(RigError, match="given DICT_9; allowed"):
        scale_of_aruco(image, (4, 3), 0.03, 0.01, dictionary="DICT_9")


def test_two_points_give_scale_origin_and_direction():
    scale = scale_of_points((100.0, 50.0), (100.0, 350.0), 0.2)
    assert scale.px_per_metre == pytest.approx(1500.0)
    # x points down the image; seen from above, the left of x is the image's right.
    np.testing.assert_allclose(scale.metres(np.array([115.0, 200.0])), [0.1, 0.01], atol=1e-12)
    for distance in (0.0, float("nan")):
        with pytest.raises(RigError, match="distance"):
            scale_of_points((0, 0), (1, 0), distance)
    with pytest.raises(RigError, match="apart"):
        scale_of_points((5, 5), (5, 5), 0.1)


@pytest.mark.parametrize("from_below", [False, True])
def test_the_tips_excursion_is_positive_to_the_robots_left(from_below):
    rest = np.stack(
        [np.linspace(50, 350, 4), np.full(4, 120.0)], axis=1
    )  # the head is at the right
    scale = Scale(1000.0, from_below=from_below).along(rest)
    xy = np.stack([rest, rest])
    xy[1, 0, 1] -= 30.0  # up in the image
    left = -0.03 if from_below else 0.03
    np.testing.assert_allclose(tip_excursion(xy, scale), [0.0, left], atol=1e-12)
    np.testing.assert_allclose(scale.metres(rest)[:, 0], [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    backwards = Scale(1000.0, from_below=from_below).along(rest[::-1])
    np.testing.assert_allclose(tip_excursion(xy[:, ::-1], backwards)[0], 0.0, atol=1e-12)
    xy[1, 3, 1] -= 30.0
    np.testing.assert_allclose(tip_excursion(xy[:, ::-1], backwards)[1], -left, atol=1e-12)


@pytest.mark.parametrize("heading", np.arange(0.0, 6.0, 0.7))
def test_x_points_from_the_tip_to_the_head_for_every_heading(heading):
    rest = 200 + np.linspace(0, 150, 4)[:, None] * [np.cos(heading), np.sin(heading)]
    along = Scale(1000.0).along(rest).metres(rest)
    np.testing.assert_allclose(along, np.linspace([0, 0], [0.15, 0], 4), atol=1e-12)


def test_the_axis_is_fitted_to_all_markers():
    rest = np.stack([np.linspace(50, 350, 5), 100 + 0.2 * np.linspace(50, 350, 5)], axis=1)
    rest[1] += [0.0, 0.6]
    rest[3] -= [0.0, 0.6]
    lateral = Scale(1000.0).along(rest).metres(rest)[:, 1]
    assert abs(lateral.mean()) < 1e-12 and np.abs(lateral).max() < 7e-4


def test_the_lens_distortion_is_removed():
    matrix = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    lens = Lens(matrix, np.array([-0.2, 0.05, 1e-3, -5e-4, 0.0]))
    true = np.random.default_rng(3).uniform(-0.2, 0.2, (20, 2))  # [m], at a distance of one metre
    space = np.column_stack([true, np.ones(20)])
    px = cv2.projectPoints(space, np.zeros(3), np.zeros(3), *lens)[0].reshape(-1, 2)
    px[4] = np.nan
    found = Scale(500.0, (320.0, 240.0), lens=lens).metres(px)
    expected = true * [1, -1]
    expected[4] = np.nan
    np.testing.assert_allclose(found, expected, atol=1e-5)
    bent = Scale(500.0, (320.0, 240.0)).metres(px)
    assert np.nanmax(np.abs(bent - expected)) > 1e-3


def read_all(path):
    with Camera(OpenCvSource(path)) as camera:
        for _ in camera:
            pass


def test_the_error_for_an_incomplete_video_says_where_it_ends(tmp_path):
    path = tmp_path / "swim.avi"
    write_video(path, scene(frames=12, **NOISE))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RigError, match=r"swim\.avi: incomplete: ends at frame \d of 12; record it"):
        read_all(path)


def test_a_video_of_a_killed_recorder_is_incomplete(tmp_path):
    path = tmp_path / "swim.avi"
    write_video(path, scene(frames=5))
    content = bytearray(path.read_bytes())
    for place in (AVI_FRAMES, AVI_LENGTH):  # written when a video is closed
        content[place : place + 4] = bytes(4)
    path.write_bytes(content)
    with pytest.raises(RigError, match="incomplete: ends at frame 5 of an unknown number"):
        read_all(path)


@pytest.mark.parametrize("content", [b"", b"no video", b"RIFF" + bytes(4000)])
def test_a_file_that_is_not_a_video_is_refused(tmp_path, content):
    path = tmp_path / "swim.avi"
    path.write_bytes(content)
    with pytest.raises(RigError, match="not a readable video"):
        read_all(path)


def test_a_missing_file_or_device_gives_one_error(tmp_path, capfd):
    with pytest.raises(RigError, match="no such file"):
        OpenCvSource(tmp_path / "none.avi")
    with pytest.raises(RigError, match="camera 99: cannot be opened; check plug"):
        OpenCvSource(99)
    assert capfd.readouterr().err == ""


def test_without_opencv_the_error_names_the_package_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(RigError, match="pip install opencv-python-headless"):
        import_opencv()

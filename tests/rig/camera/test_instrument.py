"""The camera as an instrument: the stream of its markers becomes the column of the tip."""

import time

import numpy as np
import pytest

from rig.errors import RigError
from rig.recording.reader import RecordedStream

pytest.importorskip("cv2", reason="opencv is not installed")

from rig.camera.instrument import MarkerCamera, MarkerLayout, camera_reader  # noqa: E402
from rig.camera.scale import Scale, tip_excursion  # noqa: E402
from rig.simulated.camera import Scene, SimulatedCamera  # noqa: E402

FPS, PX_PER_METRE = 100.0, 2000.0


def scene(**changes):
    """Returns a scene of five markers that rest at first; then the tip swings."""

    def places(t):
        swing = np.where(t > 0.4, np.sin(2 * np.pi * 2.0 * (t - 0.4)), 0.0)[:, None]
        y = 120.0 + swing * np.array([30.0, 18.0, 9.0, 3.0, 0.0])
        return np.stack([np.broadcast_to(np.linspace(60.0, 260.0, 5), y.shape), y], axis=2)

    return Scene(
        places, **({"fps": FPS, "frames": 120, "size": (240, 320), "radius": 6.0} | changes)
    )


def record_stream(scene, layout):
    pieces, camera = [], MarkerCamera(lambda: SimulatedCamera(scene), layout)
    camera.start(lambda at, piece: pieces.append((at, piece)))
    end = time.monotonic() + 20.0
    while len(pieces) < scene.frames - 1 and time.monotonic() < end:
        camera.check()
        time.sleep(0.01)
    time.sleep(0.1)
    camera.stop()
    host_ns, content = zip(*pieces, strict=True)
    ends = np.cumsum([len(x) for x in content])
    return RecordedStream(np.array(host_ns), ends, b"".join(content), (0, 0), (0, 0))


LAYOUT = MarkerLayout(5, (310.0, 120.0))


def test_the_tip_column_equals_the_true_excursion(tmp_path):
    given = scene()
    stream = record_stream(given, LAYOUT)
    samples = camera_reader(Scale(PX_PER_METRE))(stream)
    truth = np.array([given.truth(i) for i in range(given.frames)])
    scale = Scale(PX_PER_METRE).along(truth[0])
    expected = tip_excursion(truth, scale)[-len(samples.t) :]
    assert not samples.continuous and samples.findings == ()
    error = samples.columns["tip_m"] - expected
    assert np.sqrt(np.mean(error**2)) * PX_PER_METRE < 0.3
    assert np.abs(expected).max() * PX_PER_METRE > 25.0


def test_too_few_markers_are_an_error():
    with pytest.raises(RigError, match="at most 5 markers found, 6 expected"):
        record_stream(scene(), MarkerLayout(6, (310.0, 120.0)))


def test_a_missing_camera_is_an_error():
    from rig.camera.source import OpenCvSource

    camera = MarkerCamera(lambda: OpenCvSource("none.avi"), LAYOUT)
    with pytest.raises(RigError, match="none.avi: no such file"):
        camera.start(lambda at, piece: None)

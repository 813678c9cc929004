"""Reads an ATI sensor without a box: an NI card measures the voltages of the sensor's six gauges.

A matrix converts the voltages to forces. The sink gets blocks of samples, little endian: the number
of the first sample (u64), then six voltages per sample (f64). The module needs NI-DAQmx and the
package extra `ni`.
"""

import struct
import time
import xml.etree.ElementTree as ET
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import RigError
from rig.force.sensor import (
    AXES,
    NEWTON_METRES,
    NEWTONS,
    Forces,
    ForceSource,
    Health,
    ReaderThread,
    check_positive,
    unit_in_si,
)
from rig.recording.clock import Sink, host_sample_times

_FIRST = struct.Struct("<Q")
FULL = 0.995
"""Fraction of the voltage range above which a gauge counts as saturated."""
BIAS = 0.25
"""Duration [s] of the samples whose mean becomes `zero`, the voltages without load."""
BLOCK = 0.02
"""Duration of one block of samples [s]."""


@dataclass(frozen=True)
class GaugeCalibration:
    """Calibration of a sensor: `matrix` (6, 6) [N/V or N m/V] with rows in the order of `AXES`.

    The voltage range is from -`volts` to `volts`. `rate` is the sampling rate [1/s]. `zero` (6,)
    are the gauge voltages without load.
    """

    matrix: tuple[tuple[float, ...], ...]
    volts: float = 10.0
    rate: float = 1000.0
    zero: tuple[float, ...] = (0.0,) * 6
    serial: str = ""

    def __post_init__(self) -> None:
        if np.shape(self.matrix) != (6, 6) or not np.all(np.isfinite(self.matrix)):
            raise RigError("force sensor's calibration, matrix: allowed 6 rows of 6 finite numbers")
        check_positive("force sensor's calibration", volts=self.volts, rate=self.rate)

    @classmethod
    def read(cls, path: Path | str, rate: float = 1000.0) -> "GaugeCalibration":
        """Reads ATI's `FTxxxx.cal`. Raises `RigError` for an incomplete file."""
        where = str(path)
        advice = "give the .cal file that came with the sensor, unchanged"
        try:
            root = ET.parse(path).getroot()
        except OSError as error:
            raise RigError(f"{where}: cannot be read ({error.strerror}); {advice}") from None
        except ET.ParseError as error:
            raise RigError(f"{where}: incomplete XML ({error}); {advice}") from None
        calibration = root.find(".//Calibration")
        if calibration is None:
            raise RigError(f"{where}: the element Calibration is missing; {advice}")
        units = [
            unit_in_si(calibration.get(name, ""), known, f"{where}, {name}")
            for name, known in (("ForceUnits", NEWTONS), ("TorqueUnits", NEWTON_METRES))
        ]
        rows = {axis.get("Name"): axis.get("values", "") for axis in calibration.iter("UserAxis")}
        matrix = []
        for axis in AXES:
            try:
                row = [float(cell) for cell in rows.get(axis, "").split()]
            except ValueError:
                row = []
            if len(row) != 6:
                raise RigError(f"{where}: UserAxis {axis} needs 6 numbers as its values; {advice}")
            unit = units[axis.startswith("T")]
            matrix.append(tuple(unit * value for value in row))
        both_sides = calibration.get("OutputBipolar", "True").lower() == "true"
        try:
            volts = float(calibration.get("OutputRange", "20")) / (2.0 if both_sides else 1.0)
        except ValueError:
            raise RigError(f"{where}: OutputRange is not a number; {advice}") from None
        return cls(tuple(matrix), volts, rate, serial=root.get("Serial", ""))

    def wrench(self, volts: np.ndarray) -> np.ndarray:
        """Returns forces [N] and torques [N m] (..., 6) from gauge voltages (..., 6)."""
        return (volts - np.asarray(self.zero)) @ np.asarray(self.matrix).T

    def saturated(self, volts: np.ndarray) -> np.ndarray:
        """Returns True (...) where a gauge is saturated. All six axes are then wrong."""
        return np.any(np.abs(volts) >= FULL * self.volts, axis=-1)

    def forces(self, host_ns: Sequence[int], blocks: Sequence[bytes]) -> Forces:
        """Returns the forces of one recording. Raises `RigError` for no samples or a wrong rate."""
        if not blocks:
            raise RigError(
                "force sensor: no samples arrived during the recording; check the NI card"
            )
        first = np.array([_FIRST.unpack_from(block)[0] for block in blocks], np.int64)
        pieces = [np.frombuffer(b, "<f8", offset=_FIRST.size).reshape(-1, 6) for b in blocks]
        last = first + np.array([len(piece) for piece in pieces]) - 1
        number = np.arange(first[0], last[-1] + 1)
        volts = np.full((len(number), 6), np.nan)
        for start, piece in zip(first - first[0], pieces, strict=True):
            volts[start : start + len(piece)] = piece
        saturated = self.saturated(volts)
        findings = []
        if missing := int(np.isnan(volts[:, 0]).sum()):
            findings.append(f"{missing} of {len(number)} samples missing")
        if saturated.any():
            findings.append(f"{saturated.sum()} samples saturated")
        arrived = np.asarray(host_ns, np.int64)
        times = host_sample_times(last, arrived, self.rate, number)
        return Forces(times, self.wrench(volts), saturated, tuple(findings))


class GaugeForce(ForceSource):
    """Six differential inputs of an NI card, such as "Dev1/ai0:5", read at the calibration's rate.

    Raises `RigError` if nidaqmx or its driver is not installed, or the card reports an error.
    """

    def __init__(self, channels: str, calibration: GaugeCalibration, patience: float = 1.0) -> None:
        try:
            import nidaqmx
            from nidaqmx import constants, stream_readers
        except ImportError:
            raise RigError(
                f"force sensor {channels}: nidaqmx is missing; "
                "install the extra ni (pip install 'slider-jax[ni]') and NI-DAQmx"
            ) from None
        self.name, self.patience = f"force sensor {channels}", patience
        self._error: type[Exception] = nidaqmx.errors.Error
        self._reader: ReaderThread | None = None
        self._recent: deque[np.ndarray] = deque(maxlen=round(BIAS / BLOCK))
        self._count = self._saturated = 0
        self._task: Any = None
        try:
            self._task = nidaqmx.Task()
            self._task.ai_channels.add_ai_voltage_chan(
                channels,
                terminal_config=constants.TerminalConfiguration.DIFF,
                min_val=-calibration.volts,
                max_val=calibration.volts,
            )
            self._task.timing.cfg_samp_clk_timing(
                calibration.rate,
                sample_mode=constants.AcquisitionType.CONTINUOUS,
                samps_per_chan=round(10 * calibration.rate),
            )
            # The card divides its clock by a whole number, so the actual rate may differ.
            self.calibration: GaugeCalibration = replace(
                calibration, rate=float(self._task.timing.samp_clk_rate)
            )
            inputs = len(self._task.ai_channels)
        except self._error as error:
            self.close()
            raise self._refused(error) from None
        if inputs != 6:
            self.close()
            raise RigError.value(self.name, f"{inputs} inputs", "6, such as Dev1/ai0:5")
        self._stream = stream_readers.AnalogMultiChannelReader(self._task.in_stream)
        self._block = np.empty((6, max(1, round(BLOCK * self.calibration.rate))))

    def _refused(self, error: Exception) -> RigError:
        return RigError(
            f"{self.name}: {str(error).splitlines()[0]}; "
            "check the card, the card's name and the inputs in NI MAX"
        )

    def _receive(self) -> bytes:
        try:
            self._stream.read_many_sample(self._block, self._block.shape[1], self.patience)
        except self._error as error:
            raise self._refused(error) from None
        return _FIRST.pack(self._count) + self._block.T.astype("<f8").tobytes()

    def _take(self, now: int, block: bytes) -> None:
        self._sink(now, block)
        volts = self._block.T.copy()
        self._count += len(volts)
        self._saturated += int(self.calibration.saturated(volts).sum())
        self._recent.append(volts)
        self._last = now, volts[-1]

    def start(self, sink: Sink) -> None:
        self.stop()
        self._sink: Sink = sink
        self._count = self._saturated = 0
        self._last = None
        try:
            self._task.start()
        except self._error as error:
            raise self._refused(error) from None
        self._reader = ReaderThread(self.name, self._receive, self._take, self.patience)
        end = time.monotonic() + self.patience
        while self._last is None and time.monotonic() < end:
            time.sleep(0.002)
        self.check()

    def bias(self) -> None:
        """Sets the calibration's `zero` to the mean of the next `BIAS` seconds."""
        if self._reader is None:
            raise RigError(f"{self.name}: the stream has not started; call start before bias")
        self._recent.clear()
        while len(self._recent) < (self._recent.maxlen or 0):
            self.check()
            time.sleep(0.002)
        zero = np.concatenate(list(self._recent)).mean(axis=0)
        self.calibration = replace(self.calibration, zero=tuple(zero.tolist()))

    def health(self) -> Health:
        return Health(self._count, 0, self._saturated)

    def check(self) -> None:
        if self._reader is not None:
            self._reader.check()

    def stop(self) -> None:
        if self._reader is None:
            return
        self._reader.abandon()
        self._reader = None
        self._task.stop()

    def close(self) -> None:
        self.stop()
        if self._task is not None:
            self._task.close()
            self._task = None

"""How the streams of instruments are read back into samples on the host's clock."""

import numpy as np

from rig.force.sensor import Calibration, SensorMounting
from rig.recording.reader import RecordedStream
from rig.recording.table import SampledColumns, StreamReader


def force_reader(calibration: Calibration, mounting: SensorMounting) -> StreamReader:
    """thrust_N and recoil_N of a force sensor's stream."""

    def read(stream: RecordedStream) -> SampledColumns:
        forces = calibration.forces(stream.host_ns.tolist(), stream.pieces())
        sound = np.where(forces.doubtful[:, None], np.nan, forces.wrench)
        thrust, recoil = mounting.thrust_and_recoil(sound)
        columns = {"thrust_N": thrust, "recoil_N": recoil}
        return SampledColumns(forces.t_ns * 1e-9, columns, forces.findings)

    return read

"""Opens HDF5 files for a single writer and many readers (SWMR), as h5py alone cannot."""

import ctypes
from contextlib import suppress
from pathlib import Path

import h5py
from h5py import h5f, h5p
from h5py._objects import phil

_ATTEMPTS = 27
"""HDF5 reads what looks damaged again, as a writer may be at it, and waits twice as long each time:
0.1 s in all. Its own hundred times would never end on a torn file."""


def open_to_write(path: Path) -> h5py.File:
    """For SWMR at once: h5py's way is a plain opening first, which a kill turns into a bar."""
    return _open(path, h5f.ACC_RDWR | h5f.ACC_SWMR_WRITE)


def open_to_read(path: Path) -> h5py.File:
    """Also while it is written, and after its writer was killed."""
    return _open(path, h5f.ACC_RDONLY | h5f.ACC_SWMR_READ)


def _open(path: Path, flags: int) -> h5py.File:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_LATEST, h5f.LIBVER_LATEST)
    access.set_file_locking(False, True)  # locks would shut out whoever comes while another opens
    with phil, suppress(AttributeError):  # not in h5py; on Windows there is no way to it
        hdf5 = ctypes.PyDLL(h5p.__file__)
        hdf5.H5Pset_metadata_read_attempts(ctypes.c_int64(access.id), ctypes.c_uint(_ATTEMPTS))
    return h5py.File(h5f.open(str(path).encode(), flags, access))

"""Keeps the rig's tests in time, although their process may have run other tests before."""

import gc

import pytest


@pytest.fixture(autouse=True, scope="module")
def short_collections():
    """Excludes older objects from garbage collection.

    A full collection in a process that has compiled hundreds of programs takes longer than the
    host's deadlines. A process of the rig itself has few objects.
    """
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()

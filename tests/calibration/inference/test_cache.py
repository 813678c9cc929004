"""The cache of simulated arrays is keyed by everything that they depend on."""

import numpy as np
import pytest

from calibration.inference.cache import resumable
from slider_jax.effects.library import load_effects
from tests.support.own_effects import restored_library, write_effect


class Interrupted(Exception):
    pass


def interrupted_run(out, path):
    """Runs a process that loads the effects of `path`, caches an array, and is interrupted."""
    made = []
    with restored_library(), pytest.raises(Interrupted):
        load_effects(path)
        with resumable(out, {"inputs": "the same"}) as memo:
            memo.cached("array", [], lambda: made.append(1) or [np.zeros(1)])
            raise Interrupted
    return bool(made)


def test_a_run_does_not_resume_from_the_cache_of_a_changed_effect_file(tmp_path, capsys):
    out, path = tmp_path / "out", write_effect(tmp_path / "wall.py")
    assert interrupted_run(out, path)
    assert capsys.readouterr().err == ""
    assert not interrupted_run(out, path)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("resuming the interrupted run from")

    write_effect(path, ("-self.c *", "-2.0 * self.c *"))
    assert interrupted_run(out, path)
    (line,) = capsys.readouterr().err.splitlines()
    assert "cache of this run with other effect files or with other content of these files" in line
    assert "starts from the beginning" in line
    write_effect(path)
    assert not interrupted_run(out, path)

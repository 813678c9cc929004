"""The cache of simulated arrays is keyed by everything that they depend on."""

from calibration.inference.cache import source_digest
from slider_jax.effects.library import LOADED_FILES


def test_the_digest_depends_on_loaded_files_of_effects(tmp_path, monkeypatch):
    file = tmp_path / "effect.py"
    digests = [source_digest()]
    for text in ("a = 1\n", "a = 2\n"):
        file.write_text(text)
        monkeypatch.setattr("calibration.inference.cache.LOADED_FILES", [*LOADED_FILES, file])
        digests.append(source_digest())
    assert len(set(digests)) == 3

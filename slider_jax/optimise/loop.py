"""Runs an optimiser generation by generation, with a checkpoint after each generation."""

import io
import json
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from slider_jax.errors import InputError
from slider_jax.io.files import read_with_digest, write_with_digest
from slider_jax.optimise.optimiser import Optimiser

CHECKPOINT = "checkpoint.npz"
PLAN = "search.json"
"""File with the settings of a multimodal optimisation, which runs several optimisations."""


class Generation(NamedTuple):
    """Summary of a generation. Scores are in the unit of the objective."""

    number: int
    best: float
    """Best score of all generations so far."""
    best_here: float
    """Best score of this generation."""
    mean: float
    """Mean score of the individuals that did not fail."""
    failed: int
    """Number of individuals without a finite score."""
    evaluations: int
    """Number of evaluations so far. An evaluation with gradient counts as `Optimiser.cost`."""


class OptimisationResult(NamedTuple):
    """Result of an optimisation."""

    best: np.ndarray
    """Best individual: values (d,) of the d variables in the unit box."""
    score: float
    """Score of the best individual."""
    history: list[Generation]
    population: np.ndarray
    """Last population (n, d) of n individuals."""
    scores: np.ndarray
    """Scores (n,) of the last population."""


def settings_of(optimiser: Optimiser, population: int, seed: int, task: dict[str, Any]) -> dict:
    """Returns everything that an optimisation depends on except the number of generations."""
    content = {"algorithm": optimiser.name, "population": population, "seed": seed, **task}
    return json.loads(json.dumps(content))


def run_optimiser(
    optimiser: Optimiser,
    evaluate: Callable[[np.ndarray, bool], tuple[np.ndarray, np.ndarray | None]],
    generations: int,
    seed: int,
    settings: dict[str, Any],
    folder: Path | None = None,
    resume: bool = False,
    keep: bool = True,
    on_generation: Callable[[Generation, float], None] = lambda generation, seconds: None,
) -> OptimisationResult:
    """Runs an optimiser for `generations` in total and returns the best individual.

    `evaluate(population (n, d), gradients)` returns scores (n,), and gradients (n, d) if
    requested. `on_generation` is called after each generation with the summary and the duration in
    seconds. With `resume`, the optimisation continues from the checkpoint in `folder`, if any. If
    several processes compute, only the process with `keep` writes checkpoints. Raises `InputError`
    if the checkpoint is damaged, has other `settings`, or exists although `resume` is false.
    """
    state, none = _plain(optimiser.begin(seed)), np.full(0, np.nan)
    path = None if folder is None else folder / CHECKPOINT
    best, score, history, population, scores = OptimisationResult(none, -np.inf, [], none, none)
    if path is not None and path.exists():
        refuse_without(resume, path)
        state, (best, score, history, population, scores) = _load(path, state, settings)
    for number in range(len(history), generations):
        started = time.monotonic()
        population, state = optimiser.ask(_plain(state), seed, number)
        with_gradients = optimiser.wants_gradients(number)
        scores, slopes = evaluate(population, with_gradients)
        state = optimiser.tell(_plain(state), seed, number, population, scores, slopes)
        spent = history[-1].evaluations if history else 0
        spent += len(population) * (optimiser.cost if with_gradients else 1)
        good = np.isfinite(scores)
        if good.any() and scores[good].max() > score:
            place = int(np.argmax(np.where(good, scores, -np.inf)))
            best, score = population[place], float(scores[place])
        here = scores[good] if good.any() else np.array([np.nan])
        failed = int((~good).sum())
        done = Generation(number, score, float(here.max()), float(here.mean()), failed, spent)
        history.append(done)
        if path is not None and keep:
            result = OptimisationResult(best, score, history, population, scores)
            _save(path, state, result, settings)
        on_generation(done, time.monotonic() - started)
    return OptimisationResult(best, score, history, population, scores)


def _plain(state: Any) -> Any:
    """Returns the state as NumPy arrays, as a checkpoint contains it.

    JAX compiles another program for weakly typed arrays, and its last digit may differ.
    """
    return jax.tree.map(np.asarray, state)


def refuse_without(resume: bool, path: Path) -> None:
    """Raises `InputError` if `resume` is false. An earlier optimisation wrote the file `path`."""
    if not resume:
        raise InputError(
            f"{path}: this folder holds an optimisation; add --resume to continue the search, or "
            "give another folder"
        )


def refuse_other_settings(given: Any, saved: Any, path: Path) -> None:
    """Raises `InputError` if the `saved` settings of the file `path` differ from `given`."""
    differ = differences(given, saved)
    if differ:
        more = f"; and {len(differ) - 3} more" if len(differ) > 3 else ""
        raise InputError(
            f"{path}: the optimisation in this folder has other settings: {'; '.join(differ[:3])}"
            f"{more}; give the same settings, or another folder"
        )


def _save(path: Path, state: Any, result: OptimisationResult, settings: dict[str, Any]) -> None:
    leaves = {f"state_{i:03d}": np.asarray(x) for i, x in enumerate(jax.tree.leaves(state))}
    buffer = io.BytesIO()
    record = json.dumps({"settings": settings, "score": result.score})
    kept = {"said": np.array(record), "history": np.array(result.history, float),
            "best": result.best, "members": result.population,
            "scores": result.scores}  # fmt: skip
    np.savez(buffer, allow_pickle=False, **kept, **leaves)
    write_with_digest(path, buffer.getvalue())


def _load(path: Path, state: Any, settings: dict[str, Any]) -> tuple[Any, OptimisationResult]:
    """Returns (state, result) of a checkpoint. `state` is any state of the same optimiser."""
    damaged = InputError(
        f"{path}: the file is damaged or is not a checkpoint of this program; delete the file to "
        "start again, or restore the file from a copy"
    )
    try:
        kept = np.load(io.BytesIO(read_with_digest(path)))
        record = json.loads(str(kept["said"]))
        leaves = [kept[name] for name in sorted(kept.files) if name.startswith("state_")]
        rows = kept["history"].tolist()
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        raise damaged from None
    refuse_other_settings(settings, record["settings"], path)
    if len(jax.tree.leaves(state)) != len(leaves):
        raise damaged
    history = [Generation(int(n), a, b, c, int(e), int(f)) for n, a, b, c, e, f in rows]
    best, score = kept["best"], float(record["score"])
    result = OptimisationResult(best, score, history, kept["members"], kept["scores"])
    return jax.tree.unflatten(jax.tree.structure(state), leaves), result


def differences(given: Any, saved: Any, place: str = "") -> list[str]:
    """Returns a text for each number or string that differs between two JSON structures."""
    if isinstance(given, dict) and isinstance(saved, dict):
        keys = list(dict.fromkeys([*given, *saved]))
        pairs = [(f"{place}.{k}".lstrip("."), given.get(k), saved.get(k)) for k in keys]
    elif isinstance(given, list) and isinstance(saved, list) and len(given) == len(saved):
        rows = enumerate(zip(given, saved, strict=True))
        pairs = [(f"{place}.{i}", a, b) for i, (a, b) in rows]
    else:
        text = f"{place}: given {json.dumps(given)}, saved {json.dumps(saved)}"
        return [] if given == saved else [text]
    return [x for name, a, b in pairs for x in differences(a, b, name)]

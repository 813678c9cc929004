"""A search by generations, kept after each of them, so that one that was killed goes on."""

import hashlib
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
from slider_jax.io.files import write_bytes
from slider_jax.optimise.optimiser import Optimiser

CHECKPOINT = "checkpoint.npz"
PLAN = "search.json"
"""Of a search that is made of several, in folders of their own."""


class Generation(NamedTuple):
    """What a generation came to. Scores are in the objective's unit."""

    number: int
    best: float
    """Of all generations so far."""
    best_here: float
    mean: float
    """Of the members that did not fail."""
    failed: int
    evaluations: int
    """So far; one with its gradient counts for several."""


class OptimisationResult(NamedTuple):
    """The end of a search."""

    best: np.ndarray
    """(d,) in the unit box."""
    score: float
    history: list[Generation]
    population: np.ndarray
    """(n, d), the last one."""
    scores: np.ndarray
    """(n,)"""


def settings_of(searcher: Optimiser, members: int, seed: int, task: dict[str, Any]) -> dict:
    """All that a search depends on, but for how long it is to be."""
    content = {"algorithm": searcher.name, "population": members, "seed": seed, **task}
    return json.loads(json.dumps(content))


def run_optimiser(
    searcher: Optimiser,
    evaluate: Callable[[np.ndarray, bool], tuple[np.ndarray, np.ndarray | None]],
    generations: int,
    seed: int,
    settings: dict[str, Any],
    folder: Path | None = None,
    resume: bool = False,
    keep: bool = True,
    said: Callable[[Generation, float], None] = lambda generation, seconds: None,
) -> OptimisationResult:
    """Search for `generations`, or as many more as are missing from what `folder` keeps.

    `evaluate(members (n, d), gradients)` gives scores (n,), and gradients (n, d) if asked for.
    After each generation `said` gets it and the seconds it took. With `resume` the search goes on
    that `folder` holds, if any; one process of many is to `keep` it. Raises `InputError` if what is
    there is of other `settings`, is torn, or is there without `resume`.
    """
    state = searcher.begin(seed)
    path = None if folder is None else folder / CHECKPOINT
    history: list[Generation] = []
    best, score, scores = np.full(0, np.nan), -np.inf, np.full(0, np.nan)
    members = np.full((0, 0), np.nan)
    if path is not None and path.exists():
        if not resume:
            raise InputError(
                f"{path}: a search was begun here; add --resume to go on with it, or give another "
                "folder"
            )
        state, history, best, score, members, scores = _load(path, state, settings)
    for number in range(len(history), generations):
        begun = time.monotonic()
        members, state = searcher.ask(state, seed, number)
        wanted = searcher.wants_gradients(number)
        scores, slopes = evaluate(members, wanted)
        state = searcher.tell(state, seed, number, members, scores, slopes)
        spent = history[-1].evaluations if history else 0
        spent += len(members) * (searcher.cost if wanted else 1)
        good = np.isfinite(scores)
        if good.any() and scores[good].max() > score:
            place = int(np.argmax(np.where(good, scores, -np.inf)))
            best, score = members[place], float(scores[place])
        here = scores[good] if good.any() else np.array([np.nan])
        done = Generation(
            number, score, float(here.max()), float(here.mean()), int((~good).sum()),
            spent,
        )  # fmt: skip
        history.append(done)
        if path is not None and keep:
            _save(path, state, history, best, score, members, scores, settings)
        said(done, time.monotonic() - begun)
    return OptimisationResult(best, score, history, members, scores)


def _save(path, state, history, best, score, members, scores, settings) -> None:
    leaves = {f"state_{i:03d}": np.asarray(x) for i, x in enumerate(jax.tree.leaves(state))}
    buffer = io.BytesIO()
    said = json.dumps({"settings": settings, "score": score})
    kept = {"said": np.array(said), "history": np.array(history, float), "best": best,
            "members": members, "scores": scores}  # fmt: skip
    np.savez(buffer, allow_pickle=False, **kept, **leaves)
    content = buffer.getvalue()
    write_bytes(path, hashlib.sha256(content).digest() + content)


def _load(path, state, settings):
    """State, history, best, score, members, scores of a checkpoint."""
    torn = InputError(
        f"{path}: is torn or not a checkpoint of this program; delete it to begin anew, or put a "
        "copy in its place"
    )
    try:
        content = path.read_bytes()
    except OSError:
        raise torn from None
    if hashlib.sha256(content[32:]).digest() != content[:32]:
        raise torn
    try:
        kept = np.load(io.BytesIO(content[32:]))
        said = json.loads(str(kept["said"]))
        leaves = [kept[name] for name in sorted(kept.files) if name.startswith("state_")]
        rows = kept["history"]
    except (ValueError, KeyError, zipfile.BadZipFile, json.JSONDecodeError):
        raise torn from None
    old = said["settings"]
    differ = differences(settings, old)
    if differ:
        told = "; ".join(differ[:3]) + (f"; and {len(differ) - 3} more" if len(differ) > 3 else "")
        raise InputError(f"{path}: holds a search with other settings: {told}; give these, or "
                         "another folder")  # fmt: skip
    form = jax.tree.structure(state)
    if form.num_leaves != len(leaves):
        raise torn
    history = [
        Generation(int(a), float(b), float(c), float(d), int(e), int(f))
        for a, b, c, d, e, f in rows
    ]
    score = float(said["score"])
    return (
        jax.tree.unflatten(form, leaves),
        history,
        kept["best"],
        score,
        kept["members"],
        kept["scores"],
    )


def differences(given: Any, begun: Any, place: str = "") -> list[str]:
    """Every number or word that differs between two trees of JSON's types, by its place."""
    if isinstance(given, dict) and isinstance(begun, dict):
        keys = list(dict.fromkeys([*given, *begun]))
        pairs = [(f"{place}.{k}".lstrip("."), given.get(k), begun.get(k)) for k in keys]
    elif isinstance(given, list) and isinstance(begun, list) and len(given) == len(begun):
        rows = enumerate(zip(given, begun, strict=True))
        pairs = [(f"{place}.{i}", a, b) for i, (a, b) in rows]
    else:
        same = given == begun
        return (
            [] if same else [f"{place}: given {json.dumps(given)}, begun with {json.dumps(begun)}"]
        )
    return [x for name, a, b in pairs for x in differences(a, b, name)]

# SPDX-License-Identifier: MIT
"""The folder of a training: whose it is, and taking it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.storage.atomic import require_writable, sweep_stale, write_text
from salsanext_cli.storage.output_run import alone
from salsanext_cli.storage.stage_records import (
    as_json,
    record,
    require_same_settings,
    stage_settings,
)
from salsanext_cli.training.events import EVENTS
from salsanext_cli.training.fit import BEST, CHECKPOINT, CURVE, LAST, LOG, SAMPLES
from salsanext_cli.training.recipe import REMOVED, Recipe

STAGE = "train"
RECIPE = "recipe.toml"
MADE = (CHECKPOINT, BEST, LAST, LOG, CURVE)
"""What a training leaves, and what is gone when another begins in its place."""


@contextmanager
def trained_alone(run: Path) -> Iterator[None]:
    """Keep other trainings out of a folder while the body runs.

    What a training that was killed long ago left half written is removed.

    Raises
    ------
    OutputError
        If another training is at work in it.
    """
    with alone(run, STAGE):
        for folder in (run, run / SAMPLES):
            sweep_stale(folder)
        yield


def require_free(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Refuse, before anything is done, a folder that a training may not have.

    Raises
    ------
    OutputError
        If it cannot be written; or, unless `overwrite`, if it holds a training with other settings
        that has come to a first checkpoint, or files of such names that no training recorded.
    """
    require_writable(run)
    there = [name for name in MADE if (run / name).exists()]
    if overwrite or not there:
        return
    recorded = stage_settings(run, STAGE)
    if recorded is None:
        raise OutputError(
            run / there[0],
            "was there before, made nobody knows how",
            remedy="use another folder, or --overwrite to replace it",
        )
    require_same_settings(run / f"{STAGE}.json", _decisive(recorded), _decisive(as_json(settings)))


def take(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Record a training in a folder that is free; one with other settings is removed.

    Parameters
    ----------
    run : Path
        The folder.
    settings : mapping
        All that decides what the training ends with, its recipe under that name.
    overwrite : bool
        Whether to begin anew with the same settings too.
    """
    recorded = stage_settings(run, STAGE)
    anew = recorded is None or _decisive(recorded) != _decisive(as_json(settings))
    if overwrite or anew:
        pictures, events = run.glob(f"{SAMPLES}/epoch-*.png"), run.glob(f"{EVENTS}/events.*")
        for made in (*(run / name for name in MADE), *pictures, *events):
            made.unlink(missing_ok=True)
    record(run, STAGE, as_json(settings), [])
    write_text(run / RECIPE, Recipe.from_dict(settings["recipe"]).to_toml())


def _decisive(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that a training may not change on the way.

    What recipes of older versions do not say is the default, and what they say in vain is left
    out. The parts of a batch may change, since a training that has run out of memory must be able
    to go on.
    """
    recipe = settings.get("recipe")
    if not isinstance(recipe, dict):
        return dict(settings)
    recipe = {key: v for key, v in recipe.items() if key not in REMOVED or v != REMOVED[key]}
    return {**settings, "recipe": {**Recipe().to_dict(), **recipe, "accumulate": None}}

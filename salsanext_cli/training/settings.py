# SPDX-License-Identifier: MIT
"""Settings of a training: all that decides its result, recorded in its folder."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.files.identity import fingerprint
from salsanext_cli.labelling.label_records import digest_of_file
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe


def scans_digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names."""
    names = "\n".join(f"{scan.sequence}/{scan.stem}" for scan in scans)
    return f"{len(scans)}, {hashlib.sha256(names.encode()).hexdigest()[:16]}"


def training_settings(
    recipe: Recipe, sources: Sequence[Source], weights: Path | None
) -> dict[str, Any]:
    """Return all that decides the result of a training, as plain data.

    The sources are the scans to train on, those of the validation, and further data sets.
    """
    first, validation, *further = sources
    settings: dict[str, Any] = {
        "recipe": recipe.to_dict(),
        "sensor": replace(first.sensor, intensity_quantiles=(), row_gaps=None).to_dict(),
        "label_space": first.space.to_dict(),
        "scans": scans_digest([*first.files, *validation.files]),
        "weights": fingerprint(weights) if weights else None,
    }
    if first.files and recipe.folds:
        # Labels of a few scans are corrected, and trained on again.
        labels = "".join(digest_of_file(file.label_path) for file in first.files)
        settings["labels"] = hashlib.sha256(labels.encode()).hexdigest()[:16]
    if further:
        settings["also"] = [
            {"label_space": each.space.to_dict(), "scans": scans_digest(each.files)}
            for each in further
        ]
    return settings

# SPDX-License-Identifier: MIT
"""Dated record of a threshold of `tune risk`, to be archived."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from salsanext_cli.core.engines.machine import machine, versions
from salsanext_cli.core.network.card import split_digests
from salsanext_cli.io.files.json_files import write_json
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.version import __version__

PACKAGES = ("torch", "openvino", "numpy", "numba")
"""Packages whose version may change a label."""


def write_risk_record(
    path: Path, tuned: Mapping[str, Any], *, source: Path, weights: Path, target: Path
) -> None:
    """Write what a threshold is based on: scans, weights, settings, guarantee and check.

    Parameters
    ----------
    path : Path
        JSON file to write.
    tuned : mapping
        Report of `tune` for the part ``risk``.
    source : Path
        Data set that the threshold was chosen on.
    weights, target : Path
        Weights that labelled the scans, and weights file with the threshold.
    """
    scans = [
        {"scan": name, "digest": digest, "accepted": accepted, "accepted_and_wrong": wrong}
        for name, digest, (accepted, wrong) in zip(
            tuned["names"], split_digests(tuned["digests"]), tuned["of_scans"], strict=True
        )
    ]
    record = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": __version__,
        "guarantee": tuned["guarantee"],
        **{key: tuned[key] for key in ("kind", "threshold", "at_most", "confidence", "unit")},
        "weights": {"path": str(weights), "sha256": fingerprint(weights)},
        "weights_with_threshold": {"path": str(target), "sha256": fingerprint(target)},
        "computed_by": tuned["computed_by"],
        "versions": {"salsanext": __version__} | versions(PACKAGES),
        "machine": machine(tuned["computed_by"]["device"]),
        "settings": tuned["settings"],
        "views": tuned["views"],
        "data_set": str(source.resolve()),
        "scans": scans,
        "accepted": tuned["accepted"],
        "warnings": tuned["warnings"],
        "check": {"held_out_sequences": tuned["held_out"]},
    }
    write_json(path, record)

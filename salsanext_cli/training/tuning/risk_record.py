# SPDX-License-Identifier: MIT
"""Dated record of a threshold of `tune risk`, to be archived."""

from datetime import UTC, datetime
from pathlib import Path

from salsanext_cli.core.engines.machine import computing_packages, machine, versions
from salsanext_cli.io.files.atomic import write_target
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.training.tuning.risk_report import RiskFit
from salsanext_cli.version import __version__


def write_risk_record(
    path: Path, fit: RiskFit, *, source: Path, weights: Path, target: Path, overwrite: bool
) -> None:
    """Write what a threshold is based on: scans, weights, settings, guarantee and check.

    Parameters
    ----------
    path : Path
        JSON file to write.
    fit : RiskFit
        Report of the fit.
    source : Path
        Data set that the threshold was chosen on.
    weights : Path
        Weights that labelled the scans.
    target : Path
        Weights file with the threshold.
    overwrite : bool
        Whether to replace an existing file.

    Raises
    ------
    OutputError
        If the file cannot be written, or may not replace another.
    """
    scans = [
        {
            "scan": scan.scan,
            "digest": scan.digest,
            "accepted": scan.share_accepted,
            "accepted_and_wrong": scan.share_wrong,
        }
        for scan in fit.scans
    ]
    threshold = fit.threshold
    record = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": __version__,
        "guarantee": fit.guarantee,
        "kind": threshold.kind,
        "threshold": threshold.threshold,
        "at_most": threshold.at_most,
        "confidence": threshold.confidence,
        "unit": threshold.unit,
        "weights": {"path": str(weights), "sha256": fingerprint(weights)},
        "weights_with_threshold": {"path": str(target), "sha256": fingerprint(target)},
        "computed_by": fit.computed_by,
        "versions": {"salsanext": __version__} | versions(computing_packages()),
        "machine": machine(fit.computed_by.device),
        "settings": threshold.settings,
        "views": threshold.views,
        "data_set": str(source.resolve()),
        "scans": scans,
        "accepted": fit.accepted,
        "warnings": fit.warnings,
        "check": {"held_out_sequences": fit.held_out},
    }
    write_target(path, encode_json(record), overwrite=overwrite)

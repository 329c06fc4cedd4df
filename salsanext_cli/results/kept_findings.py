# SPDX-License-Identifier: MIT
"""Findings of a stage by scan, ``OUT/<stage>.warnings.json``, kept for its later runs."""

from collections.abc import Collection, Mapping
from pathlib import Path

from salsanext_cli.files.json_files import read_json, write_json
from salsanext_cli.files.reading import present
from salsanext_cli.results.run_registration import records_lock

Texts = tuple[str, str, str]
"""Code, message and remedy."""


def keep_findings(
    out: Path, stage: str, found: Mapping[str, list[Texts]], looked_at: Collection[str]
) -> dict[str, list[Texts]]:
    """Keep what a run found in an output folder; return what earlier runs found of other scans.

    `out`: the output folder; `stage`: the stage; `found`: code, message and remedy of each finding,
    by the name of the scan; `looked_at`: names of all scans that the run has looked at; what
    earlier runs found of them is outdated.
    """
    path = _path(out, stage)
    with records_lock(out):
        known = read_findings(out, stage)
        earlier = {name: texts for name, texts in known.items() if name not in looked_at}
        if present(path) or found:
            everything = {**earlier, **{name: sorted(texts) for name, texts in found.items()}}
            write_json(path, {"stage": stage, "scans": dict(sorted(everything.items()))})
    return earlier


def read_findings(out: Path, stage: str) -> dict[str, list[Texts]]:
    """Return what the runs of a stage found, by the name of the scan; empty if none is kept."""
    known = read_json(_path(out, stage))
    scans = {} if known is None else known.get("scans")
    return {
        name: [tuple(texts) for texts in findings]
        for name, findings in (scans.items() if isinstance(scans, dict) else ())
        if _are_findings(findings)
    }


def _path(out: Path, stage: str) -> Path:
    return out / f"{stage}.warnings.json"


def _are_findings(value: object) -> bool:
    return isinstance(value, list) and all(
        isinstance(texts, list) and [*map(type, texts)] == [str, str, str] for texts in value
    )

# SPDX-License-Identifier: MIT
"""Simulated scenes of a training, which vary its scans."""

import logging
from dataclasses import replace
from pathlib import Path

from salsanext_cli.commands.stages.synth import SynthSettings, synthesise
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import counted
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.synthesis.lidar import RIGS
from salsanext_cli.training.data.sources import Source, further_source, merged_into

SCANS_OF_STREET = 8  # Scans of a simulated scene
STREET_SPACING_M = 10.0  # Distance between two of them
SEED_OF_STREETS = 0

log = logging.getLogger(__name__)


def simulated_scenes(folder: Path, count: int, real: Source, jobs: int) -> list[Source]:
    """Return simulated data sets, one for each kind of sensor, made if need be.

    Parameters
    ----------
    folder : Path
        Folder for the data sets.
    count : int
        Number of scenes for each kind of sensor.
    real : Source
        Scans of the training, whose classes and sensor the simulated ones get.
    jobs : int
        Number of worker processes.

    Returns
    -------
    list of Source
        Empty if the simulated classes cannot be merged into those of `real`.
    """
    if not count:
        return []
    if not scan_counts_of_scenes(count, real.space):
        log.log(NOTICE, "no simulated scenes: their classes cannot be merged into your classes")
        return []
    sources = []
    for kind in RIGS:
        root = folder / kind
        _simulate(root, count, kind, jobs)
        sources.append(replace(further_source(root, real.space, real.sensor), simulated=True))
    return sources


def scan_counts_of_scenes(count: int, space: LabelSpace) -> list[int]:
    """Return the number of scans of each simulated data set that a training gets.

    Parameters
    ----------
    count : int
        Number of scenes for each kind of sensor.
    space : LabelSpace
        Classes of the training.

    Returns
    -------
    list of int
        Empty if the simulated classes cannot be merged into these.
    """
    if not count or merged_into(label_space(), space) is None:
        return []
    return [count * SCANS_OF_STREET] * len(RIGS)


def _simulate(root: Path, count: int, kind: str, jobs: int) -> None:
    """Write a data set of simulated scenes; replace one of another version or other settings."""
    record = SynthSettings.from_counts(
        {"train": count, "valid": 0, "test": 0},
        scans=SCANS_OF_STREET,
        seed=SEED_OF_STREETS,
        spacing=STREET_SPACING_M,
        sensor=kind,
    ).record
    recorded = Manifest(root).record(record.stage)
    is_other = recorded is not None and recorded != record
    if recorded != record:
        reason = ": the existing ones have another version or settings" if is_other else ""
        log.log(NOTICE, "simulating %s in %s%s", counted(count, "scene"), root, reason)
    synthesise(
        root,
        train=count,
        valid=0,
        scans=SCANS_OF_STREET,
        seed=SEED_OF_STREETS,
        spacing=STREET_SPACING_M,
        sensor=kind,
        jobs=jobs,
        overwrite=is_other,
    )

# SPDX-License-Identifier: MIT
"""Label the sequences of a data set in parallel, one process for each.

Any backend of joblib works, also that of a cluster: all processes write into one output folder. On
a single machine use `salsanext predict --jobs`.

Run: python examples/parallel_sequences.py dataset/ out/ [weights.safetensors [loky]]
"""

import sys
from pathlib import Path

import joblib

from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection


def label_sequence(dataset: Path, out: Path, weights: Path | None, sequence: str) -> str:
    """Load the network, label one sequence, and return a summary."""
    selection = ScanSelection(sequences=(sequence,))
    outcome = predict_scans(dataset, out, settings=NetworkSettings(weights), selection=selection)
    return f"{sequence}: {outcome.done} done, {len(outcome.failures)} failed"


def main(dataset: str, out: str, weights: str | None = None, backend: str = "loky") -> None:
    sequences = sorted({scan.sequence for scan in find_scans(Path(dataset))})
    arguments = Path(dataset), Path(out), Path(weights) if weights else None
    with joblib.parallel_config(backend, n_jobs=2):
        parallel = joblib.Parallel(return_as="generator")
        jobs = (joblib.delayed(label_sequence)(*arguments, sequence) for sequence in sequences)
        for line in parallel(jobs):
            print(line)


if __name__ == "__main__":
    main(*sys.argv[1:])

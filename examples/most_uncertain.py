# SPDX-License-Identifier: MIT
"""Rank the scans of an output folder of `salsanext uncertainty` by epistemic uncertainty.

Run: python examples/most_uncertain.py out/ [10]
"""

import sys
from pathlib import Path

import numpy as np

from salsanext_cli.runs.results.output_paths import find_outputs


def main(out: str, count: str = "10") -> None:
    files = find_outputs(Path(out), "uncertainty/epistemic")
    if not files:
        sys.exit(f"{out} contains no uncertainty: run `salsanext uncertainty SCANS {out}` first")
    means = {scan: float(np.nanmean(np.load(path))) for scan, path in files.items()}
    for sequence, stem in sorted(means, key=means.__getitem__, reverse=True)[: int(count)]:
        print(f"{means[sequence, stem]:.6f}  {sequence}/{stem}")


if __name__ == "__main__":
    main(*sys.argv[1:])

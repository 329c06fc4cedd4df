# SPDX-License-Identifier: MIT
"""Rank the scans of an output folder by epistemic uncertainty: which to label by hand first.

Run `salsanext uncertainty` before.

Run: python examples/most_uncertain.py out/
"""

import sys
from pathlib import Path

import numpy as np

from salsanext_cli.storage.layout import find_outputs


def main(out: str, count: int = 10) -> None:
    files = find_outputs(Path(out), "uncertainty/epistemic")
    means = {file: float(np.nanmean(np.load(file.path))) for file in files}
    for file in sorted(means, key=means.__getitem__, reverse=True)[:count]:
        print(f"{means[file]:.6f}  {file.sequence}/{file.stem}")


if __name__ == "__main__":
    main(*sys.argv[1:])

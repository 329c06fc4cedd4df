# SPDX-License-Identifier: MIT
"""Folder of results that is typed as a data set of `pick`."""

from pathlib import Path


def results_in(folder: Path) -> Path:
    """Return a folder of results; in a data set of `pick`, that of the picked scans."""
    from salsanext_cli.io.files.reading import is_folder, present
    from salsanext_cli.runs.annotation.picked_data_set import PREDICTED
    from salsanext_cli.runs.scans.layouts import PICK_RECORD

    predicted = folder / PREDICTED
    return predicted if present(folder / PICK_RECORD) and is_folder(predicted) else folder

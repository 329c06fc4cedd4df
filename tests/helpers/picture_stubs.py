# SPDX-License-Identifier: MIT
"""Stand-ins of pictures, which take most of the time of tests that do not look at them."""

import pytest

from salsanext_cli.commands import evaluation
from salsanext_cli.commands.jobs import epoch_files
from salsanext_cli.report import canvas, plots, run_changes, scan_pictures
from salsanext_cli.report.page import labelled_scans

OF_RESULTS = (
    (canvas, "png_of"),
    (canvas, "show_pixels"),
    (evaluation, "confusion_picture"),
    (evaluation, "iou_picture"),
    (labelled_scans, "iou_picture"),
    (plots, "reliability_diagram"),
    (plots, "risk_coverage"),
    (run_changes, "_score_picture"),
    (run_changes, "scan_picture"),
    (scan_pictures, "_draw_from_above"),
)
OF_EPOCHS = ((epoch_files, "curve_picture"), (epoch_files, "samples_picture"))


def draw_no_results(patch: pytest.MonkeyPatch) -> None:
    """Draw no plots of results, no points and no pixels of figures."""
    for module, name in OF_RESULTS:
        patch.setattr(module, name, lambda *_, **__: b"picture")


def draw_no_epochs(patch: pytest.MonkeyPatch) -> None:
    """Draw no pictures of the epochs of a training."""
    for module, name in OF_EPOCHS:
        patch.setattr(module, name, lambda *_: b"picture")

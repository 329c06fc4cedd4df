# SPDX-License-Identifier: MIT
"""Pictures of the documentation, by file name: functions of the real data and the file."""

from collections.abc import Callable
from pathlib import Path

from pictures import concepts, drive, guarantee, pages, pipeline, ranges, ranking, sampling, sensors

OF_PAGE = ("report.webp", "report-scan.webp", "report-without-labels.webp")
"""Pictures that show the page of `report`."""
PICTURES: dict[str, Callable[[Path, Path], None]] = {
    "demo.gif": drive.draw,
    "pipeline.svg": pipeline.draw,
    "concept-range.webp": concepts.range_images,
    "concept-hidden.webp": concepts.hidden_points,
    "concept-knn.webp": concepts.vote,
    "concept-uncertainty.webp": concepts.uncertainties,
    "concept-guarantee.webp": guarantee.draw,
    "report.webp": pages.report,
    "report-scan.webp": pages.report_scan,
    "report-without-labels.webp": pages.report_without_labels,
    "picture.webp": pages.picture,
    "risk-coverage.webp": ranking.draw,
    "uncertainty.png": sampling.draw,
    "ranges/real.webp": ranges.real,
    "ranges/synthetic.webp": ranges.simulated,
    **{f"sensors/{name}.webp": sensors.draw for name in sensors.SCANS},
}

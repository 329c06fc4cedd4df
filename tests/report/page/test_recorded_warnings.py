# SPDX-License-Identifier: MIT
"""Warnings that the stages of a run recorded."""

from pathlib import Path

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.report.page.recorded_warnings import codes_by_scan, warnings_of_run
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_file import ScanFile

FEW = Finding("few-points", "12 points", "drive on")
APART = Finding("apart", "two parts", "look")


def test_warnings_of_all_stages_are_one_line_for_each_code(tmp_path):
    dark = Finding("dark", "no intensity", "look")
    warnings = {f"00/{i}": [dark] for i in range(5)}
    OwnedFolder(tmp_path, "predict").record_findings(warnings, set(warnings))
    OwnedFolder(tmp_path, "uncertainty").record_findings({"00/1": [dark, FEW]}, {"00/1"})
    assert warnings_of_run(tmp_path, warnings) == [
        "dark in 5 scans (00/0, 00/1, 00/2 and 2 more): no intensity; look",
        "few-points in 1 scan (00/1): 12 points; drive on",
    ]
    assert warnings_of_run(tmp_path, {"00/3"}) == ["dark in 1 scan (00/3): no intensity; look"]
    assert warnings_of_run(tmp_path / "none", warnings) == []
    OwnedFolder(tmp_path, "fuse").record_findings({"00": [APART]}, {"00"})
    assert warnings_of_run(tmp_path, {"00"}) == ["apart in 1 sequence (00): two parts; look"]


def test_a_warning_about_a_sequence_counts_for_each_of_its_scans(tmp_path):
    files = [
        ScanFile(sequence=sequence, stem="1", path=Path("/1.bin")) for sequence in ("00", "08")
    ]
    OwnedFolder(tmp_path, "fuse").record_findings({"00": [APART]}, {"00"})
    OwnedFolder(tmp_path, "predict").record_findings({"00/1": [FEW]}, {"00/1"})
    assert codes_by_scan(tmp_path, files) == {"00/1": ["apart", "few-points"], "08/1": []}

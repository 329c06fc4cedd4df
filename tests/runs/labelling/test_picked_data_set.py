# SPDX-License-Identifier: MIT
"""Settings of `pick`, and poses of picked scans."""

import pytest
from scans import write_sequence

from salsanext_cli.runs.labelling.picked_data_set import PickedDataSet, PickSettings
from salsanext_cli.runs.records.stage_settings import ComputedSettings
from salsanext_cli.runs.results.manifest import settings_json
from salsanext_cli.runs.results.paths import find_scans


@pytest.mark.parametrize(
    ("stems", "lines", "picked"),
    [
        (("000000", "000002"), 9, "line 0\nline 2\n"),
        (("000001", "000002"), 2, "line 0\nline 1\n"),
        (("000001", "000002"), 9, None),
    ],
)
def test_poses_with_ambiguous_names_are_skipped(tmp_path, caplog, stems, lines, picked):
    folder = tmp_path / "data/sequences/08"
    write_sequence(folder, stems, labels=False)
    (folder / "poses.txt").write_text("".join(f"line {n}\n" for n in range(lines)))
    PickedDataSet(tmp_path / "out").write_poses(find_scans(tmp_path / "data"))
    target = tmp_path / "out/sequences/08/poses.txt"
    assert (target.read_text() if target.exists() else None) == picked
    assert ("poses.txt: " in caplog.text) == (picked is None)


def test_the_settings_are_one_table_with_those_of_the_network():
    network = ComputedSettings(weights="abc", precision="float32", trained_on="0" * 24)
    settings = PickSettings(
        network=network, count=10, seed=0, scans="3, abc", labelled=None, samples=8
    )
    # The order is that of earlier versions.
    assert [*settings_json(settings).items()] == [
        ("weights", "abc"),
        ("precision", "float32"),
        ("samples", 8),
        ("seed", 0),
        ("trained_on", "0" * 24),
        ("count", 10),
        ("scans", "3, abc"),
        ("strategy", "both"),
    ]

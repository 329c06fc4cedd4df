# SPDX-License-Identifier: MIT
"""Stages with scans unlike training: their intensity is matched and their gaps are filled."""

from dataclasses import replace

import numpy as np
import pytest
from scans import (
    SMALL,
    labels_below,
    refused,
    share_alike,
    write_bin,
    write_sequence,
    write_weights,
)

from salsanext_cli import Scan, knn_refine, project, read_scan
from salsanext_cli.commands.stages.knn_refine import knn_refine_scans
from salsanext_cli.commands.stages.predict import predict_range_images, predict_scans
from salsanext_cli.commands.stages.project import project_scans
from salsanext_cli.commands.stages.uncertainty import uncertainty
from salsanext_cli.core.errors import OutputError, UsageError
from salsanext_cli.core.geometry.network_input import fill_rows, intensity_quantiles, row_gaps
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.scan_selection import ScanSelection

TRAINED = tuple(np.linspace(0, 1, INTENSITY_LEVELS) ** 2)


@pytest.fixture
def knowing(world, tmp_path):
    """Return the world with weights that state the intensity of their training."""
    sensor = replace(SMALL, intensity_quantiles=TRAINED)
    weights = write_weights(tmp_path / "knowing.safetensors", sensor=sensor)
    return replace(world, network=replace(world.network, weights=weights, intensity="auto"))


def run(world, out=None, source=None, **options):
    return predict_scans(source or world.data, out or world.out, settings=world.network, **options)


def scaled(world, folder, scale):
    """Write the scans of the world with another scale of intensity; return the data set."""
    return changed(world, folder, ["00", "08"], lit(lambda scan: scale * scan.intensity))


@pytest.mark.parametrize("scale", [100, 255, 65535])
def test_labels_do_not_depend_on_the_scale_of_the_files(knowing, tmp_path, scale):
    """Percent, bytes as View of Delft writes them, and 16 bits."""
    run(knowing)
    large = scaled(knowing, tmp_path / "large", scale)
    run(knowing, tmp_path / "matched", large)
    raw = replace(knowing, network=replace(knowing.network, intensity="raw"))
    run(raw, tmp_path / "raw", large)
    assert share_alike(knowing.out, tmp_path / "matched") > 0.999
    assert share_alike(knowing.out, tmp_path / "raw") < 0.95


@pytest.mark.usefixtures("workers_in_process")
def test_step_by_step_in_shards_and_by_workers_the_bytes_are_the_same(knowing, tmp_path):
    run(knowing)
    steps = tmp_path / "steps"
    project_scans(knowing.data, steps, sensor=SMALL)
    predict_range_images(steps, steps, settings=knowing.network)
    knn_refine_scans(steps)
    for number in (1, 2):
        run(knowing, tmp_path / "shards", options=RunOptions(shard=Shard(number, 2)))
    run(knowing, tmp_path / "workers", options=RunOptions(jobs=2))
    expected = labels_below(knowing.out)
    assert len(expected) == 3
    for other in (steps, tmp_path / "shards", tmp_path / "workers"):
        assert labels_below(other) == expected


def test_scans_that_come_later_are_matched_as_the_first_ones(knowing):
    run(knowing)
    images = [project(read_scan(p), SMALL).channels for p in sorted(knowing.data.rglob("*.bin"))]
    before = Manifest(knowing.out).settings("predict").sensor
    assert before.intensity_quantiles == intensity_quantiles(images)
    write_sequence(knowing.data / "sequences/09", ["000000"], seed=99)
    assert run(knowing).done == 1
    assert Manifest(knowing.out).settings("predict").sensor == before
    few = UncertaintyMethod(samples=2, aleatoric="none")
    uncertainty(knowing.data, knowing.out, settings=knowing.network, method=few)
    assert Manifest(knowing.out).settings("uncertainty").sensor == before


def changed(world, folder, scans, change):
    """Write the scans of the world, some of them with other intensities; return the data set."""
    for file in sorted(world.data.rglob("*.bin")):
        scan, copy = read_scan(file), folder / file.relative_to(world.data)
        of = change(scan) if file.relative_to(world.data).parts[1] in scans else scan
        copy.parent.mkdir(parents=True, exist_ok=True)
        write_bin(copy, of)
    return folder


def lit(intensity):
    """Return a function that gives a scan other intensities."""
    return lambda scan: Scan(scan.points, np.asarray(intensity(scan), np.float32))


def test_the_fit_does_not_depend_on_the_selection(knowing, tmp_path):
    dark = changed(knowing, tmp_path / "data", ["00"], lit(lambda scan: 0.3 * scan.intensity**3))
    run(knowing, source=dark)
    expected = labels_below(knowing.out)
    assert len(expected) == 3
    for number, first in enumerate((ScanSelection("valid"), ScanSelection(limit=1))):
        out = tmp_path / f"{number}"
        assert run(knowing, out, dark, selection=first).done
        assert labels_below(out).items() < expected.items()
        assert run(knowing, out, dark).done
        assert labels_below(out) == expected


@pytest.mark.parametrize(
    ("odd", "is_labelled"),
    [
        (lambda scan: Scan(scan.points[:3], scan.intensity[:3]), True),
        (lambda scan: Scan(1000 * scan.points, scan.intensity**3), False),
    ],
)
def test_odd_scans_leave_the_others_as_they_are(knowing, tmp_path, odd, is_labelled):
    for number in range(2):
        seed = 50 + number
        write_sequence(knowing.data / "sequences/08", [f"{seed}"], count=4000, seed=seed)
    (tmp_path / "one/sequences").mkdir(parents=True)
    (tmp_path / "one/sequences/08").symlink_to(knowing.data / "sequences/08")
    run(knowing, selection=ScanSelection(sequences=("08",)), source=tmp_path / "one")
    expected = labels_below(knowing.out)
    run(knowing, tmp_path / "odd", changed(knowing, tmp_path / "data", ["00"], odd))
    found = labels_below(tmp_path / "odd")
    assert expected.items() <= found.items()
    assert (len(expected), len(found)) == (4, 4 + is_labelled)


def ring(scan):
    """Return the number of the beam."""
    return np.round(40 * scan.points[:, 2] / np.linalg.norm(scan.points, axis=1))


def simulated(scan):
    """Return the intensity of CARLA, which falls with the range whatever the surface is."""
    return np.exp(-0.004 * np.linalg.norm(scan.points, axis=1))


@pytest.mark.parametrize("none", [ring, simulated])
def test_values_that_are_not_intensities_count_as_none(knowing, tmp_path, none):
    blind = replace(knowing, network=replace(knowing.network, intensity="none"))
    run(blind)
    expected = labels_below(knowing.out)
    every = changed(knowing, tmp_path / "a", ["00", "08"], lit(none))
    outcome = run(knowing, tmp_path / "all", every)
    (warning,) = (w for w in outcome.summary.warnings() if w.code == "no-intensity")
    assert len(warning.scans) == 3
    assert labels_below(tmp_path / "all") == expected
    run(knowing, tmp_path / "one", changed(knowing, tmp_path / "b", ["00"], lit(none)))
    name = next(name for name in expected if "00/predictions" in name)
    assert labels_below(tmp_path / "one")[name] == expected[name]


def test_scans_of_another_scale_than_earlier_ones_are_a_warning(knowing, tmp_path):
    run(knowing, source=knowing.data / "sequences/00")
    large = scaled(knowing, tmp_path / "large", 255)
    outcome = run(knowing, source=large / "sequences/08")
    (warning,) = (w for w in outcome.summary.warnings() if w.code == "intensity-scale")
    assert warning.scans == ["08/000000", "08/000001"]
    raw = replace(knowing.network, intensity="raw")
    with pytest.raises(OutputError, match=r"\(intensity\)"):
        predict_scans(knowing.data / "sequences/00", knowing.out, settings=raw)


def test_weights_without_the_intensity_of_training(world):
    network = replace(world.network, intensity="match")
    refused(UsageError, "intensity", predict_scans, world.data, world.out, settings=network)
    predict_scans(world.data, world.out, settings=replace(network, intensity="auto"))
    recorded = Manifest(world.out).settings("predict").sensor
    assert recorded.intensity_quantiles == ()


def test_range_images_without_intensity_are_doubted_as_their_scans_are(knowing, tmp_path):
    dark = scaled(knowing, tmp_path / "dark", 0.0)
    steps = tmp_path / "steps"
    project_scans(dark, steps, sensor=SMALL)
    outcome = predict_range_images(steps, steps, settings=knowing.network)
    (warning,) = outcome.summary.warnings()
    assert (warning.code, len(warning.scans)) == ("no-intensity", 3)


def test_the_network_sees_no_gaps(world, tmp_path):
    """Scans of fewer beams, with weights that state the gaps of their training."""
    weights = write_weights(tmp_path / "knowing.safetensors", sensor=replace(SMALL, row_gaps=0.1))
    for file in sorted(world.data.rglob("*.bin")):
        scan = read_scan(file)
        rows = project(scan, SMALL).pixel_of_point // SMALL.width
        write_bin(file, scan.take(np.flatnonzero(rows % 2)))
        labels = file.parents[1] / "labels" / f"{file.stem}.label"
        labels.write_bytes(np.fromfile(labels, "<u4")[rows % 2 == 1].tobytes())
    knowing = replace(world, network=replace(world.network, weights=weights))
    assert run(knowing).done == 3
    scans = [read_scan(path) for path in sorted(knowing.data.rglob("*.bin"))]
    images = [project(scan, SMALL) for scan in scans]
    recorded = Manifest(knowing.out).settings("predict").sensor
    assert recorded.row_gaps == row_gaps(image.channels for image in images) > 0.3
    network = knowing.network.load()
    space = network.card.space
    for image, content in zip(images, labels_below(knowing.out).values(), strict=True):
        full = replace(image, channels=fill_rows(image.channels))
        labels = knn_refine(image, network.probabilities(full).argmax(0), space.class_count)
        np.testing.assert_array_equal(np.frombuffer(content, "<u4"), space.to_raw(labels))

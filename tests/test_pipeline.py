# SPDX-License-Identifier: MIT
"""The pipeline as a user types it: whole command lines in processes of their own."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import plyfile
import pytest
from scans import files_below, labels_below, write_sequence

from salsanext_cli import label_space, read_labels, sensor
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import RunOptions
from salsanext_cli.stages.export_ply import export_ply
from salsanext_cli.stages.import_weights import import_weights
from salsanext_cli.stages.knn_refine import knn_refine_scans
from salsanext_cli.stages.predict import predict_range_images, predict_scans
from salsanext_cli.stages.project import project_scans
from salsanext_cli.stages.uncertainty import uncertainty
from salsanext_cli.uncertainty.method import UncertaintyMethod

THREE_LINES = (
    "salsanext predict seq/velodyne out/",
    "salsanext eval --split valid",
    "salsanext export-ply --colour uncertainty",
)
SCANS, POINTS = 300, 200
"""Of a drive that takes longer to label than a test waits."""


@pytest.fixture
def shell(tmp_path, weights):
    """Run a line in a folder; a `salsanext` whose default weights are the test's is on the path."""
    script = tmp_path / "bin" / "salsanext"
    script.parent.mkdir()
    script.write_text(
        f"#!{sys.executable}\n"
        "from pathlib import Path\n"
        "import salsanext_cli.network.card as weights\n"
        f"weights.default_weights = lambda: Path({str(weights)!r})\n"
        "from salsanext_cli.cli.app import main\n"
        "main()\n"
    )
    script.chmod(0o755)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SALSANEXT_")}
    environment["PATH"] = f"{script.parent}{os.pathsep}{environment['PATH']}"

    def run(line, folder):
        return subprocess.run(
            shlex.split(line),
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    return run


def assert_scored_and_exported(folder, sequence):
    out = folder / "out"
    assert (out / "scores.txt").read_text().startswith("accuracy_mean: ")
    (cloud,) = (out / "sequences" / sequence / "ply").iterdir()
    vertex = plyfile.PlyData.read(cloud)["vertex"]
    names = {p.name for p in vertex.properties}
    kinds = ("label", "truth", "wrong", "least_confidence")
    assert {f"scalar_{kind}" for kind in kinds} <= names
    assert np.isfinite(vertex["scalar_least_confidence"]).all()
    assert len(np.unique(vertex["green"])) > 20


def test_the_three_lines_as_typed(shell, tmp_path):
    """In the root of a data set, where `seq` is one of its sequences."""
    folder = tmp_path / "Semantic KITTI"
    write_sequence(folder / "sequences/08", ["000000"])
    (folder / "seq").symlink_to("sequences/08")
    for line in THREE_LINES:
        done = shell(line, folder)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
    assert_scored_and_exported(folder, "seq")


@pytest.mark.parametrize("jobs", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_ctrl_c_in_the_middle(weights, tmp_path, jobs):
    stems = [f"{number:06d}" for number in range(SCANS)]
    many = write_sequence(tmp_path / "many", stems, count=POINTS, labels=False)
    out = tmp_path / "out"
    line = ["predict", many, out, "--weights", weights, "--device", "cpu", "--jobs", jobs]
    process = subprocess.Popen(
        [sys.executable, "-c", "from salsanext_cli.cli.app import main; main()", *map(str, line)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 240
        while len(list(out.rglob("*.label"))) < 5:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert stdout == ""
    first, *before, last = stderr.splitlines()
    assert first.endswith("on cpu by openvino in float32")
    assert last == "interrupted: everything finished so far is intact"
    # A slow machine has time to say how far it is.
    assert all(re.match(r"predict: \d+/300 scans|warning", line) for line in before), stderr
    whole = labels_below(out)
    assert 5 <= len(whole) < SCANS
    assert {len(content) for content in whole.values()} == {4 * POINTS}
    assert [name for name in files_below(out) if ".part" in name] == []
    again = predict_scans(
        many, out, settings=NetworkSettings(weights, "cpu"), selection=ScanSelection(limit=40)
    )
    assert again.skipped + again.done == 40
    assert again.skipped >= min(len(whole), 5)
    assert labels_below(out).items() >= whole.items()


@pytest.mark.slow
def test_two_jobs_give_the_bytes_of_one(tmp_path, weights):
    """Through every stage that runs a network."""
    data = write_sequence(tmp_path / "one", ["a", "b", "c"])
    network = NetworkSettings(weights, "cpu")
    for jobs in (1, 2):
        out, options = tmp_path / f"jobs{jobs}", RunOptions(jobs=jobs)
        extras = ("pixel_labels", "probabilities")
        predict_scans(data, out, settings=network, extras=extras, options=options)
        uncertainty(
            data, out, settings=network, method=UncertaintyMethod(samples=3), options=options
        )
        export_ply(out, colour="epistemic", options=options)
    one, two = (files_below(tmp_path / f"jobs{jobs}") for jobs in (1, 2))
    stages = {"predict.json", "predict.warnings.json", "uncertainty.json", "export-ply.json"}
    assert {name for name in one if "/" not in name} == stages
    assert len(one) == 3 * 10 + len(stages)
    assert one == two


@pytest.mark.real
def test_real_scans_in_steps_or_in_one(golden, real_data, tmp_path):
    """Published weights on real scans, a quarter of the width to save time."""
    import_weights(golden / "SalsaNext", tmp_path / "w.safetensors", half=True)
    view = sensor("hdl64-512")
    network = NetworkSettings(tmp_path / "w.safetensors", "cpu", sensor=view)
    data, selection = real_data / "data/semantickitti", ScanSelection(split="valid", limit=2)
    project_scans(data, tmp_path / "steps", sensor=view, selection=selection)
    predict_range_images(tmp_path / "steps", tmp_path / "steps", settings=network)
    knn_refine_scans(tmp_path / "steps")
    predict_scans(data, tmp_path / "fused", settings=network, selection=selection)
    labels = labels_below(tmp_path / "fused")
    assert labels_below(tmp_path / "steps") == labels
    assert list(labels) == [f"sequences/08/predictions/00000{n}.label" for n in (0, 1)]
    for content in labels.values():
        ids = set(np.frombuffer(content, "<u4"))
        assert ids <= set(label_space().learning_map_inv.values())
        assert len(ids) > 3


@pytest.mark.real
def test_knn_refine_betters_real_labels_that_were_cut_to_pixels(real_data, tmp_path):
    """Truth, one label per pixel, refined: most points get their own label back."""
    sequence = tmp_path / "08"
    for kind, suffix in (("velodyne", "bin"), ("labels", "label")):
        source = real_data / "data/semantickitti/sequences/08" / kind / f"000000.{suffix}"
        (sequence / kind).mkdir(parents=True)
        shutil.copy(source, sequence / kind)
    knn_refine_scans(tmp_path / "out", labels=sequence / "labels", dataset=sequence)
    space = label_space()
    truth = space.to_train(read_labels(sequence / "labels/000000.label"))
    refined = space.to_train(read_labels(tmp_path / "out/sequences/08/predictions/000000.label"))
    labelled = truth > 0
    assert (refined == truth)[labelled].mean() > 0.95

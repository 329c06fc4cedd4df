# SPDX-License-Identifier: MIT
"""Names and errors that other programs use."""

import ast
import importlib
import logging
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import called, logger_as_before, python
from scans import SMALL, labels_below, make_scan, salsanext_of, write_bin, write_weights
from shallow_network import SHALLOW

import salsanext_cli as sn
from salsanext_cli.commands.line.output.console import Output, log_to_stderr
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.errors import FormatError, OutputError, SalsanextError
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS
from salsanext_cli.core.texts import escaped, printable
from salsanext_cli.runs.network_settings import NetworkSettings

NAMES = [name for name in sn.__all__ if not name.startswith("__")]
HEAVY = ("torch", "numpy", "numba", "open3d", "matplotlib", "typer", "rich", "yaml", "plyfile")


def typed_names():
    """Return the modules of the names that type checkers see."""
    tree = ast.parse(Path(sn.__file__).read_text("utf-8"))
    (block,) = [n for n in tree.body if isinstance(n, ast.If)]
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    homes = {alias.name: node.module for node in block.body for alias in node.names}
    return {name: home for name, home in homes.items() if home != "typing"}


def test_names_are_those_of_type_checkers_and_modules_and_others_are_errors():
    assert set(NAMES) == set(typed_names())
    assert list(sn.__all__) == sorted(set(sn.__all__))
    assert set(NAMES) <= set(dir(sn))
    for name, home in typed_names().items():
        assert getattr(sn, name) is getattr(importlib.import_module(home), name)
        assert getattr(sn, name).__doc__, name
    with pytest.raises(AttributeError) as caught:
        _ = sn.predikt
    assert "predikt" in str(caught.value)
    names: dict[str, object] = {}
    exec("from salsanext_cli import *", names)
    assert set(NAMES) <= set(names)


def test_importing_imports_nothing_heavy():
    """And the table of formats neither numpy nor readers."""
    code = f"import sys, salsanext_cli; print([n for n in {HEAVY!r} if n in sys.modules])\n"
    code += (
        "import salsanext_cli.io.formats; print({'numpy', 'importlib.metadata'} & {*sys.modules})"
    )
    assert python(code).stdout == "[]\nset()\n"


@pytest.fixture
def weights(tmp_path: Path) -> Iterator[Path]:
    """Return weights of two levels, which salsanext has as long as the test runs."""
    with salsanext_of(**SHALLOW):
        yield write_weights(tmp_path / "shallow.safetensors")


@pytest.fixture
def other_sensor(tmp_path, monkeypatch, weights):
    """Return scans upside down, with intensities up to 255, and write weights with quantiles."""
    monkeypatch.chdir(tmp_path)
    known = replace(SMALL, intensity_quantiles=tuple(np.linspace(0, 1, INTENSITY_LEVELS) ** 2))
    write_weights(Path("weights.safetensors"), sensor=known)
    for number in range(3):
        scan = make_scan(4000, number)
        turned = scan.points * np.float32([1, -1, -1])
        write_bin(Path(f"scans/{number}.bin"), sn.Scan(turned, np.floor(255 * scan.intensity)))
    return Path("scans")


def test_python_labels_as_the_command_line_does(other_sensor, tmp_path):
    options = ["--weights", "weights.safetensors", "--device", "cpu", "--quiet"]
    called("predict", "scans", "out", *options)
    expected = labels_below(tmp_path / "out")

    stage = NetworkSettings(Path("weights.safetensors"), "cpu")
    predict_scans(other_sensor, tmp_path / "stage", settings=stage)
    assert labels_below(tmp_path / "stage") == expected

    scans = [sn.read_scan(path) for path in sorted(other_sensor.iterdir())]
    plain = sn.load_network("weights.safetensors", device="cpu")
    unfitted = [sn.project(scan, plain.sensor) for scan in scans]
    others = [sn.knn_refine(image, plain.probabilities(image).argmax(0)) for image in unfitted]
    differing = 0
    for source in (other_sensor, "scans", scans):
        network = sn.fit_network(plain, source)
        for scan, raw, other in zip(scans, expected.values(), others, strict=True):
            image = sn.project(scan, network.sensor)
            labels = sn.knn_refine(image, network.probabilities(image).argmax(0))
            assert network.card.space.to_raw(labels).astype("<u4").tobytes() == raw
            differing += int((other != labels).sum())
    assert differing


def test_label_labels_as_the_command_line_does(other_sensor, tmp_path, caplog):
    options = ["--weights", "weights.safetensors", "--device", "cpu", "--quiet", "--probabilities"]
    (first, *_) = sorted(other_sensor.iterdir())
    called("predict", first, "out", *options, "--precision", "auto")
    (expected,) = labels_below(tmp_path / "out").values()
    (softmax,) = (tmp_path / "out").glob("sequences/*/probabilities/*.npy")

    scan = sn.read_scan(first)
    network = sn.load_network("weights.safetensors", "cpu", precision="auto")
    fitted = sn.fit_network(network, [scan])
    for weights in ("weights.safetensors", fitted):
        labels, probabilities, error = sn.label(scan.points, scan.intensity, weights)
        assert sn.label_space().to_raw(labels).astype("<u4").tobytes() == expected
        np.testing.assert_array_equal(probabilities.astype(np.float16), np.load(softmax))
        assert error is None
    elsewhere = scan.points + np.array([700_000.0, 5_300_000.0, 400.0])
    of_map = sn.label(elsewhere, scan.intensity, fitted, origin=[700_000, 5_300_000, 400])
    np.testing.assert_array_equal(of_map.labels, labels)
    lists = sn.label(scan.points.tolist(), scan.intensity.astype(int).tolist(), fitted)
    np.testing.assert_array_equal(lists.labels, labels)
    caplog.set_level("WARNING", "salsanext_cli")
    sn.label(scan.points, weights=fitted)
    assert "(no-intensity)" in caplog.text


def test_warnings_are_on_stderr_without_any_logging_set_up():
    words = "from salsanext_cli.core.fitting import network_fit as s; s.log.warning('so')"
    process = subprocess.run([sys.executable, "-c", words], capture_output=True, check=True)
    assert process.stderr.decode().strip() == "so"


@pytest.mark.parametrize(
    ("points", "intensity", "subject"),
    [
        (np.zeros((9, 4)), None, "points"),
        (np.zeros((9, 3)), np.zeros(8), "intensity"),
        ([["a", "b", "c"]], None, "points"),
        ([[1, 2, 3], [4, 5]], None, "points"),
        (np.zeros((200, 3)), None, "points"),
        (np.full((200, 3), 1e300), None, "points"),
        (np.full((200, 3), 5e3), None, "points"),
    ],
)
def test_label_refuses_arrays_that_are_not_points(weights, points, intensity, subject):
    with pytest.raises(sn.SalsanextError) as caught:
        sn.label(points, intensity, sn.load_network(weights, "cpu", engine="torch"))
    assert caught.value.subject == subject


@pytest.mark.parametrize("origin", [[1, 2], "here", [1, 2, np.nan]])
def test_label_refuses_an_origin_that_is_no_position(weights, origin):
    with pytest.raises(sn.SalsanextError) as caught:
        sn.label(np.ones((9, 3)), None, sn.load_network(weights, "cpu", engine="torch"), origin)
    assert caught.value.subject == "origin"


def test_label_of_no_points_is_a_warning(weights, caplog):
    result = sn.label(np.zeros((0, 3)), None, sn.load_network(weights, "cpu", engine="torch"))
    assert (result.labels.shape, result.probabilities.shape) == ((0,), (0, 20))
    assert "few-points" in caplog.text


def test_a_fit_may_exclude_field_of_view_or_intensity(other_sensor):
    plain = sn.load_network("weights.safetensors", device="cpu")
    fitted = sn.fit_network(plain, other_sensor)
    assert fitted.sensor.up == pytest.approx((0, 0, -1), abs=0.01)
    assert fitted.sensor.intensity_quantiles[-1] == pytest.approx(254, abs=2)
    unfitted = sn.fit_network(plain, other_sensor, view=False).sensor
    of_scans = {"min_range": unfitted.min_range, "ego_box": ()}
    assert unfitted.view() == plain.sensor.view() | of_scans
    raw = sn.fit_network(plain, other_sensor, intensity="raw")
    assert raw.sensor == replace(fitted.sensor, intensity_quantiles=())
    with pytest.raises(sn.SalsanextError) as caught:
        sn.fit_network(plain, "nowhere")
    assert caught.value.subject == "nowhere"


def test_errors_and_data_for_other_programs_are_printable_and_errors_can_be_pickled():
    assert str(SalsanextError("a", "b", "c", "d")) == "a: b (expected c)\nhint: d"
    assert str(SalsanextError("a", "b", hint="d")) == "a: b\nhint: d"
    error = OutputError("out", "disk full", hint="free some space")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is OutputError
    assert vars(copy) == vars(error)
    text = str(FormatError("a\nerror: b\x1b]0;x\x07.bin", "cut\x9b off", hint="größer"))
    assert text == "a\\x0aerror: b\\x1b]0;x\\x07.bin: cut\\x9b off\nhint: größer"
    assert printable("ä\t\x7f") == "ä\\x09\\x7f"
    assert printable("a\u202enib.bin\u2028\u2066") == "a\\u202enib.bin\\u2028\\u2066"
    data = {"a\udcff": ["b\udc80\n", ("ü", 1)], "deep": {"c": None, 3: 0.5}}
    expected = {"a\\xff": ["b\\x80\n", ["ü", 1]], "deep": {"c": None, 3: 0.5}}
    assert escaped(data) == expected


def test_every_error_has_a_documented_code():
    kinds = [SalsanextError, *SalsanextError.__subclasses__()]
    (page,) = (Path(__file__).parents[1] / "docs").rglob("json.md")
    table = page.read_text("utf-8").partition("| code | meaning |")[2].partition("\n\n")[0]
    codes = set(re.findall(r"`([a-z-]+)`", table)) - {"interrupted", "terminated"}
    assert codes == {kind.code for kind in kinds}
    assert len(codes) == len(kinds)


def test_commands_log_and_print_printable_text(capsys):
    with logger_as_before():
        output = Output(verbose=True)
        log_to_stderr(verbose=True)
        logging.getLogger("salsanext_cli").info("reading %s", "a\x1b[2J.bin")
        output.print("→ b\x07\nc")
    assert capsys.readouterr().err == "reading a\\x1b[2J.bin\n→ b\\x07\\x0ac\n"

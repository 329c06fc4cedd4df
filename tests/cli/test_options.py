# SPDX-License-Identifier: MIT
from pathlib import Path

import pytest

from salsanext_cli.cli import options
from salsanext_cli.errors import UsageError
from salsanext_cli.parallel.run import RunOptions


@pytest.mark.parametrize(
    ("text", "names"), [(None, ()), ("08", ("08",)), (" 00, 8 ,my drive", ("00", "8", "my drive"))]
)
def test_sequences(text, names):
    assert options.choice(None, text, None).sequences == names


@pytest.mark.parametrize("text", ["", " ", ","])
def test_sequences_that_are_none(text):
    with pytest.raises(UsageError, match="--sequences"):
        options.choice(None, text, None)


def test_where_scans_are_looked_for(monkeypatch):
    assert options.source(Path("a"), Path("b")) == Path("a")
    assert options.source(None, Path("b")) == Path("b")
    assert options.source(None) == Path()
    monkeypatch.setenv("SALSANEXT_DATASET", "/data")
    assert options.usual_dataset() == Path("/data")


def test_looking_up():
    assert options.sensor("hdl64").name == "hdl64"
    assert options.label_space(None) is None
    assert options.label_space("semantic-kitti").class_count == 20
    assert options.network(Path("w"), "cpu", "hdl32", "auto").sensor.name == "hdl32"
    assert options.network(None, "cpu", None, "float32").sensor is None
    assert options.knn(3, 7, 2.0, 0.5).window == 7
    with pytest.raises(UsageError, match="no preset and no file"):
        options.sensor("hdl65")


def test_errors_are_skipped_or_stop():
    for choice in options.OnError:
        assert RunOptions(on_error=choice.value).on_error == choice

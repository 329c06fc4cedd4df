# SPDX-License-Identifier: MIT
from pathlib import Path

import pytest

from salsanext_cli.errors import OutputError
from salsanext_cli.files.json_files import RecordedSettings

SETTINGS = RecordedSettings(
    {"n": 3, "endless": "Infinity", "marks": [1, 2.5, 4], "in": {"k": 5}},
    Path("out/predict.json"),
)


def test_settings_are_read_back():
    assert SETTINGS.numbers("marks") == (1.0, 2.5, 4.0)
    assert SETTINGS.table("in")["k"] == 5
    assert SETTINGS.get("none") is None


@pytest.mark.parametrize("read", ["numbers", "table", "__getitem__"])
def test_what_was_cut_out_is_named(read):
    with pytest.raises(OutputError, match=r"out/predict\.json · settings lack none · .*delete it"):
        getattr(SETTINGS, read)("none")
    with pytest.raises(OutputError, match=r"out/predict\.json · settings lack none"):
        SETTINGS.table("in")["none"]


def test_what_was_put_in_is_named():
    for read, key in (
        *(("numbers", key) for key in ("n", "endless", "in")),
        *(("table", key) for key in ("n", "marks", "endless")),
    ):
        with pytest.raises(OutputError, match=rf"out/predict\.json · settings have {key} "):
            getattr(SETTINGS, read)(key)

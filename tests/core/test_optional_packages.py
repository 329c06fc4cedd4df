# SPDX-License-Identifier: MIT
"""Commands that install optional packages, and interruptions of imports."""

import json
import shlex
from pathlib import Path

import pytest

from salsanext_cli.core.errors import MissingDependency
from salsanext_cli.core.optional_packages import extra_command, import_extra, import_package


def install_from(record: object, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the package in a folder of the path, with an installer's record of its source."""
    installed = folder / "site-packages/salsanext-1.0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: salsanext\nVersion: 1.0\n")
    if record is not None:
        text = record if isinstance(record, str) else json.dumps(record)
        (installed / "direct_url.json").write_text(text)
    monkeypatch.syspath_prepend(installed.parent)


@pytest.mark.parametrize(("is_editable", "option"), [(True, ["-e"]), (False, [])])
def test_an_extra_of_a_clone_is_installed_from_it(tmp_path, monkeypatch, is_editable, option):
    clone = tmp_path / "my clone"
    clone.mkdir()
    (clone / "pyproject.toml").touch()
    directory = {"editable": True} if is_editable else {}
    install_from({"url": clone.as_uri(), "dir_info": directory}, tmp_path, monkeypatch)
    assert shlex.split(extra_command("ros")) == ["pip", "install", *option, f"{clone}[ros]"]
    plug_in = ["pip", "install", f"{clone}/examples/paper_networks"]
    assert shlex.split(extra_command("paper")) == plug_in
    with pytest.raises(MissingDependency) as caught:
        import_extra("salsanext_no_such_package", "ros")
    assert caught.value.hint == extra_command("ros")


@pytest.mark.parametrize(
    "record",
    [
        None,
        "",
        "{",
        "[]",
        {},
        {"url": "file:///nowhere/at/all", "dir_info": {}},
        {"url": Path(__file__).as_uri(), "archive_info": {}},
    ],
)
def test_otherwise_both_ways_are_named(tmp_path, monkeypatch, record):
    install_from(record, tmp_path, monkeypatch)
    assert "'salsanext[ros]'" in extra_command("ros")
    assert "'.[ros]'" in extra_command("ros")
    assert "'salsanext[paper]'" in extra_command("paper")
    assert extra_command("paper").endswith(" examples/paper_networks")


INTERRUPTED = """
try:
    raise KeyboardInterrupt
except KeyboardInterrupt as error:
    try:
        raise RuntimeError("no memory") from error
    except RuntimeError:
        raise ImportError("initialization failed")
"""


def test_an_interrupted_import_is_not_a_missing_package(tmp_path, monkeypatch):
    (tmp_path / "interrupted_package.py").write_text(INTERRUPTED)
    (tmp_path / "broken_package.py").write_text("raise ImportError('initialization failed')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        import_package("interrupted_package")
    with pytest.raises(MissingDependency):
        import_package("broken_package")

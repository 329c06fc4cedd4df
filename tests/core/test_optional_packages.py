# SPDX-License-Identifier: MIT
"""Commands that install optional packages."""

import json
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from salsanext_cli.core import optional_packages
from salsanext_cli.core.errors import MissingDependency
from salsanext_cli.core.optional_packages import extra_command, import_extra


def installed_from(monkeypatch, record: object) -> None:
    """Have an installer's record of the source of the package."""
    text = record if isinstance(record, str) or record is None else json.dumps(record)
    found = SimpleNamespace(read_text=lambda name: text)
    monkeypatch.setattr(optional_packages, "distribution", lambda name: found)


@pytest.mark.parametrize(("is_editable", "option"), [(True, ["-e"]), (False, [])])
def test_an_extra_of_a_clone_is_installed_from_it(tmp_path, monkeypatch, is_editable, option):
    clone = tmp_path / "my clone"
    clone.mkdir()
    (clone / "pyproject.toml").touch()
    directory = {"editable": True} if is_editable else {}
    installed_from(monkeypatch, {"url": clone.as_uri(), "dir_info": directory})
    assert shlex.split(extra_command("ros")) == ["pip", "install", *option, f"{clone}[ros]"]
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
def test_otherwise_both_ways_are_named(monkeypatch, record):
    installed_from(monkeypatch, record)
    assert "'salsanext[ros]'" in extra_command("ros")
    assert "'.[ros]'" in extra_command("ros")

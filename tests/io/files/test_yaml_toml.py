# SPDX-License-Identifier: MIT
"""Texts of settings are read within bounds, and refused beyond them."""

import pytest
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.io.files.yaml_toml import (
    MAX_LINE_CHARACTERS,
    MAX_NESTED_BRACKETS,
    MAX_TOML_BYTES,
    MAX_YAML_BYTES,
    read_toml,
    read_yaml,
)

BAD_YAML = {
    "a reference": b"a: &x [1]\nb: *x\n",
    "nested brackets": b"[" * (MAX_NESTED_BRACKETS + 1) + b"]" * (MAX_NESTED_BRACKETS + 1),
    "too many bytes": b"a: 1\n" + b"#" * MAX_YAML_BYTES,
    "no text": b"\xff\xfe\xff",
    "an invalid date": b"a: 2020-13-45\n",
    "code": b"!!python/object/apply:os.system ['true']\n",
    "an open bracket": b"a: [1\n",
}
BAD_TOML = {
    "too many bytes": b"#" * (MAX_TOML_BYTES + 1),
    "a long line": b"a = '" + b"x" * MAX_LINE_CHARACTERS + b"'\n",
    "no text": b"\xff",
    "no table": b"a = \n",
    "a key twice": b"a = 1\na = 2\n",
}


def test_plain_values_are_read(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a: 1\r\nb: [x, 2.5, null]\r\n")
    assert read_yaml(path, "a mapping") == {"a": 1, "b": ["x", 2.5, None]}
    path.write_bytes(b"a = 1\r\nb = [2.5]\r\n")
    assert read_toml(path, "sensor", ()) == {"a": 1, "b": [2.5]}


def test_each_caller_gets_values_of_its_own(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a: [1]\n")
    first = read_yaml(path, "a mapping")
    first["a"].append(2)
    assert read_yaml(path, "a mapping") == {"a": [1]}
    path.write_bytes(b"a: [3]\n")
    assert read_yaml(path, "a mapping") == {"a": [3]}


@pytest.mark.parametrize("what", BAD_YAML)
def test_other_yaml_is_refused(what, tmp_path):
    path = tmp_path / "labels.yaml"
    path.write_bytes(BAD_YAML[what])
    refused(UsageError, path, read_yaml, path, "a mapping")


@pytest.mark.parametrize("what", BAD_TOML)
def test_other_toml_is_refused(what, tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_bytes(BAD_TOML[what])
    refused(UsageError, path, read_toml, path, "sensor", ())


def test_the_largest_nesting_and_the_largest_file_are_read(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"[" * MAX_NESTED_BRACKETS + b"]" * MAX_NESTED_BRACKETS)
    read_yaml(path, "a list")
    lines = b"#" * (MAX_LINE_CHARACTERS - 1) + b"\n"
    path.write_bytes((lines * (MAX_TOML_BYTES // len(lines) + 1))[:MAX_TOML_BYTES])
    assert read_toml(path, "sensor", ()) == {}


def test_a_missing_file_names_the_presets(tmp_path):
    caught = refused(
        UsageError, "sensor hdl65", read_toml, tmp_path.joinpath("hdl65").relative_to(tmp_path),
        "sensor", ("hdl64", "os1"),
    )  # fmt: skip
    assert "hdl64" in caught.value.hint
    assert "hdl64, os1" in str(caught.value)

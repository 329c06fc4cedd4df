# SPDX-License-Identifier: MIT
"""The names and versions of what computes."""

import platform

import numpy as np
import pytest

from salsanext_cli.core.engines import machine

CPUINFO = {
    "processor : 0\nmodel name\t: AMD EPYC 9\nprocessor : 1\n": "AMD EPYC 9",
    "Model : Raspberry Pi 5: B\n": "Raspberry Pi 5: B",
    "Hardware : BCM2711\nmodel name :\n": "BCM2711",
}


@pytest.mark.parametrize("text", CPUINFO)
def test_a_processor_has_the_name_that_the_system_states(text):
    assert machine.name_in(text) == CPUINFO[text]


def test_without_a_statement_its_kind_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "CPUINFO", tmp_path / "missing")
    assert machine.processor_name() == (platform.processor() or platform.machine())


def test_the_statement_is_in_a_file_of_the_system(tmp_path, monkeypatch):
    (tmp_path / "cpuinfo").write_text("model name : Test 1\n")
    monkeypatch.setattr(machine, "CPUINFO", tmp_path / "cpuinfo")
    assert machine.processor_name() == "Test 1"


def test_versions_are_of_installed_packages_and_of_python():
    versions = machine.versions(["numpy", "no-such-package"])
    assert versions["numpy"] == np.__version__
    assert versions["no-such-package"] is None
    assert versions["python"] == platform.python_version()


def test_a_cpu_has_no_gpu():
    assert machine.machine("cpu")["gpu"] is None

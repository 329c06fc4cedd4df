# SPDX-License-Identifier: MIT
"""Device, precision and engine that are chosen."""

import pytest
import torch
from scans import refused

from salsanext_cli.core.engines import device
from salsanext_cli.core.engines.device import choose_device, choose_precision
from salsanext_cli.core.engines.registry import choose_engine
from salsanext_cli.core.errors import UsageError


def test_chosen_devices_precisions_and_engines():
    assert choose_device("cpu") == choose_device("cpu:0") == "cpu"
    assert choose_device("auto") == ("cuda" if torch.cuda.is_available() else "cpu")
    assert choose_precision("int8", "cpu", "openvino") == "int8"
    assert choose_precision("auto", "cpu", "openvino") != "int8"
    for place in ("cuda", "cpu"):
        caught = refused(UsageError, "precision", choose_precision, "int8", place, "torch")
        assert "cpu" in caught.value.hint
        assert "openvino" in caught.value.hint
    assert choose_engine("auto", "cpu") == choose_engine("openvino", "cpu") == "openvino"
    assert choose_engine("torch", "cpu") == choose_engine("auto", "cuda:1") == "torch"
    for name, place in (("openvino", "cuda"), ("onnx", "cpu")):
        refused(UsageError, "engine", choose_engine, name, place)


@pytest.mark.parametrize(
    ("flags", "limit", "expected"),
    [
        ("fpu avx2 avx512f avx512_bf16", None, "avx512_bf16"),
        ("fpu avx512_bf16 amx_bf16 amx_tile", None, "amx_bf16 avx512_bf16"),
        ("fpu avx512_bf16 amx_bf16 amx_tile", "AVX512_CORE_BF16", "avx512_bf16"),
        ("fp asimd bf16", None, "bf16"),
        ("fpu avx2 avx512f", None, ""),
        ("fpu avx2 avx512_bf16", "AVX2", ""),
        ("fpu avx2 avx512_bf16", "avx512_core_vnni", ""),
        ("fpu avx2 avx512_bf16", "DNNL_MAX_CPU_ISA=AVX2", ""),
        ("", None, ""),
    ],
)
def test_bfloat16_where_the_cpu_multiplies_it(fresh, tmp_path, monkeypatch, flags, limit, expected):
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text(f"processor : 0\nflags\t\t: {flags}\n" if flags else "Hardware : none\n")
    monkeypatch.setattr(device, "CPUINFO", cpuinfo)
    for variable in device.ISA_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    if limit:
        name, value = limit.split("=") if "=" in limit else (device.ISA_VARIABLES[0], limit)
        monkeypatch.setenv(name, value)
    assert " ".join(device.bfloat16_instructions()) == expected
    fastest = "bfloat16" if expected else "float32"
    assert choose_precision("auto", "cpu", "openvino") == fastest
    assert device.float_of_precision("int8") == fastest
    assert device.float_of_precision("float32") == "float32"
    assert choose_precision("float32", "cpu", "openvino") == "float32"
    if expected:
        assert choose_precision("bfloat16", "cpu", "openvino") == "bfloat16"
    else:
        with pytest.raises(UsageError) as caught:
            choose_precision("bfloat16", "cpu", "openvino")
        expected = ("precision", "float32 or int8")
        assert (caught.value.subject, caught.value.expected) == expected


@pytest.mark.parametrize(
    ("flags", "limit", "expected"),
    [
        ("avx512_bf16 amx_bf16 amx_int8", "", True),
        ("avx512_bf16 amx_bf16 amx_int8", "avx512_core_bf16", False),
        ("avx512_vnni avx512_bf16", "", False),
    ],
)
def test_tiles_of_bytes_where_the_cpu_multiplies_them(monkeypatch, flags, limit, expected):
    monkeypatch.setattr(device, "processor_flags", lambda: frozenset(flags.split()))
    for variable in device.ISA_VARIABLES:
        monkeypatch.setenv(variable, limit)
    assert device.multiplies_tiles_of_bytes() == expected


@pytest.mark.parametrize("capability", [(6, 1), (7, 0), (9, 0)])
def test_a_gpu_with_tensor_cores_takes_float16(monkeypatch, capability):
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    expected = "float16" if capability >= (7, 0) else "float32"
    assert choose_precision("auto", "cuda", "torch") == expected


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (set(), "int8"),
        ({"avx512_bf16"}, "int8 with bfloat16 and no tiles of bytes"),
        ({"amx_bf16", "amx_int8"}, "int8 with bfloat16 and tiles of bytes"),
    ],
)
def test_labels_in_int8_depend_on_the_cpu_and_others_do_not(monkeypatch, flags, expected):
    for variable in device.ISA_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(device, "processor_flags", lambda: flags)
    assert device.number_type_of_labels("int8") == expected
    assert device.number_type_of_labels("float32") == "float32"

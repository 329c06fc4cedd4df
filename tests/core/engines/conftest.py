# SPDX-License-Identifier: MIT
"""Properties of the machine that are asked for again."""

import pytest

from salsanext_cli.core.engines import device, openvino_runtime
from salsanext_cli.core.notices import warn_once


@pytest.fixture
def fresh():
    """Forget the properties of this machine, before and after."""
    caches = (device.processor_flags, openvino_runtime.openvino_failure, warn_once)
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()

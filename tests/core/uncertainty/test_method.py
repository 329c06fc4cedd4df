# SPDX-License-Identifier: MIT
"""A method of uncertainty has its kinds, which it estimates, and refuses impossible requests."""

import numpy as np
import pytest
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.uncertainty.method import (
    ALEATORIC_KINDS,
    ALEATORIC_METHODS,
    EPISTEMIC_KINDS,
    UncertaintyMethod,
)
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed


@pytest.mark.parametrize("aleatoric", ALEATORIC_METHODS)
def test_kinds_are_those_that_the_noise_allows(aleatoric):
    method = UncertaintyMethod(samples=2, aleatoric=aleatoric)
    expected = EPISTEMIC_KINDS if aleatoric == "none" else (*EPISTEMIC_KINDS, *ALEATORIC_KINDS)
    assert method.kinds == expected


def test_unknown_methods_and_a_single_sample_are_refused():
    refused(UsageError, "aleatoric", UncertaintyMethod, aleatoric="both")
    refused(UsageError, "samples", UncertaintyMethod, samples=1)


def test_the_masks_depend_on_seed_sequence_and_name(network, image):
    method = UncertaintyMethod(samples=2, aleatoric="none")

    def epistemic(seed, sequence, stem):
        estimate = method.estimate(network, image, scan_seed(seed, sequence, stem))
        return estimate.uncertainty.epistemic

    first = epistemic(0, "08", "000000")
    np.testing.assert_array_equal(first, epistemic(0, "08", "000000"))
    for other in ((0, "08", "000001"), (0, "09", "000000"), (1, "08", "000000")):
        assert (epistemic(*other) != first).any()

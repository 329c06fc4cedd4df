# SPDX-License-Identifier: MIT
"""Interruptions are found among the causes of other errors."""

import pytest

from salsanext_cli.core.interruptions import require_no_interruption


@pytest.mark.parametrize("link", ["__cause__", "__context__"])
def test_an_interruption_behind_other_errors_is_raised(link):
    error, cause = ImportError(), ValueError()
    setattr(error, link, cause)
    setattr(cause, link, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        require_no_interruption(error)


def test_errors_without_an_interruption_pass():
    error, cause = ImportError(), ValueError()
    error.__cause__ = cause
    require_no_interruption(error)
    cause.__context__ = error
    require_no_interruption(error)

# SPDX-License-Identifier: MIT
"""Without caches of the user, everything is made when it is needed."""

import pytest

from salsanext_cli.core.caches import Caches, use, used
from salsanext_cli.io.user_caches import UserCaches


@pytest.fixture
def caches():
    """Let this process use no caches as long as the test runs."""
    before = used()
    use(Caches())
    yield used()
    use(before)


def test_the_package_uses_the_caches_of_the_user():
    assert isinstance(used(), UserCaches)


def test_nothing_is_stored(caches):
    made = []

    def make() -> bytes:
        made.append(len(made))
        return b"content"

    assert [caches.cached("name", make) for _ in range(3)] == [b"content"] * 3
    assert made == [0, 1, 2]
    assert caches.store("name", b"other") == b"other"
    assert caches.cached("name", make) == b"content"

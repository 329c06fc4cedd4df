# SPDX-License-Identifier: MIT
"""Progress of the clouds of several bags, by the numbers that it shows."""

import pytest

from salsanext_cli.runs.copies.cloud_progress import CloudProgress


@pytest.fixture
def shown() -> list[tuple[int, int]]:
    return []


@pytest.fixture
def progress(shown) -> CloudProgress:
    return CloudProgress(total=5, show=lambda *numbers: shown.append(numbers))


def copy(progress: CloudProgress, copied: int, clouds: int, error: BaseException | None = None):
    with progress.attempt(clouds):
        for _ in range(copied):
            progress.add_cloud()
        if error:
            raise error


def test_clouds_of_all_bags_are_counted_once(progress, shown):
    progress.begin()
    copy(progress, 2, 2)
    copy(progress, 3, 3)
    assert shown == [(done, 5) for done in range(6)]


def test_a_failed_bag_was_attempted_as_a_whole(progress, shown):
    with pytest.raises(ValueError, match="damaged"):
        copy(progress, 1, 3, ValueError("damaged"))
    copy(progress, 2, 2)
    assert [done for done, _ in shown] == [1, 3, 4, 5]


def test_clouds_of_an_interrupted_bag_are_taken_back(progress, shown):
    copy(progress, 2, 2)
    with pytest.raises(KeyboardInterrupt):
        copy(progress, 2, 3, KeyboardInterrupt())
    assert [done for done, _ in shown] == [1, 2, 3, 4, 2]


def test_a_run_without_bags_to_copy_shows_nothing(shown):
    CloudProgress(total=0, show=lambda *numbers: shown.append(numbers)).begin()
    assert shown == []

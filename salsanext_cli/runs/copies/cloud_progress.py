# SPDX-License-Identifier: MIT
"""Progress of copies of bags, whose clouds have results only when their bag is complete."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from salsanext_cli.runs.loop.run_options import Progress


@dataclass(slots=True, kw_only=True)
class CloudProgress:
    """Number of the clouds that are copied, over all bags of a run."""

    total: int  # Number of the clouds of all bags
    show: Progress | None  # Shows the progress, if anything does
    clouds_of_bags: int = 0  # Clouds of the bags that were attempted
    clouds_of_copy: int = 0  # Clouds of the unfinished bag

    def begin(self) -> None:
        """Show that no cloud is copied yet."""
        self._show()

    def add_cloud(self) -> None:
        """Count a cloud of the unfinished bag."""
        self.clouds_of_copy += 1
        self._show()

    @contextmanager
    def attempt(self, clouds: int) -> Iterator[None]:
        """Count the clouds of a bag that the body copies.

        The clouds of a bag that fails count as attempted. If the body is interrupted, its clouds
        are taken back, since nothing of the bag remains.

        Parameters
        ----------
        clouds : int
            Number of the clouds of the bag.
        """
        try:
            yield
        except Exception:
            self._end_bag(clouds)
            raise
        except BaseException:
            self._end_bag(0)
            raise
        self._end_bag(clouds)

    def _end_bag(self, attempted: int) -> None:
        """Replace the count of clouds of the unfinished bag."""
        is_shown = self.clouds_of_copy == attempted
        self.clouds_of_bags += attempted
        self.clouds_of_copy = 0
        if not is_shown:
            self._show()

    def _show(self) -> None:
        if self.show and self.total:
            self.show(self.clouds_of_bags + self.clouds_of_copy, self.total)

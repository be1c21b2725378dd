# SPDX-License-Identifier: Apache-2.0
"""The states of a run, verified against the digest in its bag as they are read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from flock_sim.bag.reading.reader import Recorded
from flock_sim.errors import FlockError
from flock_sim.recording.row_digest import RowDigest, digest_of
from flock_sim.recording.run import Run


class VerifiedStates:
    """Reads messages as the bag of a run does. Call `check` when all were read."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._recorded = run.state_digest
        self._found: str | None = None  # the digest of the last pass over all states

    @property
    def path(self) -> Path:
        """The path of the bag."""
        return self._run.bag.path

    def messages(self, topics: list[str]) -> Iterator[Recorded]:
        """Yield the messages of `topics` in the order of the bag."""
        if self._recorded is None:
            yield from self._run.bag.messages(topics)
            return
        self._found = None
        digest = RowDigest(self._run.configuration)
        yield from digest.watch(self._run.bag.messages(topics))
        if set(digest.topics) <= set(topics):
            self._found = digest.text

    def check(self) -> None:
        """Raise FlockError if the bag has a digest, and its states have another one.

        The states are read again if no pass over all of them was finished.
        """
        if self._recorded is None:
            return
        found = self._found or digest_of(self._run.bag, self._run.configuration).text
        if found != self._recorded:
            raise FlockError(
                f"{self.path} is damaged, or was changed after its recording: the digest of its "
                f"states is {found or 'missing'}, but it was recorded as {self._recorded}; take "
                "another copy of the bag"
            )

# SPDX-License-Identifier: Apache-2.0
"""A bag on the disk while it is written: how it begins, continues, grows and is completed."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from mcap.records import Metadata

from flock_sim.bag.chunk import SealedChunk
from flock_sim.bag.directory import (
    METADATA_FILE,
    NEW_FILE,
    PART_FILE,
    RESERVE_FILE,
    bag_files,
    is_recording,
)
from flock_sim.bag.file_sections import Layout, Written, pack
from flock_sim.bag.metadata import metadata_yaml
from flock_sim.bag.writing.partial_bag import PartialBag, recorded_in
from flock_sim.bag.writing.put_aside import put_aside
from flock_sim.bag.writing.storage import AppendFile, LostError, Reserve
from flock_sim.errors import FlockError, RunFailed, remedy

_SLACK = 32 * 1024  # bytes, for the file system's own blocks and for counts that grow longer


class BagOnDisk:
    """The directory of a bag: its file of chunks, reserved space, and metadata.yaml at the end.

    `path` is its file; `begun` has the whole chunks of a resumed bag, and is None for a new one;
    `aside` is the damaged file that was kept under another name; `written` counts what is on disk.
    `replaces`: another bag is in the directory, and stays until `take_place`.
    """

    def __init__(
        self,
        directory: Path,
        layout: Layout,
        custom_data: Mapping[str, str],
        *,
        resume: bool,
        replace: bool,
    ) -> None:
        """Begin or resume a bag of `layout`; arguments and errors are those of `BagWriter`."""
        self.directory = directory
        self.begun: PartialBag | None = None
        self.aside: Path | None = None
        self.replaces = False
        self.written = Written()
        self._layout, self._custom_data = layout, custom_data
        self._lost = False
        self.path = self._place = directory / f"{directory.resolve().name}_0.mcap"
        self._reserve = Reserve(directory / RESERVE_FILE)
        self._reserved = len(layout.head) + len(self._metadata_text()) + _SLACK
        existing = recorded_in(directory) if resume else None
        if existing is None:
            self._begin(replace)
        else:
            self.path = existing
            self.replaces = existing.name == NEW_FILE
            self._go_on()

    @property
    def size(self) -> int:
        """The size of the file, in bytes."""
        return self._file.size

    def append(self, chunk: SealedChunk) -> None:
        """Append a chunk, completely or not at all; raises RunFailed."""
        self._append(chunk.record, chunk.summary.index)
        self.written.add(chunk.summary)

    def append_metadata(self, record: Metadata) -> None:
        """Append a metadata record as `append` does a chunk."""
        offset = self.size
        self._append(pack(record))
        self.written.add_metadata(record, offset, self.size - offset)

    def _append(self, block: bytes, index: bytes = b"") -> None:
        try:
            self._file.check()
            self._reserve.hold(self._reserved + len(self.written.chunk_index) + len(index))
            self._file.append(block)
        except LostError as error:
            raise self._lose(error) from error
        except OSError as error:
            raise self._failed(error) from error

    def check(self) -> None:
        """Raise RunFailed if the file was removed or changed, once, or if it can't be read."""
        if not self._lost:
            try:
                self._file.check()
            except LostError as error:
                raise self._lose(error) from error
            except OSError as error:
                raise self._failed(error) from error

    def cut_back(self, chunks: int, *, keep_aside: bool) -> None:
        """Keep only the first `chunks` chunks of a resumed bag, as `BagWriter.cut_back` does."""
        if self.begun is None:
            raise ValueError("the bag is new: there is nothing to cut back")
        try:
            kept = self.begun.keep(chunks)
            if keep_aside:
                self._put_aside(kept.size)
            self._file.cut(kept.size, kept.crc)
        except OSError as error:
            raise self._unusable(error) from error
        self.written = kept.written

    def take_place(self) -> None:
        """Remove the bag that this one replaces, and take its place; raises RunFailed."""
        if not self.replaces:
            return
        place = self._place
        try:
            entries = bag_files(self.directory)
            old = [entry for entry in entries if is_recording(entry.name)]
            kept = (*old[:1], self.path, self._reserve.path)
            for entry in entries:
                if entry not in kept:
                    entry.unlink()
            # The old file gets the name first, so that a kill at any time leaves one of the two.
            if old and old[0] != place:
                old[0].replace(place)
            self.path.replace(place)
        except OSError as error:
            raise RunFailed(
                f"the bag in {self.directory} can't be replaced ({error.strerror}): name another"
                " directory"
            ) from error
        self.replaces = False
        self.path = self._file.path = place

    def remove(self) -> None:
        """Remove the bag; a bag that it was to replace stays."""
        with suppress(OSError):
            if not self._lost:
                self.path.unlink()
        self.replaces = False
        self._close()

    def let_go(self) -> None:
        """Close the file as it is, so that the bag can be resumed. Raises RunFailed."""
        self._reserve.free()
        try:
            self._file.close()
        except OSError as error:
            raise RunFailed(
                f"recording to {self.path} failed ({error.strerror}): its last messages may be"
                f" lost; {remedy(error)} and fly again"
            ) from error

    def _close(self) -> None:
        """Close the file. Whether its content is stored does not matter, or is known already."""
        self._reserve.free()
        with suppress(OSError):
            self._file.close()

    def complete(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write `metadata` and the summary, and then metadata.yaml; raises RunFailed.

        A file that is lost is only closed. A bag without chunks does not replace another one.
        """
        if self._lost:
            return self._close()
        if self.replaces and not self.written.chunks:
            return self.remove()
        part = self.directory / PART_FILE
        try:
            self.take_place()
            self._file.check(thorough=True)
            self._reserve.free()
            self._file.append(self._layout.tail(self.written, self.size, self._file.crc, metadata))
            self._file.sync()
            # Atomically, and after everything else is on the disk: its presence says so.
            with part.open("w", encoding="utf-8") as file:
                file.write(self._metadata_text())
                file.flush()
                os.fsync(file.fileno())
            part.replace(self.directory / METADATA_FILE)
        except LostError as error:
            raise self._lose(error) from error
        except OSError as error:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise RunFailed(
                f"the bag {self.directory} can't be completed ({error.strerror}):"
                f" its {self.written.messages} messages are safe"
            ) from error
        finally:
            self._close()

    def _begin(self, replace: bool) -> None:
        made = False
        try:
            made = not self.directory.exists()
            self.directory.mkdir(parents=True, exist_ok=True)
            if any(self.directory.iterdir()):
                if not replace:
                    raise FlockError(
                        f"output {self.directory} is not empty: name another directory"
                    )
                self.replaces = True
                self.path = self.directory / NEW_FILE
            self._file = AppendFile(self.path)
        except OSError as error:
            self._unmake(made)
            raise self._unusable(error) from error
        try:
            self._reserve.hold(self._reserved)
            self._file.append(self._layout.head)
        except OSError as error:
            self._close()
            with suppress(OSError):
                self.path.unlink()
            self._unmake(made)
            raise RunFailed(
                f"the bag {self.directory} can't be created ({error.strerror}):"
                f" {remedy(error)} and try again"
            ) from error

    def _unmake(self, made: bool) -> None:
        """Remove the directory if this bag has made it, and it is empty."""
        if made:
            with suppress(OSError):
                self.directory.rmdir()

    def _go_on(self) -> None:
        try:
            self._file = AppendFile(self.path, existing=True)
            try:
                self._take_up()
            except (OSError, FlockError):
                self._close()
                raise
        except OSError as error:
            raise self._unusable(error) from error

    def _take_up(self) -> None:
        """Cut off data that is not whole, after checks that the bag can be resumed."""
        begun = PartialBag(self._file.fd, self.path, self._layout.head)
        kept = begun.keep(len(begun.chunks))
        if begun.damage is not None:
            self._put_aside(kept.size)
            begun.fd = self._file.fd
        try:
            self._reserve.hold(self._reserved + len(kept.written.chunk_index))
        except OSError as error:
            raise RunFailed(
                f"the bag {self.directory} can't be continued ({error.strerror}):"
                f" {remedy(error)} and try again"
            ) from error
        # metadata.yaml first: its presence says that the bag is complete.
        if not self.replaces:
            for name in (METADATA_FILE, PART_FILE):
                (self.directory / name).unlink(missing_ok=True)
        if begun.has_head:
            self._file.cut(kept.size, kept.crc)
        else:
            self._file.cut(0, 0)
            self._file.append(self._layout.head)
        self.written = kept.written
        self.begun = begun

    def _put_aside(self, size: int) -> None:
        """Keep the file unchanged under another name, and continue with a copy of `size` bytes."""
        try:
            file, self.aside = put_aside(self._file, size)
        except OSError as error:
            raise RunFailed(
                f"{self.path} is damaged, and its undamaged part can't be copied"
                f" ({error.strerror}): {remedy(error)} and try again"
            ) from error
        with suppress(OSError):
            self._file.close()
        self._file = file
        if self.begun is not None:
            self.begun.fd = file.fd

    def _lose(self, error: LostError) -> RunFailed:
        """Never touch the file again, which was removed or changed; return the failure."""
        self._lost = True
        return RunFailed(
            f"recording to {self.path} failed: {error.strerror}; nothing more is recorded: make"
            " sure that no other program changes the bag of a flight, and fly again"
        )

    def _failed(self, error: OSError) -> RunFailed:
        return RunFailed(
            f"recording to {self.path} failed ({error.strerror}): the {self.written.messages}"
            f" messages recorded before are safe; {remedy(error)} and fly again"
        )

    def _unusable(self, error: OSError) -> FlockError:
        return FlockError(
            f"output {self.directory} can't be written ({error.strerror}): name another directory"
        )

    def _metadata_text(self) -> str:
        return metadata_yaml(self.path.name, self._layout, self.written, self._custom_data)

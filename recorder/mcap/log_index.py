"""The index of a whole log, read as far as it is needed: pictures are listed at the log's end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recorder.mcap.mcap_file import Chunk, McapFile
from recorder.mcap.message_index import Track, index_messages
from recorder.mcap.picture_places import CHUNKS_ATTACHMENT, is_of_pictures, read_places
from recorder.mcap.scan import Structure


class LogIndex:
    """An ENTRY for each message of a log. Raises LogError for a damaged log when it is read."""

    def __init__(
        self, file: McapFile, structure: Structure, track: Track, have_read: Callable[[Sequence[Chunk]], object]
    ) -> None:
        """`have_read` gets chunks when they were read: their CRCs match."""
        self._file = file
        self._structure = structure
        self._track = track
        self._have_read = have_read
        self._images = structure.image_channels
        self._lists_pictures = False

    def of_topic(self, topic: str) -> NDArray[np.void]:
        channels = {number for number, channel in self._structure.channels.items() if channel.topic == topic}
        needs_pictures = channels & self._images or not self._is_whole_beside_pictures
        index = self.all if needs_pictures else self._beside_pictures
        return index[np.isin(index["channel"], list(channels))]

    @cached_property
    def all(self) -> NDArray[np.void]:
        places = read_places(self._file, self._structure) if self._file.is_ours else None
        self._lists_pictures = places is not None
        if places is not None:
            return np.concatenate([self._beside_pictures, places])
        chunks = self._structure.chunks
        return self._beside_pictures if len(self._other_chunks) == len(chunks) else self._index_of(chunks)

    @property
    def is_mixed(self) -> bool:
        """True if other messages cannot be read without pictures, because the pictures' places are not listed."""
        return len(self.all) > 0 and len(self._images) > 0 and not self._lists_pictures

    @cached_property
    def _other_chunks(self) -> list[Chunk]:
        return [chunk for chunk in self._structure.chunks if not is_of_pictures(chunk, self._images)]

    @cached_property
    def _beside_pictures(self) -> NDArray[np.void]:
        return self._index_of(self._other_chunks)

    @cached_property
    def _is_whole_beside_pictures(self) -> bool:
        """True if all other messages are found without the chunks of pictures. A wrong summary may hide some in
        them."""
        if not self._file.is_ours or CHUNKS_ATTACHMENT not in self._structure.attachment_names.values():
            return False
        statistics = self._structure.statistics
        counts = {} if statistics is None else statistics.channel_message_counts
        count = sum(count for number, count in counts.items() if number not in self._images)
        return len(self._beside_pictures) == count

    def _index_of(self, chunks: Sequence[Chunk]) -> NDArray[np.void]:
        index = index_messages(self._file, self._structure, chunks, self._track)
        self._have_read(chunks)
        return index

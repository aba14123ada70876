"""Checking the lists of chunks and pictures at a log's end, by which it is read, against the chunks themselves."""

from __future__ import annotations

import numpy as np

from recorder.errors import LogError
from recorder.mcap.mcap_file import CHUNK_HEADER, Chunk, McapFile
from recorder.mcap.picture_places import (
    CHUNKS_ATTACHMENT,
    PICTURES_ATTACHMENT,
    is_about_places,
    places_in,
    read_chunk_crcs,
    read_places,
    stored_places,
)
from recorder.mcap.scan import Structure
from recorder.upkeep.check_contents import Finding


class PlacesCheck:
    """Compares each chunk with the summary's entry for it, and with the lists of chunks and pictures.

    Logs of earlier versions have no such lists, and other programs' are not read by them.
    """

    def __init__(self, file: McapFile, structure: Structure, findings: list[Finding]) -> None:
        self._findings = findings
        self._images = structure.image_channels
        self._numbers = {chunk.start: number for number, chunk in enumerate(structure.chunks)}
        self._crcs, self._places = None, None
        names = structure.attachment_names
        for at, name in sorted(names.items()):
            try:
                file.attachment(at)
            except LogError:
                findings.append(Finding("damaged attachments", f"{name} at byte {at:,}"))
        if not file.is_ours or not any(map(is_about_places, names.values())):
            return
        self._crcs = read_chunk_crcs(file, structure)
        if self._crcs is None:
            findings.append(Finding("lists that are not about this file", CHUNKS_ATTACHMENT))
        elif (places := stored_places(file, structure)) is None or read_places(file, structure) is None:
            findings.append(Finding("lists that are not about this file", PICTURES_ATTACHMENT))
        else:
            self._places = places
            # at once: for each chunk alone, NumPy would copy the whole column
            self._edges = np.searchsorted(places["chunk"], np.arange(len(self._crcs) + 1)).tolist()

    def add(self, indexed: Chunk, record: bytes, channels: set[int]) -> None:
        """Check a sound chunk: its entry in the summary, its record, and the channels of its messages."""
        where = f"at byte {indexed.start:,}"
        if indexed.channels is not None and indexed.channels != channels:
            self._findings.append(Finding("chunks of other topics than the summary says", where))
        if indexed.head and indexed.head != record[: len(indexed.head)]:
            self._findings.append(Finding("chunks of other times or sizes than the summary says", where))
        number = self._numbers.get(indexed.start)
        if number is None or self._crcs is None:
            return
        *_, crc = CHUNK_HEADER.unpack_from(record)
        if self._crcs[number] != crc:
            self._findings.append(Finding("chunks of other CRCs than are listed", where))
        if self._places is None or indexed.compression:
            return
        first, end = self._edges[number : number + 2]
        if self._places[first:end].tobytes() != places_in(record, number, self._images):
            self._findings.append(Finding("chunks of other pictures than are listed", where))

"""Checking a log: that its file is sound, and that what it holds makes sense."""

from __future__ import annotations

import contextlib
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from common.location import Location
from common.progress import track
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.log.road_places import states_of
from recorder.log.tagged_rows import TaggedRows, fine_rows
from recorder.log.tags import EXCLUDE, read_tags
from recorder.mcap.mcap_file import McapFile
from recorder.mcap.scan import read_structure
from recorder.rows.odd_stretches import OddStretch, odd_stretches
from recorder.rows.row_quality import States
from recorder.rows.steering_habits import LagFinding
from recorder.topics import POSE, VEHICLE, camera_topic
from recorder.upkeep.check_contents import GAPS, Contents, Finding, odd_findings
from recorder.upkeep.check_structure import sound_chunks
from recorder.upkeep.log_info import find_lag


def is_whole(path: Location) -> bool:
    """True for a file that is finished, and sound in every byte. Raises LogError if it is no MCAP file."""
    findings: list[Finding] = []
    with McapFile(path) as file:
        structure = read_structure(file)
        if structure.problem:
            return False
        chunks = sound_chunks(file, structure, findings)
        for _ in track(chunks, f"checking {path.name}", len(structure.chunks)):
            if findings:
                break
    return not findings


@dataclass(frozen=True)
class Checked:
    """The result of a check: how much was read, and the findings."""

    path: Location
    messages: int
    pictures: int  # decoded
    findings: list[Finding]
    is_damaged: bool  # the file itself, whatever it holds
    has_crcs: bool  # other programs may do without: damage is then not noticed
    meant_gaps: list[str]  # gaps in time that its events explain; no findings
    pauses: list[str]  # of a recorder that people switch off and on; no findings
    lag: LagFinding | None  # of the steering, known or measured; None: not looked for
    is_lag_kept: bool  # in the log or beside it
    odd: list[OddStretch]  # not tagged fine; also those that may be meant and are no findings


def check(path: Location, *, look: bool = True) -> Checked:
    """Read the whole log at `path` and report what is wrong with it; `look` decodes every picture.

    Structure: every CRC, the indexes and counts against what is there. Meaning: rows out of order, pictures that
    do not decode, frozen ones, rows without a picture and pictures without a row, gaps, stuck steering, values out
    of range; with `look`, of a log on this machine, also steering that contradicts the pictures. With `look`, the
    steering's lag is measured and kept beside the log, if it was not known. Raises LogError if it is no MCAP file.
    """
    damage: list[Finding] = []
    findings: list[Finding] = []
    fine = fine_rows(path)
    with McapFile(path) as file:
        structure = read_structure(file)
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            contents = Contents(structure, findings, pool if look else None, is_ours=file.is_ours, fine=fine)
            chunks = sound_chunks(file, structure, damage)
            for records, messages in track(chunks, f"checking {path.name}", len(structure.chunks)):
                for message in messages:
                    contents.add(records, message)
            contents.finish()
        has_crcs = file.have_crcs(structure.chunks)
    has_rows = contents.counts[VEHICLE] and contents.counts[camera_topic("center")]
    odd = contents.odd
    lag, is_lag_kept = None, False
    excluded = TaggedRows(())
    is_paused_by_people = False
    with contextlib.suppress(LogError), Log(path) as log:
        # from a recorder that people switch off and on: a gap is then no loss
        is_paused_by_people = log.metadata.get("source") in ("udacity", "donkeycar", "csv")
        excluded = TaggedRows(read_tags(path, log.fingerprint), EXCLUDE)
        if contents.counts[POSE]:
            odd = odd_stretches(states_of(log))
        if look and has_rows:
            lag, is_lag_kept = find_lag(log)
        if look and has_rows and isinstance(path, Path):
            from recorder.seen.shown_stretches import with_pictures  # OpenCV
            from recorder.upkeep.swapped_cameras import are_swapped

            odd = with_pictures(log, States.of(log.vehicle()), odd)
            if are_swapped(log):
                left_out = "`bc-index --cameras center` leaves them out"
                findings.append(Finding("side cameras that are swapped", f"left and right; {left_out}"))
    odd = fine.left(odd)
    findings += odd_findings(excluded.left(odd))
    pauses = [finding for finding in findings if finding.kind == GAPS and is_paused_by_people]
    return Checked(
        path,
        sum(contents.counts.values()),
        contents.pictures,
        damage + [finding for finding in findings if finding not in pauses],
        bool(damage),
        has_crcs,
        contents.meant_gaps,
        [finding.where for finding in pauses],
        lag,
        is_lag_kept,
        odd,
    )

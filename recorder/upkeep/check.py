"""Checks a log: its file and its contents."""

from __future__ import annotations

import contextlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from common.location import Location
from common.process_settings import usable_cores
from common.progress import track
from recorder.errors import LogError
from recorder.log.known_lag import find_lag
from recorder.log.reader import Log
from recorder.log.road_places import states_of
from recorder.log.tags import EXCLUDE, TaggedRows, fine_rows, read_tags
from recorder.mcap.mcap_file import McapFile
from recorder.mcap.scan import read_structure
from recorder.rows.label_plan import wrong_timing
from recorder.rows.odd_stretches import OddStretch, odd_stretches
from recorder.rows.steering_habits import LagFinding
from recorder.topics import POSE, VEHICLE, camera_topic
from recorder.upkeep.check_contents import GAPS, Contents, Finding, odd_findings
from recorder.upkeep.check_structure import sound_chunks


def is_whole(path: Location) -> bool:
    """True for a finished file with every byte sound. Raises LogError for other files than MCAP's."""
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
    path: Location
    messages: int
    pictures: int  # decoded
    findings: list[Finding]
    is_damaged: bool  # the file itself
    has_crcs: bool  # other programs may write none: then damage is not noticed
    meant_gaps: list[str]  # gaps in time that its events explain; not findings
    pauses: list[str]  # of a recorder that people switch off and on; not findings
    set_back: list[str]  # jumps back in time; of such a recorder, not findings
    lag: LagFinding | None  # of the steering, known or measured; None: not measured
    odd: list[OddStretch]  # without those tagged fine; including unsure ones, which are not findings


def check(path: Location, *, look: bool = True) -> Checked:
    """Read the whole log at `path` and report its faults. `look` decodes every picture.

    File: every CRC, the indexes and the counts. Contents: rows out of order, broken and frozen pictures, rows
    without a picture and pictures without a row, gaps, stuck steering, values out of range. With `look`, also the
    steering's lag, which is kept next to the log, and, for a log on this machine, swapped side cameras and
    steering that contradicts the pictures. Raises LogError for other files than MCAP's.
    """
    damage: list[Finding] = []
    findings: list[Finding] = []
    fine = fine_rows(path)
    with McapFile(path) as file:
        structure = read_structure(file)
        with ThreadPoolExecutor(usable_cores()) as pool:
            contents = Contents(structure, findings, pool if look else None, path, is_ours=file.is_ours, fine=fine)
            chunks = sound_chunks(file, structure, damage)
            for records, messages in track(chunks, f"checking {path.name}", len(structure.chunks)):
                for message in messages:
                    contents.add(records, message)
            contents.finish()
        has_crcs = file.have_crcs(structure.chunks)
    has_rows = contents.counts[VEHICLE] and contents.counts[camera_topic("center")]
    odd = contents.odd
    lag = None
    excluded = TaggedRows(())
    is_paused_by_people = False
    with contextlib.suppress(LogError), Log(path) as log:
        # people switch these recorders off and on: a gap is not a loss
        is_paused_by_people = log.metadata.get("source") in ("udacity", "donkeycar", "csv")
        excluded = TaggedRows(read_tags(path, log.fingerprint), EXCLUDE)
        states = states_of(log) if contents.counts[POSE] else None
        if states is not None:
            odd = odd_stretches(states)
        if look and has_rows:
            lag = find_lag(log)
        shown = None if lag is None else lag.lag
        if look and has_rows and isinstance(path, Path):
            from recorder.log.known_lag import measure_lag
            from recorder.seen.picture_stretches import with_pictures  # OpenCV
            from recorder.upkeep.swapped_cameras import same_pictures, swapped_cameras

            if states is None:
                states = states_of(log)
            odd = with_pictures(log, states, odd)
            if shown is None:  # labels need none, or an earlier version tried fewer lags
                shown = measure_lag(log, states)
                lag = lag and LagFinding(shown)
            for pair in (same := same_pictures(log)):
                copies = "`bc-index --cameras center` leaves the copies out"
                findings.append(Finding("cameras with the same pictures", f"{pair}; {copies}"))
            if (swapped := "" if same else swapped_cameras(log)) == "left and right":
                left_out = "`bc-index --cameras center` leaves them out"
                findings.append(Finding("side cameras that are swapped", f"{swapped}; {left_out}"))
            elif swapped:
                findings.append(Finding("cameras that are swapped", f"{swapped}; import the recording again"))
        if shown is not None and shown.is_mirrored:
            findings.append(Finding("sessions whose pictures turn the other way", "all rows; is left right?"))
        if shown is not None and (timing := wrong_timing(shown)):
            findings.append(Finding("sessions whose steering is late or early", f"all rows; {timing}"))
    odd = fine.untagged(odd)
    findings += odd_findings(excluded.untagged(odd))
    pauses = [finding for finding in findings if finding.kind == GAPS and is_paused_by_people]
    return Checked(
        path,
        sum(contents.counts.values()),
        contents.pictures,
        damage + [finding for finding in findings if finding not in pauses],
        bool(damage),
        has_crcs,
        contents.meant_gaps,
        [finding.where for finding in pauses if finding.where not in contents.set_back],
        contents.set_back,
        lag,
        odd,
    )

"""Does a person's drive teach a network? Scripted players stand in for people, in Chromium, at the page Drive.

python studies/players.py FOLDER [--only "devices *"] [--list]

Devices: players record half a lap of the lake and of the mountain by keys, mouse and gamepad. A network of each
pair of recordings drives full laps of both tracks and of three unseen roads. Supervision: a beginner is trained on
a fifth of a lap of the mountain. In two rounds, a player supervises it, each on a road on which it is not
measured; each round is followed by `bc-train continue RUN --takeovers LOG`. For comparison, another network is
trained on the beginner's recording and on as many minutes of recording on these roads. All train as the page's
button does.

The players know only what the page shows (scripted_player.py). Each step leaves a file in FOLDER/results and is
not repeated, so the program can be stopped and started at any time. The steps in studies/players.json were made on
another machine.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any, Final

from drive_page import DrivePage, chromium, running, wheel_of, workbench
from printed_table import print_head, print_row
from scripted_player import DEVICES, Device, Player, Supervisor
from toolkit_command import output_of

from recorder import Log
from recorder.bc_pb2 import PilotCommand
from web.jobs.wheels import EPOCHS_MORE, TAKEOVERS_RECIPE

RECORDED: Final = ("lake", "mountain")
DRIVEN: Final = ("lake", "mountain", "random:1", "random:2", "random:3")
BEGINNERS: Final = "mountain"
SUPERVISORS: Final[Device] = "gamepad"
SUPERVISED: Final = ("random:6", "random:7")
"""One road for each round. The mountain is not used: the first beginner learnt a fifth of it, and never erred on
it."""
BEGINNERS_DRIVEN: Final = ("mountain", *(f"random:{seed}" for seed in range(1, 6)))
KINDS: Final = {"record": 150.0, "supervise": 330.0, "train": 180.0, "eval": 60.0}
"""Kinds of steps, with the estimated seconds of a step before one has been made."""
MPH: Final = 10.0
MINUTES: Final = 5.0
MADE: Final = Path(__file__).with_suffix(".json")

Result = dict[str, Any]


@dataclass(frozen=True)
class Step:
    """A step that is made once. `needs` are the steps that must come before it."""

    name: str
    kind: str
    act: Callable[[], Result]
    needs: tuple[str, ...] = ()


class Study:
    """The steps of both studies in a folder."""

    def __init__(self, folder: Path, asked: argparse.Namespace) -> None:
        self.folder = folder
        self.asked = asked
        self._made: dict[str, Result] = json.loads(MADE.read_text()) if MADE.exists() else {}

    def steps(self) -> Iterator[Step]:
        for seed in self.asked.seeds:
            for device in self.asked.devices:
                yield from self._device(device, seed)
        for seed in self.asked.seeds:
            yield from self._supervision(seed)

    def result(self, name: str) -> Result | None:
        path = self._path(name)
        return json.loads(path.read_text()) if path.exists() else self._made.get(name)

    def keep(self, name: str, result: Result) -> None:
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_suffix(".part").write_text(json.dumps(result, indent=1))
        path.with_suffix(".part").replace(path)

    def _path(self, name: str) -> Path:
        return self.folder / "results" / f"{name.replace(' ', '_').replace(':', '')}.json"

    def _device(self, device: Device, seed: int) -> Iterator[Step]:
        run = f"{device}-{seed}"
        sessions = [f"{run}-{track}" for track in RECORDED]
        recordings = tuple(f"devices {run} record {track}" for track in RECORDED)
        for name, session, track in zip(recordings, sessions, RECORDED, strict=True):
            yield Step(name, "record", partial(self._record, session, track, device, seed, laps=self.asked.laps))
        yield self._train_step(f"devices {run} train", run, ["--on", *sessions], seed, recordings)
        yield from self._evals(f"devices {run}", run, DRIVEN, f"devices {run} train")

    def _supervision(self, seed: int) -> Iterator[Step]:
        start, device = supervision(self.asked, seed), SUPERVISORS
        beginner = f"beginner-{seed}"
        share = 0.4 * self.asked.laps  # a fifth of a lap
        first = Step(
            f"{start} record", "record", partial(self._record, beginner, BEGINNERS, device, seed, laps=share)
        )
        yield first
        train = self._train_step(f"{start} train", beginner, ["--on", beginner], seed, (first.name,))
        yield train
        yield from self._evals(f"{start} before", beginner, BEGINNERS_DRIVEN, train.name)
        supervised, run, before = [], beginner, train.name
        for turn, road in enumerate(SUPERVISED, 1):
            log = f"drives/supervised{turn}-{seed}.mcap"
            name, new_run = f"{start} supervise {turn}", f"supervised{turn}-{seed}"
            yield Step(
                name,
                "supervise",
                partial(self._supervise, run, road, log, device, 10 * seed + turn),
                (before,),
            )
            words = ["continue", run, "--takeovers", log]
            supervised.append(name)
            learn = self._train_step(f"{start} learn {turn}", new_run, words, seed, (name,))
            yield learn
            run, before = new_run, learn.name
        yield from self._evals(f"{start} after", run, BEGINNERS_DRIVEN, before)
        more = [f"more{turn}-{seed}" for turn in (1, 2)]
        for turn, (session, name, road) in enumerate(zip(more, supervised, SUPERVISED, strict=True), 1):
            yield Step(
                f"{start} more {turn}",
                "record",
                partial(self._more, session, road, name, device, 10 * seed + turn),
                (name,),
            )
        train = self._train_step(
            f"{start} more train",
            f"more-{seed}",
            ["--on", beginner, *more],
            seed,
            (first.name, *(f"{start} more {turn}" for turn in (1, 2))),
        )
        yield train
        yield from self._evals(f"{start} more", f"more-{seed}", BEGINNERS_DRIVEN, train.name)

    def _train_step(self, name: str, run: str, words: list[str], seed: int, needs: tuple[str, ...]) -> Step:
        return Step(name, "train", partial(self._train, run, words, seed, needs), needs)

    def _evals(self, name: str, run: str, tracks: tuple[str, ...], needs: str) -> Iterator[Step]:
        for track in tracks:
            yield Step(f"{name} eval {track}", "eval", partial(self._eval, run, track), (needs,))

    def _record(
        self, session: str, track: str, device: Device, seed: int, *, laps: float | None = None, seconds: float = 0
    ) -> Result:
        """Drive `laps` laps, or without them `seconds` seconds by this computer's clock."""
        length = ["--laps", f"{laps:g}"] if laps else []
        words = ("me", session, "--no-page", "--force", "--track", track, *length)
        with (
            workbench(self.folder) as (_, address),
            running(self.folder, "bc-record", *words) as drive,
            chromium() as browser,
        ):
            page = DrivePage(browser, address, wheel_of(self.folder, drive))
            player = Player(page, device, seed, MPH)
            page.record()
            begin_s, paces, aside = time.monotonic(), [], []
            while not player.seen.is_ended and (laps or time.monotonic() < begin_s + seconds):
                sight = player.step()
                paces.append(player.seen.pace)
                aside.append(sight.aside)
            player.hands.let_go()
            page.end()
            seen = page.see()
        return {
            "rows": seen.rows,
            "put back": seen.put_back,
            "pace": round(statistics.mean(paces), 3),
            "mean aside": round(statistics.mean(aside), 3),
            "drive_s": round(time.monotonic() - begin_s, 1),
        }

    def _more(self, session: str, road: str, supervised: str, device: Device, seed: int) -> Result:
        """Record for the same time as a supervised drive took."""
        result = self.result(supervised)
        assert result is not None  # noqa: S101  # `needs` of this step
        return self._record(session, road, device, seed, seconds=result["drive_s"])

    def _supervise(self, run: str, road: str, log: str, device: Device, seed: int) -> Result:
        words = ["--simulator", road, "--laps", "100", "--takeover", "me", "--no-page", "--viewer", "off"]
        with (
            workbench(self.folder) as (_, address),
            running(self.folder, "bc-drive", run, *words, "--log", log, "--force") as drive,
            chromium() as browser,
        ):
            page = DrivePage(browser, address, wheel_of(self.folder, drive))
            player = Player(page, device, seed, MPH)
            supervisor = Supervisor(page, player)
            begin_s, paces = time.monotonic(), []
            while not player.seen.is_ended and time.monotonic() < begin_s + 60 * self.asked.minutes:
                supervisor.step()
                paces.append(player.seen.pace)
            drive_s, seen = time.monotonic() - begin_s, player.seen
            player.hands.let_go()
            page.end()
        with Log(self.folder / log) as opened:
            drivers = [command.driver for _, command in opened.commands()]
        return {
            "takeovers": seen.takeovers,
            "put back": seen.put_back,
            "laps": seen.laps,
            "rows": len(drivers),
            "rows by the player": drivers.count(PilotCommand.HUMAN),
            "pace": round(statistics.mean(paces), 3),
            "drive_s": round(drive_s, 1),
        }

    def _train(self, run: str, words: list[str], seed: int, recordings: tuple[str, ...]) -> Result:
        """Train as the page's button does."""
        how = ("--recipe", TAKEOVERS_RECIPE, "--epochs", EPOCHS_MORE) if "--takeovers" in words else ()
        self._make_way(run)
        printed = output_of(self.folder, "bc-train", *words, *how, "--name", run, "--seed", seed)
        return {"printed": printed[-2000:]}

    def _make_way(self, run: str) -> None:
        """Move away the run and the index of a killed training."""
        for leftover in (self.folder / "runs" / run, self.folder / f"index-{run}"):
            if leftover.exists():
                leftover.rename(leftover.with_name(f"{leftover.name}.left-{time.time_ns()}"))

    def _eval(self, run: str, track: str) -> Result:
        words = ("--tracks", track, "--laps", f"{self.asked.eval_laps:g}", "--json", "--force")
        return dict(json.loads(output_of(self.folder, "bc-eval", "drive", run, *words)))


def make(study: Study, steps: list[Step]) -> int:
    """Make the missing steps. Returns the number of steps that failed or wait for others."""
    missing = [step for step in steps if study.result(step.name) is None]
    undone = 0
    for number, step in enumerate(missing):
        if any(study.result(name) is None for name in step.needs):
            print(f"{step.name}: waits for {', '.join(step.needs)}", file=sys.stderr)
            undone += 1
            continue
        left_s = sum(seconds_of(study, later.kind) for later in missing[number:])
        print(f"{step.name} ({len(missing) - number} left, about {left_s / 60:.0f} min)", file=sys.stderr)
        begin_s = time.monotonic()
        try:
            result = step.act()
        except Exception as error:  # other steps may succeed
            print(f"{step.name}: {type(error).__name__}: {error}", file=sys.stderr)
            undone += 1
            continue
        study.keep(step.name, {"kind": step.kind, "took_s": round(time.monotonic() - begin_s, 1), **result})
    return undone


def seconds_of(study: Study, kind: str) -> float:
    """The mean seconds of the steps of a kind that were made, else an estimate."""
    took = [
        result["took_s"]
        for path in (study.folder / "results").glob("*.json")
        if (result := json.loads(path.read_text())).get("kind") == kind
    ]
    return statistics.mean(took) if took else KINDS[kind]


def interventions(study: Study, name: str, tracks: tuple[str, ...]) -> list[int | None]:
    results = [study.result(f"{name} eval {track}") for track in tracks]
    return [None if result is None else int(result["interventions"]) for result in results]


def print_tables(study: Study) -> None:
    asked = study.asked
    print()
    print_head("device", "seed", "rows", "put back", *DRIVEN)
    for device in asked.devices:
        for seed in asked.seeds:
            name = f"devices {device}-{seed}"
            recorded = [study.result(f"{name} record {track}") for track in RECORDED]
            rows, put_back = (
                total([None if result is None else int(result[what]) for result in recorded])
                for what in ("rows", "put back")
            )
            print_row(device, seed, rows, put_back, *interventions(study, name, DRIVEN))
    print()
    print_head("seed", "network", "takeovers", *BEGINNERS_DRIVEN, "all")
    for seed in asked.seeds:
        start = supervision(asked, seed)
        rounds = [study.result(f"{start} supervise {turn}") for turn in (1, 2)]
        taken = " + ".join("-" if result is None else str(result["takeovers"]) for result in rounds)
        for what, takeovers in (("before", ""), ("after", taken), ("more", "")):
            numbers = interventions(study, f"{start} {what}", BEGINNERS_DRIVEN)
            print_row(seed, what, takeovers, *numbers, total(numbers))


def supervision(asked: argparse.Namespace, seed: int) -> str:
    """The prefix of the names of the second study's steps, with the length of its rounds."""
    return f"supervision {seed}" if asked.minutes == MINUTES else f"supervision of {asked.minutes:g} min {seed}"


def total(numbers: list[int | None]) -> int | None:
    return None if None in numbers else sum(number or 0 for number in numbers)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", default=["*"], metavar="PATTERN", help="only steps with these names")
    parser.add_argument("--list", action="store_true", help="only list the steps")
    parser.add_argument("--devices", nargs="+", default=list(DEVICES), choices=DEVICES)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--laps", type=float, default=0.5, help="laps to record; the beginner records 0.4 of this")
    parser.add_argument("--minutes", type=float, default=MINUTES, help="length of a round of supervision")
    parser.add_argument("--eval-laps", type=float, default=1.0)
    asked = parser.parse_args()
    folder: Path = asked.folder.absolute()
    (folder / "drives").mkdir(parents=True, exist_ok=True)
    os.environ["BC_CACHE"] = str(folder / "cache")
    study = Study(folder, asked)
    steps = [step for step in study.steps() if any(fnmatch(step.name, pattern) for pattern in asked.only)]
    if asked.list:
        for step in steps:
            print(f"{'made' if study.result(step.name) else '    '}  {step.kind:10} {step.name}")
        return 0
    undone = make(study, steps)
    print_tables(study)
    results = {step.name: result for step in study.steps() if (result := study.result(step.name))}
    lines = (f"{json.dumps(name)}: {json.dumps(result)}" for name, result in sorted(results.items()))
    (folder / "players.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    return 1 if undone else 0


if __name__ == "__main__":
    sys.exit(main())

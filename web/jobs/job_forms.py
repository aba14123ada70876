"""The forms that start commands, and the command line of each.

An empty field gives no flag: the command's own default applies. The command itself checks all values except
choices, in its first second.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, get_args

from common.errors import printable
from common.recipe import IndexRecipe, Recipe
from dataset.config import IndexConfig
from model.config import Answers, Light, TrainConfig
from model.network.names import BUILT_IN
from model.runs.run_files import new_run_name
from recorder.sources.settings import TimeUnit
from web.errors import WebError, or_404
from web.folders.project_folders import Place, ProjectFolders, key_of, shown_name

Suggestions = Literal["", "sessions", "runs", "pictures", "topics"]


def as_argument(word: str) -> str:
    """The word for a command line. Raises WebError for one that looks like a flag."""
    if word.startswith("-"):
        raise WebError(f"{word!r} begins with a hyphen: a command would take it for a flag", 422)
    return word


def refuse_taken(name: str, place: Place, folders: ProjectFolders) -> None:
    """Raise WebError for the name of another log. The command would advise `--force`, which no page has."""
    for log in folders.logs(place).values():
        if log.name == f"{name}.mcap":
            raise WebError(f"{printable(str(log))}: exists already; give another name", 409)


def in_one_field(words: Iterable[str]) -> str:
    """The value of a field with several words, in double quotes where they have blanks; "" if none can hold it."""
    words = list(words)
    value = " ".join(f'"{word}"' if word.split() != [word] else word for word in words)
    return value if _words_in(value) == words else ""


def suggested_sessions(folders: ProjectFolders) -> list[str]:
    """The names of the sessions, as a field with several words takes them."""
    names = map(shown_name, folders.logs("sessions").values())
    return sorted(filter(None, (in_one_field([name]) for name in names)))


def _words_in(value: str) -> list[str]:
    words = re.findall(r'(?:"[^"]*"|\S)+', value)
    return [re.sub(r'"([^"]*)"', r"\1", word) for word in words]


@dataclass(frozen=True)
class Field:
    """A value of a form. `flag` is None for `--name`, "" for words without a flag, or a verb before a word."""

    name: str
    label: str
    flag: str | None = None
    hint: str = ""  # the command's default
    choices: tuple[str, ...] = ()
    suggestions: Suggestions = ""  # names that the page suggests
    is_several: bool = False  # words, separated by blanks; with blanks in double quotes
    is_switch: bool = False  # given or not
    is_needed: bool = False
    is_more: bool = False  # folded: few people change it

    @property
    def as_flag(self) -> str:
        return f"--{self.name.replace('_', '-')}" if self.flag is None else self.flag

    def words(self, value: str) -> list[str]:
        if self.choices and value not in self.choices:  # another `--network` would name code to run
            raise WebError(f"{self.label}: expected one of {', '.join(self.choices)}", 422)
        flag = self.as_flag
        if self.is_switch:
            return [flag] if value else []
        if flag.startswith("-") and not self.is_several:
            return [f"{flag}={value}"]
        parts = _words_in(value) if self.is_several else [value]
        return [*([flag] if flag else []), *map(as_argument, parts)]


@dataclass(frozen=True)
class JobForm:
    name: str
    title: str
    about: str
    command: tuple[str, ...]
    fields: tuple[Field, ...]
    folders: tuple[str, ...]  # of the project; if they are not the usual ones, the command gets their flags
    made: Callable[[Mapping[str, str]], str]  # the page of its output
    names_run: bool = False  # a run without a name gets one, so that its page is known
    fills_project: bool = False  # its `--folder` is the project, if none of the project's folders exists yet

    def words(self, values: Mapping[str, str], folders: ProjectFolders) -> list[str]:
        """The command line. Raises WebError for an invalid value."""
        words = list(self.command)
        for field in sorted(self.fields, key=lambda field: field.as_flag[:1] in ("", "-")):  # a verb comes first
            value = values.get(field.name, "").strip()
            if not value:
                if field.is_needed:
                    raise WebError(f"{self.title}: {field.label} is missing", 422)
                continue
            if not value.isprintable():
                raise WebError(f"{field.label}: expected one line of text", 422)
            words += field.words(value)
        if self.makes_session:
            refuse_taken(values["name"].strip(), "sessions", folders)
        if self.fills(folders):
            words.append(f"--folder={folders.parent}")
        return words + folders.flags(*self.folders)

    @property
    def makes_session(self) -> bool:
        return self.command[0] in ("bc-record", "bc-import")

    def named(self, values: Mapping[str, str]) -> dict[str, str]:
        """The values of its fields, and the name of its run."""
        values = {
            field.name: values[field.name].strip() for field in self.fields if values.get(field.name, "").strip()
        }
        return values | {"name": values.get("name") or new_run_name()} if self.names_run else values

    def fills(self, folders: ProjectFolders) -> bool:
        return self.fills_project and folders.are_new and folders.parent is not None

    def page_of(self, values: Mapping[str, str], folders: ProjectFolders) -> str:
        """The page of its output; "" if the output is not in this project."""
        return "" if self.fills_project and not self.fills(folders) else self.made(values)


def _session(values: Mapping[str, str]) -> str:
    name = values.get("name", "").strip()
    return f"/sessions/{key_of(Path(f'{name}.mcap'))}" if name and "/" not in name else "/sessions"


def _run(values: Mapping[str, str]) -> str:
    name = (values.get("name") or values.get("run") or "").strip()
    return f"/runs/{key_of(Path(name))}" if name and "/" not in name else "/runs"


_INDEX: Final = IndexConfig()
_TRAIN: Final = TrainConfig()
_TARGETS: Final = ("steering", "steering speed", "steering throttle", "steering speed throttle")
_KEEP: Final = ("last", "driving-error", "balanced-rmse", "rmse")
INDEX_FIELDS: Final = (
    Field("sessions", "sessions", "", hint="all of them", suggestions="sessions", is_several=True),
    Field("recipe", "recipe", hint=_INDEX.recipe, choices=get_args(IndexRecipe)),
    Field("bins", "bins", hint=str(_INDEX.bins)),
    Field("per_bin", "samples a bin", hint=str(_INDEX.per_bin)),
    Field("max_uses", "most uses of a picture", hint=str(_INDEX.max_uses)),
    Field("labels", "labels", hint=_INDEX.labels, choices=("auto", "as-recorded")),
    Field("where", "rows where", hint="all rows; such as speed_mph > 5"),
    Field("validation_share", "share held out", hint=str(_INDEX.validation_share)),
    Field("validation", "sessions held out", hint="none as a whole", suggestions="sessions", is_several=True),
    Field("no_balance", "do not balance", is_switch=True),
    Field("no_flip", "no mirrored copies", is_switch=True),
    Field("seed", "seed", hint=str(_INDEX.seed)),
)
"""Also the fields of *Try other settings* on the index's page."""

FORMS: Final[Sequence[JobForm]] = (
    JobForm(
        "record",
        "Record",
        "The built-in simulator drives. The drive becomes a recording.",
        ("bc-record",),
        (
            Field("name", "name of the recording", "", is_needed=True),
            Field("track", "track", hint="lake; or mountain, random:SEED, hairpins:SEED"),
            Field("driver", "driver", hint="expert", choices=("expert", "keyboard", "mouse")),
            Field("laps", "laps", hint="1"),
            Field("speed", "speeds in mph", hint="10", is_several=True),
            Field("seed", "seed", hint="0"),
        ),
        ("sessions",),
        _session,
    ),
    JobForm(
        "import",
        "Import",
        "A recording of Udacity's simulator, DonkeyCar, ROS 2, LeRobot or MCAP becomes a recording.",
        ("bc-import",),
        (
            Field("source", "folder or file on this machine", "", is_needed=True),
            Field("name", "name of the recording", "", is_needed=True),
            Field("image", "topic of the pictures", hint="of a log or bag", suggestions="pictures", is_more=True),
            Field(
                "steering",
                "topic.field of the steering",
                hint="/cmd_vel.angular.z",
                suggestions="topics",
                is_more=True,
            ),
            Field("camera", "side cameras", hint="left=TOPIC right=TOPIC", is_several=True, is_more=True),
            Field("max_steering_age", "oldest steering, s", hint="1", is_more=True),
            Field("columns", "columns of a csv", hint="image=frame steering=angle", is_several=True, is_more=True),
            Field("steering_scale", "factor of the steering", hint="1; -1 for ROS", is_more=True),
            Field(
                "steering_offset", "added to the steering", hint="0; -0.53 if 0.53 is straight on", is_more=True
            ),
            Field("rate", "rows a second", hint="as recorded", is_more=True),
            Field(
                "time_unit", "unit of the times", hint="the usual one", choices=get_args(TimeUnit), is_more=True
            ),
            Field("car", "car", hint="Udacity's; or built-in", is_more=True),
        ),
        ("sessions",),
        _session,
    ),
    JobForm(
        "index",
        "Index",
        "Logs become frames and balanced samples.",
        ("bc-index",),
        (*INDEX_FIELDS, Field("look", "look at every picture", is_switch=True)),
        ("sessions", "index"),
        lambda values: "/index",
    ),
    JobForm(
        "train",
        "Train",
        "A network learns from the index, or from chosen sessions.",
        ("bc-train",),
        (
            Field("name", "name of the network", hint="date and time"),
            Field("network", "network", hint=_TRAIN.network, choices=tuple(BUILT_IN)),
            Field("epochs", "epochs", hint="as many as it needs"),
            Field("rate", "learning rate", hint=str(_TRAIN.rate)),
            Field("batch", "samples in a step", hint=str(_TRAIN.batch)),
            Field("targets", "what it learns", hint=_TARGETS[0], choices=_TARGETS, is_several=True),
            Field("recipe", "recipe", hint=_TRAIN.recipe, choices=get_args(Recipe)),
            Field("device", "computes on", hint="a GPU if there is one", choices=("cpu", "cuda")),
            Field("on", "only these sessions", hint="the index", suggestions="sessions", is_several=True),
            Field("init", "start from network", "continue", hint="random weights", suggestions="runs"),
            Field("patience", "patience, epochs", hint="0: all epochs", is_more=True),
            Field("dropout", "dropout", hint=str(_TRAIN.dropout), is_more=True),
            Field("keep", "epoch to keep", hint="by recipe", choices=_KEEP, is_more=True),
            Field("light", "light of the pictures", hint="by recipe", choices=get_args(Light), is_more=True),
            Field("answers", "answers", hint="by recipe", choices=get_args(Answers), is_more=True),
            Field("average_steps", "steps averaged", hint=str(_TRAIN.average_steps), is_more=True),
            Field("alter_each_epoch", "random changes", hint="by recipe", is_several=True, is_more=True),
            Field("target_weights", "weight of each target", hint="1", is_several=True, is_more=True),
            Field("picture_px", "width and height of the picture", is_several=True, is_more=True),
            Field("crop_rows", "rows cut off at top and bottom", is_several=True, is_more=True),
            Field("channels", "colour order", hint="the network's", choices=("BGR", "RGB", "YUV"), is_more=True),
            Field("threads", "processor threads", hint="one a core", is_more=True),
            Field("seed", "seed", hint="0", is_more=True),
        ),
        ("index", "sessions", "runs"),
        _run,
        names_run=True,
    ),
    JobForm(
        "learn",
        "Learn from takeovers",
        "A network learns from a test drive in which somebody took over, and from its earlier data.",
        ("bc-train", "continue"),
        (
            Field("run", "network", "", suggestions="runs", is_needed=True),
            Field("takeovers", "log of the drive", hint="drives/NAME.mcap", is_several=True, is_needed=True),
            Field("name", "name of the new network", hint="date and time"),
            Field("epochs", "epochs", hint="as many as it needs"),
            Field("recipe", "recipe", hint=_TRAIN.recipe, choices=get_args(Recipe), is_more=True),
        ),
        ("index", "sessions", "drives", "runs"),
        lambda values: _run({"name": values.get("name", "")}),
        names_run=True,
    ),
    JobForm(
        "resume",
        "Continue training",
        "A stopped training continues.",
        ("bc-train", "resume"),
        (
            Field("run", "network", "", suggestions="runs", is_needed=True),
            Field("epochs", "epochs", hint="as many as before"),
        ),
        ("index", "sessions", "runs"),
        _run,
    ),
    JobForm(
        "evaluate",
        "Evaluate",
        "Measures a network on the frames that were held out, or on whole recordings.",
        ("bc-eval",),
        (
            Field("run", "network", "", suggestions="runs", hint="the newest"),
            Field("session", "recordings instead", suggestions="sessions", is_several=True),
        ),
        ("runs", "sessions"),
        _run,
    ),
    JobForm(
        "drive",
        "Drive",
        "A network drives the built-in simulator. The drive's log is kept.",
        ("bc-eval", "drive"),
        (
            Field("run", "network", "", suggestions="runs", hint="the newest"),
            Field("track", "tracks", "--tracks", hint="lake mountain random:3", is_several=True, is_needed=True),
            Field("laps", "laps", hint="1"),
            Field("speed", "speeds in mph", hint="10", is_several=True),
            Field("force", "replace logs of the same names", is_switch=True),
        ),
        ("runs", "drives"),
        _run,
    ),
    JobForm(
        "demo",
        "Demo",
        "The whole chain: record, index, train, drive. It runs in this project if that is empty, otherwise in a"
        " new folder, demo/DATE. It takes some minutes.",
        ("bc-demo",),
        (Field("epochs", "epochs", hint="as many as it needs"),),
        (),
        lambda values: "/drives",
        fills_project=True,
    ),
)


def form_of(name: str) -> JobForm:
    return or_404(next((form for form in FORMS if form.name == name), None), f"{name!r}: no job has this name")

"""Commands that are started from the page: the very commands, seen again by another bc-web, ended by Ctrl-C."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest

from recorder import Log
from tests.helpers.driving import Process, command
from tests.helpers.logs import write_log
from tests.helpers.ports import free_ports
from tests.helpers.recorded_formats import as_csv
from tests.helpers.repository import ROOT
from tests.helpers.udacity import jpeg
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served, served_by
from web.jobs.job_forms import FORMS, JobForm
from web.jobs.jobs import Jobs


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as server:
        yield server


def start(bench: Served, **values: str) -> str:
    """The address of the job's page."""
    answer = bench.post("/jobs", **values)
    assert answer.status == 303, answer.text
    return answer.headers["location"]


def text(bench: Served, path: str) -> str:
    return html.unescape(re.sub(r"<[^>]*>", "", bench.get(path).text))


def test_a_job_is_the_command_and_makes_what_it_makes(bench: Served) -> None:
    asked = {"form": "record", "name": "a b's", "track": "lake", "laps": "0.01", "driver": "expert"}
    words = bench.command(f"/jobs.command?{urlencode(asked)}")
    sessions = bench.folder / "sessions"
    flags = f"--track=lake --driver=expert --laps=0.01 --sessions={sessions}"
    assert words == f"""bc-record 'a b'"'"'s' {flags}"""
    job = start(bench, **asked)
    assert words in text(bench, job)
    wait_until(lambda: "running" not in text(bench, job))
    assert "done" in text(bench, job)
    assert "a b's.mcap: " in text(bench, job)  # what the command prints
    with Log(sessions / "a b's.mcap") as log:
        assert len(log.vehicle()) > 0
    assert words in text(bench, "/jobs")
    assert re.search(r'class="last dim">next: <code>[^<]*bc-index', bench.get("/jobs").text)
    assert bench.get(re.findall(r'href="(/sessions/[^"]*)"', bench.get(job).text)[0]).status == 200


def test_an_import_is_the_command_with_its_flags(bench: Served) -> None:
    values = {"columns": "image=frame steering=angle", "steering_offset": "-0.53", "time_unit": "us"}
    asked = {"form": "import", "name": "mine", "source": "/my drives"} | values
    flags = (
        f"--columns image=frame steering=angle --steering-offset=-0.53 --time-unit=us --sessions={bench.folder}"
    )
    assert bench.command(f"/jobs.command?{urlencode(asked)}") == f"bc-import '/my drives' mine {flags}/sessions"
    unknown = bench.command(f"/jobs.command?{urlencode(asked | {'time_unit': 'h'})}")
    assert unknown == "unit of the times: expected one of s, ms, us, ns"


@pytest.mark.parametrize(("middle", "opens"), [(0.0, True), (0.53, False)])
def test_an_imported_session_opens_by_itself_unless_the_import_asks(
    bench: Served, middle: float, opens: bool
) -> None:
    rows = [(number / 20, middle + (0.0, 0.0, -0.1, 0.1)[number % 4], jpeg(60 + number)) for number in range(12)]
    source, _ = as_csv(bench.folder / "table", rows)
    columns = "image=p steering=s time_s=t"
    job = start(bench, form="import", name="mine", source=str(source), columns=columns)
    wait_until(lambda: "running" not in text(bench, job))
    assert ("hx-redirect" in bench.get(f"{job}?opens").headers) is opens
    assert ("--steering-offset -0.53" in text(bench, job)) is not opens


def test_an_import_replaces_no_session(bench: Served) -> None:
    write_log(bench.folder / "sessions" / "mine.mcap", [0.1] * 3)
    refused = bench.post("/jobs", form="import", name="mine", source="/drives")
    assert (refused.status, "mine.mcap: exists already" in refused.text) == (409, True)


def test_a_job_that_failed_leads_back_to_its_form_as_it_was_filled_in(bench: Served) -> None:
    job = start(bench, form="import", name="mine", source="/nowhere at all")
    wait_until(lambda: "running" not in text(bench, job))
    assert "failed" in text(bench, job)
    (back,) = re.findall(r'href="([^"]*)">Back to the form', bench.get(job).text)
    form = bench.get(html.unescape(back)).text
    assert 'value="mine"' in form
    assert 'value="/nowhere at all"' in form


def test_a_training_leads_to_its_run_whatever_becomes_of_it(bench: Served) -> None:
    job = start(bench, form="train", epochs="1")
    wait_until(lambda: "running" not in text(bench, job))
    (run,) = set(re.findall(r"--name=(\S+)", text(bench, job)))  # else nobody would know its page
    assert f'href="/runs/{run}"' in bench.get(job).text
    (exit_code,) = (bench.folder / "cache" / "jobs").glob("*/*/exit")
    exit_code.write_text("130")  # it was stopped
    (go_on,) = re.findall(r'href="([^"]*)">Continue training', bench.get(job).text)
    assert f'value="{run}"' in bench.get(html.unescape(go_on)).text


def test_the_page_of_a_run_that_never_began_reports_why(bench: Served) -> None:
    job = start(bench, form="train", name="mine", epochs="1")  # without sessions
    assert "Train mine: has not begun yet; reload this page in a moment" in text(bench, "/runs/mine")
    wait_until(lambda: "running" not in text(bench, f"{job}"))
    assert "Train mine: failed, and left no network; Activity shows its output" in text(bench, "/runs/mine")
    assert "nothing printed yet" not in text(bench, job)


def test_a_job_outlives_the_server_and_is_stopped_by_another(tmp_path: Path) -> None:
    with served(tmp_path) as bench:
        job = start(bench, form="record", name="long", laps="200")
        wait_until(lambda: list((tmp_path / "sessions").glob("long.mcap.*.part")))
        before = bench.get("/changes").json["jobs"]
    with served(tmp_path) as again:
        assert "running" in text(again, job)
        assert again.post(f"{job}/stop").status == 303
        wait_until(lambda: "running" not in text(again, job))
        assert "stopped" in text(again, job)
        assert again.get("/changes").json["jobs"] != before
        assert again.post(f"{job}/stop").status == 303  # nothing more to stop


def test_without_any_folder_the_demo_fills_them(bench: Served) -> None:
    assert 'name="form" value="demo"' in bench.get("/").text
    line = f"bc-demo --folder={bench.folder}"
    job = start(bench, form="demo")
    wait_until(lambda: re.search(r'class="state">recording', bench.get("/sessions").text))
    assert bench.post(f"{job}/stop").status == 303
    wait_until(lambda: "running" not in text(bench, job))
    assert line in text(bench, job)
    assert "1 of 6" in text(bench, job)
    (bench.folder / "sessions").mkdir(exist_ok=True)
    assert bench.command("/jobs.command?form=demo") == "bc-demo"  # it fills no project that has something


def test_the_command_reports_which_jobs_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    with Process(command("bc-web", "--port", *free_ports(1)), cwd=tmp_path) as process:
        bench = served_by(process, tmp_path)
        job = start(bench, form="record", name="long", laps="200").rpartition("/")[2]
        assert process.end() == 0
        printed = "\n".join(process.stderr)
        assert "1 job goes on: bc-record long --laps=200\n" in printed
        assert f"start `bc-web` in {tmp_path} and" in printed
    jobs = Jobs(tmp_path / "cache" / "web")
    jobs.stop(job)
    wait_until(lambda: not jobs.get(job).is_running)


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"form": "record"},
        {"form": "rm", "name": "x"},
        {"form": "record", "name": "--force"},
        {"form": "record", "name": "a\nb"},
        {"form": "drive", "track": "lake --json"},
        {"form": "index", "sessions": "a --index=/tmp/x"},
        {"form": "train", "network": "recordings/uploaded/code.py:Net"},  # it would run code
    ],
)
def test_what_cannot_be_a_command_is_not_started(bench: Served, values: dict[str, str]) -> None:
    answer = bench.post("/jobs", **values)
    assert answer.status in (404, 422)
    assert answer.json["error"]
    assert "Nothing has run yet" in bench.get("/jobs").text


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_every_flag_of_a_form_is_one_of_its_command(form: JobForm) -> None:
    page = (ROOT / "docs" / "commands.md").read_text()  # a test holds it to `--help-all`
    blocks = re.findall(rf"<!-- generated: {form.command[0]} ?(\w*) -->(.*?)<!-- end", page, re.DOTALL)
    documented = {verb for verb, _ in blocks} | {
        flag for _, text in blocks for flag in re.findall(r"--[a-z-]+", text)
    }
    flags = {field.as_flag for field in form.fields} | {f"--{name}" for name in form.folders}
    assert flags - {""} <= documented

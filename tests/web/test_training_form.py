"""The form of a training: what people change is at hand, the rest is folded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.helpers.pages import opened_page
from tests.helpers.workbench import served
from web.jobs.job_forms import FORMS, JobForm

if TYPE_CHECKING:
    from playwright.sync_api import Browser


def test_the_page_shows_the_command(browser: Browser, tmp_path: Path) -> None:
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/jobs?start=train&dropout=0.1") as page:
        form = page.locator("details[open] form[action='/jobs']").first
        assert form.locator("[name=dropout]").is_visible()  # a value that is given is shown
        form.locator("[name=network]").select_option("small")
        form.locator("[name=rate]").fill("3e-4")
        form.locator("[name=batch]").fill("64")
        form.locator("[name=targets]").select_option("steering speed")
        form.locator("[name=device]").select_option("cpu")
        form.locator("[name=epochs]").fill("2")
        words = "bc-train --network=small --epochs=2 --rate=3e-4 --batch=64 --targets steering speed --device=cpu"
        page.wait_for_selector(f"#command-train:has-text('{words}')", state="attached")


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_every_flag_of_a_form_is_one_of_its_command(form: JobForm) -> None:
    page = (Path(__file__).parents[2] / "docs" / "commands.md").read_text()  # a test holds it to `--help-all`
    blocks = re.findall(rf"<!-- generated: {form.command[0]} ?(\w*) -->(.*?)<!-- end", page, re.DOTALL)
    documented = {verb for verb, _ in blocks} | {
        flag for _, text in blocks for flag in re.findall(r"--[a-z-]+", text)
    }
    flags = {field.as_flag for field in form.fields} | {f"--{name}" for name in form.folders}
    assert flags - {""} <= documented

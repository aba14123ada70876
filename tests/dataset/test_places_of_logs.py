"""An index names its logs, which may be in any folder or bucket."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dataset import DatasetError, Samples
from tests.helpers.toy import toy_index

pytestmark = pytest.mark.usefixtures("project")

KEY = b"bc.index"


def copied(project: Path, name: str) -> Path:
    """A copy of an index, which names its log, private/toy.mcap, so."""
    index = shutil.copytree(toy_index(project.parent / "private"), project / "index")
    path = index / "samples.parquet"
    table = pq.read_table(path)
    stored = json.loads(table.schema.metadata[KEY])
    stored["logs"]["toy"]["log"] = name
    pq.write_table(table.replace_schema_metadata({KEY: json.dumps(stored).encode()}), path)
    return index


@pytest.mark.parametrize(
    "name_of",
    [lambda log: "../../private/toy.mcap", str, lambda log: log.as_uri(), lambda log: "../link.mcap"],
    ids=["relative", "absolute", "file-url", "link"],
)
def test_a_log_of_an_index_may_be_anywhere(project: Path, name_of: Callable[[Path], str]) -> None:
    log = project.parent / "private" / "toy.mcap"
    index = copied(project, name_of(log))
    (project / "link.mcap").symlink_to(log)
    with Samples(index) as samples:
        assert list(samples.logs) == ["toy"]


@pytest.mark.parametrize("name", ["/dev/zero", "../../private", "../../private/gone.mcap", "a\0b"])
def test_what_is_no_log_is_one_line(project: Path, name: str) -> None:
    with pytest.raises(DatasetError) as error:
        Samples(copied(project, name))
    assert "\n" not in str(error.value)

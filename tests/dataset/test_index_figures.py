"""The figures of an index: files that a paper can use, showing the numbers and pictures of the user's own data."""

from __future__ import annotations

import io
import itertools
import struct
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from common import UserError
from common.car import Camera
from dataset import DatasetError, IndexConfig, Samples, build_index, decode, preprocess
from dataset.augment import alter
from dataset.figure_style import figure_style
from dataset.index_figures import (
    Kind,
    Moment,
    draw_augmentation,
    draw_balance,
    draw_preprocessing,
    find_moments,
    steering_distribution,
    two_draws,
    write_figures,
)
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image
from logs import write_log
from udacity import jpeg

NAMES = ["preprocessing", "augmentation", "balance"]
# 50 rows in 5 s: one block of time, which is all for training. The cap leaves the right turns short of the mean.
STEERING = [0.0] * 36 + [-0.3] * 12 + [0.5, 0.5]
CONFIG = IndexConfig(max_uses=2)


def level(camera: Camera, row: int) -> int:
    return 20 + 4 * row + (camera != "center")


def grey(camera: Camera, row: int) -> bytes:
    """A picture whose brightness says which row it is of."""
    return jpeg(level(camera, row))


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    log = write_log(folder / "a.mcap", STEERING, grey, cameras=["center"])
    return build_index([log], folder / "index", CONFIG).path


@pytest.fixture(scope="module")
def written(index: Path) -> list[Path]:
    return write_figures(index, index / "figures")


@pytest.fixture
def samples(index: Path) -> Iterator[Samples]:
    opened = Samples(index)
    yield opened
    opened.close()


# The files


def test_each_figure_is_there_as_png_and_as_pdf(index: Path, written: list[Path]) -> None:
    assert written == [index / "figures" / f"{name}.{kind}" for name in NAMES for kind in ("png", "pdf")]
    assert sorted((index / "figures").iterdir()) == sorted(written)  # and nothing else is left there
    for pdf in written[1::2]:
        data = pdf.read_bytes()
        assert data.startswith(b"%PDF-")
        assert data.rstrip().endswith(b"%%EOF")
        assert b"/FontFile2" in data  # TrueType, embedded
        assert b"/Type3" not in data


def test_the_pngs_are_7_inches_wide_at_200_dpi(written: list[Path]) -> None:
    for png in written[::2]:
        data = png.read_bytes()
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        width, height = struct.unpack(">II", data[16:24])
        assert width == 1400
        assert 500 < height < 1000
        at = data.index(b"pHYs") + 4
        assert struct.unpack(">IIB", data[at : at + 9]) == (7874, 7874, 1)  # pixels a metre
        assert np.unique(decode(data)).size > 10


def test_the_same_index_gives_the_same_bytes_whatever_the_users_own_style(
    index: Path, written: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "balance.pdf").write_text("an older one")
    with matplotlib.rc_context({"font.size": 20.0, "savefig.facecolor": "red"}):
        again = write_figures(index, tmp_path, overwrite=True)
        assert matplotlib.rcParams["font.size"] == 20.0
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in written]


def test_nothing_is_overwritten_unasked_and_then_nothing_is_written(index: Path, tmp_path: Path) -> None:
    mine = tmp_path / "balance.pdf"
    mine.write_text("mine")
    with pytest.raises(UserError, match=r"balance\.pdf exists already"):
        write_figures(index, tmp_path)
    assert list(tmp_path.iterdir()) == [mine]
    assert mine.read_text() == "mine"


def test_without_matplotlib_the_error_says_how_to_get_it(
    index: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(DatasetError, match=r"`pip install .*\[figures\].*`"):
        write_figures(index, tmp_path / "figures")
    assert not (tmp_path / "figures").exists()


def test_no_index_or_a_damaged_one_is_an_error_that_names_the_file(index: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no index; .*build it with `bc-index"):
        write_figures(tmp_path, tmp_path / "figures")
    stored = pq.read_table(index / "samples.parquet")
    damaged = index.parent / "damaged"  # beside it: where the logs are is told relative to the index
    damaged.mkdir()
    for wrong in (b'"balance"', b'"settings"', b'"before"', b'"bins"'):
        metadata = {b"bc.index": stored.schema.metadata[b"bc.index"].replace(wrong, b'"other"')}
        pq.write_table(stored.replace_schema_metadata(metadata), damaged / "samples.parquet")
        with pytest.raises(DatasetError, match=r"samples\.parquet: damaged .* `bc-index`"):
            write_figures(damaged, tmp_path / "figures")
    assert not (tmp_path / "figures").exists()


# The numbers


def bin_of(steering: float) -> int:
    """None of the steering angles here lies on an edge between two of the 25 bins."""
    return int((steering + 1) * 12.5)


def heights(axes: Axes) -> dict[str, list[float]]:
    """The bars of a panel, from left to right, by what the legend calls them."""
    return {str(bars.get_label()): [bar.get_height() for bar in bars] for bars in axes.containers}


def test_the_bars_are_the_counts_of_the_samples(index: Path, samples: Samples) -> None:
    before, after = draw_balance(steering_distribution(samples, CONFIG), CONFIG).axes
    counts = Counter(bin_of(side * steering) for steering in STEERING for side in (1, -1))
    mean = round(sum(counts.values()) / len(counts))
    rows = pq.read_table(index / "samples.parquet").to_pylist()
    used = Counter((row["copy"], bin_of(row["label"])) for row in rows)
    assert heights(before) == {"recorded and mirrored": [counts[i] for i in range(25)]}
    assert heights(after) == {
        "originals": [used[False, i] for i in range(25)],
        "altered copies": [used[True, i] for i in range(25)],
        "missing: the cap on copies": [
            mean - used[False, i] - used[True, i] if counts[i] else 0 for i in range(25)
        ],
    }
    assert used[True, bin_of(0.5)] == 2  # two right turns, each at most twice: short of the mean
    for axes in (before, after):
        target, empty = axes.get_lines()
        assert list(np.unique(target.get_ydata())) == [mean]
        assert [round((x + 1) * 12.5 - 0.5) for x in np.asarray(empty.get_xdata(), float)] == [
            i for i in range(25) if not counts[i]
        ]


def test_the_parts_of_a_bar_stand_on_one_another_at_its_bin(samples: Samples) -> None:
    _, after = draw_balance(steering_distribution(samples, CONFIG), CONFIG).axes
    parts = list(after.containers)
    for lower, upper in itertools.pairwise(parts):
        for below, above in zip(lower, upper, strict=True):
            assert above.get_y() == below.get_y() + below.get_height()
    for bars in parts:
        middles = [bar.get_x() + bar.get_width() / 2 for bar in bars]
        np.testing.assert_allclose(middles, [-0.96 + 0.08 * i for i in range(25)])


def test_without_copies_and_empty_bins_the_legend_names_neither(tmp_path: Path) -> None:
    config = IndexConfig(bins=1, flip=False, alter=())
    log = write_log(tmp_path / "a.mcap", [0.2, -0.2], grey, cameras=["center"])
    index = build_index([log], tmp_path / "index", config).path
    samples = Samples(index)
    try:
        before, after = draw_balance(steering_distribution(samples, config), config).axes
        assert (heights(before), heights(after)) == ({"recorded": [2]}, {"originals": [2]})
        assert len(before.get_lines()) == 1
    finally:
        samples.close()


# The pictures


def images(figure: Figure) -> list[Image]:
    """What the panels show, as BGR."""
    return [np.asarray(axes.get_images()[0].get_array(), np.uint8)[:, :, ::-1] for axes in figure.axes]


def row_shown(picture: Image) -> int:
    return round((float(picture.mean()) - 20) / 4)


@pytest.mark.parametrize("seed", range(5))
def test_each_moment_shows_its_own_steering_and_picture(samples: Samples, seed: int) -> None:
    moments = find_moments(samples, seed)
    assert [moment.kind for moment in moments] == ["left turn", "straight", "right turn"]
    assert [moment.steering for moment in moments] == pytest.approx([-0.3, 0.0, 0.5])
    assert [STEERING[row_shown(moment.picture)] for moment in moments] == [-0.3, 0.0, 0.5]


def test_another_seed_shows_other_frames(samples: Samples) -> None:
    assert len({row_shown(find_moments(samples, seed)[0].picture) for seed in range(10)}) > 1


def test_a_turn_is_a_typical_one(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [-1.0, *[-0.3] * 8, -0.11], grey, cameras=["center"])
    samples = Samples(build_index([log], tmp_path / "index").path)
    try:
        steering = {moment.steering for seed in range(20) for moment in find_moments(samples, seed)}
        assert {round(value, 6) for value in steering} == {-0.3}
    finally:
        samples.close()


def test_a_kind_that_was_never_driven_and_side_cameras_are_not_shown(tmp_path: Path) -> None:
    def picture(camera: Camera, row: int) -> bytes:
        return grey("center", row) if camera == "center" else jpeg(250)

    log = write_log(tmp_path / "a.mcap", [0.0, 0.02, 0.4, 0.4], picture)
    samples = Samples(build_index([log], tmp_path / "index").path)
    try:
        for seed in range(5):
            moments = find_moments(samples, seed)
            assert [moment.kind for moment in moments] == ["straight", "right turn"]
            assert all(row_shown(moment.picture) < 4 for moment in moments)
    finally:
        samples.close()


def test_a_broken_picture_names_its_log_and_row(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [0.3], lambda camera, row: b"no picture", cameras=["center"])
    samples = Samples(build_index([log], tmp_path / "index").path)
    try:
        with pytest.raises(DatasetError, match=r"a\.mcap: row 0, center camera: .*not a picture"):
            find_moments(samples, 0)
    finally:
        samples.close()


@pytest.mark.parametrize("height", [160, 120, 240, 480, 77])
def test_the_edges_drawn_are_those_of_the_networks_crop(height: int) -> None:
    rows = ORIGINAL.crop_slice(height)
    top, bottom = rows.start, rows.stop
    picture = np.zeros((height, 40, 3), np.uint8)
    picture[:top], picture[bottom:] = 255, 255
    assert not preprocess(picture).any()
    picture[top - 1 : top + 1], picture[bottom - 1 : bottom + 1] = 255, 255
    seen = preprocess(picture)
    assert seen[0].any()
    assert seen[-1].any()


def test_preprocessing_shows_picture_crop_and_input_of_each_moment(samples: Samples) -> None:
    moments = find_moments(samples, 0)
    shown = images(draw_preprocessing(moments))
    assert len(shown) == 9
    for moment, (picture, crop, seen) in zip(moments, zip(*[iter(shown)] * 3, strict=True), strict=True):
        assert (picture == moment.picture).all()
        assert (crop == moment.picture[50:140]).all()
        assert (seen == preprocess(moment.picture)).all()


@pytest.mark.parametrize(("width", "height"), [(320, 160), (160, 120), (640, 480), (120, 160), (800, 160)])
def test_no_text_lies_on_another_whatever_the_pictures_size(width: int, height: int) -> None:
    picture = np.zeros((height, width, 3), np.uint8)
    turns: list[tuple[Kind, float]] = [("left turn", -0.3), ("straight", 0.0), ("right turn", 0.5)]
    moments = [Moment(kind, steering, picture) for kind, steering in turns]
    with figure_style():
        figure = draw_preprocessing(moments)
        FigureCanvasAgg(figure)
        figure.draw_without_rendering()
        texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text()]
        boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    assert len(boxes) > 20
    overlapping = [
        (one, other) for (one, box), (other, beside) in itertools.combinations(boxes, 2) if box.overlaps(beside)
    ]
    assert overlapping == []
    for text, box in boxes:
        assert -1 < box.x0 < box.x1 < figure.bbox.width + 1, text


def test_blue_is_blue_in_the_file() -> None:
    sky = Moment("straight", 0.0, np.full((160, 320, 3), (200, 60, 10), np.uint8))  # blue, green, red
    stream = io.BytesIO()
    draw_preprocessing([sky]).savefig(stream, format="png")
    shown = decode(stream.getvalue())
    assert (shown == (200, 60, 10)).all(axis=2).mean() > 0.2
    assert not (shown == (10, 60, 200)).all(axis=2).any()


def test_augmentation_shows_a_picture_and_its_mirror_image_with_labels(samples: Samples) -> None:
    moment = find_moments(samples, 0)[2]
    moment.picture[:, :160] = 10  # the left half dark, so that the sides can be told apart
    crop = preprocess(moment.picture)
    figure = draw_augmentation(moment, CONFIG, seed=0)
    titles = [axes.get_title() for axes in figure.axes[:5]]
    assert titles == ["unaltered", "blur", "brightness", "shadow", "combined"]
    assert [figure.axes[i].get_ylabel() for i in (0, 5)] == [
        "picture\nsteering +0.50",
        "mirror image\nsteering −0.50",
    ]
    shown = images(figure)
    assert len(shown) == 10
    assert (shown[0] == crop).all()
    assert (shown[5] == crop[:, ::-1]).all()
    for altered in shown[1:5]:
        assert (altered != crop).any()
        assert altered[:, :50].mean() < altered[:, -50:].mean()
    for altered in shown[6:]:
        assert altered[:, :50].mean() > altered[:, -50:].mean()


def test_an_index_without_mirror_images_or_alterations_shows_none(samples: Samples) -> None:
    moment = find_moments(samples, 0)[0]
    assert len(draw_augmentation(moment, IndexConfig(flip=False, alter=()), 0).axes) == 1
    figure = draw_augmentation(moment, IndexConfig(flip=False, alter=("shadow",)), 0)
    assert [axes.get_title() for axes in figure.axes] == ["unaltered", "shadow"]


def brightness_level(crop: Image, seed: int) -> int:
    return int(alter(crop, "brightness", seed)[0, 0, 0])


def test_of_an_alteration_the_two_draws_that_differ_most_are_shown() -> None:
    crop = np.full((128, 128, 3), 150, np.uint8)
    dark, bright = sorted(two_draws(crop, "brightness", 0), key=lambda seed: brightness_level(crop, seed))
    levels = [brightness_level(crop, seed) for seed in range(12)]
    assert (brightness_level(crop, dark), brightness_level(crop, bright)) == (min(levels), max(levels))

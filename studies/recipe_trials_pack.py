"""Packs what recipe_trials.py needs, so that a machine without the logs can train.

python studies/recipe_trials_pack.py FOLDER sessions/*.mcap
"""
import sys
from pathlib import Path
import cv2, numpy as np, pickle
import pyarrow.parquet as pq
from dataset import IndexConfig, Loader, Samples, build_index
from dataset.loader.crops import different_crops
from dataset.picture_spec import ORIGINAL, PictureSpec
RAW = PictureSpec(width_px=320, height_px=90)  # the rows of the crop; the trials resize them
from model.evaluation.evaluate import _from_index, _in_crashes
from model.training.natural_frequency import NaturalFrames
HERE, LOGS = Path(sys.argv[1]), [Path(log).resolve() for log in sys.argv[2:]]
OFFSETS = (0.1, 0.2, 0.3, 0.4, 0.5)
def indexes():
    for log in LOGS:
        name = HERE / "indexes" / log.stem
        if not (name / "samples.parquet").exists():
            build_index([o for o in LOGS if o != log], name, IndexConfig(validation_share=0.1))
        ev = HERE / "eval" / log.stem
        if not (ev / "samples.parquet").exists():
            build_index([log], ev, IndexConfig(validation=(log.stem,), balance=False, flip=False,
                                               labels="as-recorded"))
def later(index, table, offsets):
    """Recorded steering at time + offset for each sample (N, K), signed and corrected as the sample's label."""
    session = np.asarray(table["session"].cast("string")); t = table["log_time_ns"].to_numpy()
    flip = np.asarray(table["flip"]); camera = np.asarray(table["camera"].cast("string"))
    out = np.zeros((len(t), len(offsets)))
    for name in set(session.tolist()):
        frames = pq.read_table(index / "frames" / f"{name}.parquet")
        ft, fs = frames["log_time_ns"].to_numpy(), frames["steering"].to_numpy()
        order = np.argsort(ft, kind="stable"); ft, fs = ft[order], fs[order]
        at = session == name
        for k, o in enumerate(offsets):
            out[at, k] = np.interp(t[at] + o * 1e9, ft, fs)
    correction = np.select([camera == "left", camera == "right"], [0.2, -0.2], 0.0)
    out += correction[:, None]
    return np.where(flip[:, None], -out, out).clip(-1, 1)

indexes()
jpegs, number = [], {}
def add(loader, names):
    """Crop numbers and relative flips of a loader's rows."""
    rows = loader.rows
    samples, crop = different_crops(rows)
    flip = rows.flip != rows.flip[samples][crop]
    base = np.zeros(len(samples), np.int64)
    of = {s: (rows.sessions[rows.session[rows.picture[s]]], int(rows.offset[rows.picture[s]]), bool(rows.flip[s])) for s in samples.tolist()}
    need = [s for s in samples.tolist() if (of[s][0], of[s][1]) not in number]
    for part, crops in loader.crops(np.array(need, np.int64)) if need else []:
        for s, c in zip(part.tolist(), crops):
            n, o, f = of[s]
            if (n, o) not in number:
                c = cv2.flip(c, 1) if f else c
                number[n, o] = len(jpegs)
                jpegs.append(cv2.imencode(".jpg", c, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())
    crop_number = np.array([number[of[s][:2]] for s in samples.tolist()], np.int64)
    return crop_number[crop], rows.flip.astype(bool).copy()
data = {}
for log in LOGS:
    fold = log.stem; d = data[fold] = {}
    with Samples(HERE / "indexes" / fold) as samples:
        table = samples.of_split("train", None)
        l = Loader(samples, samples.rows_of_split("train"), batch=256, budget_bytes=0, seen=RAW)
        d["crop"], d["flip"] = add(l, fold); d["label"] = l.rows.label.copy()
        d["aux"] = later(HERE / "indexes" / fold, table, OFFSETS).astype(np.float32)
        d["asrec"] = later(HERE / "indexes" / fold, table, (0.0,))[:, 0].astype(np.float32)
        d["window"] = later(HERE / "indexes" / fold, table, np.arange(0, 0.41, 0.05)).mean(1).astype(np.float32)
        n = NaturalFrames(samples, 64, 1, RAW).loader
        d["ncrop"], d["nflip"] = add(n, fold); d["nlabel"] = n.rows.label.copy()
    with Samples(HERE / "eval" / fold) as samples:
        view = samples.driving_view("validation")
        l = Loader(samples, view, batch=256, budget_bytes=0, seen=RAW)
        d["ecrop"], d["eflip"] = add(l, fold); d["elabel"] = l.rows.label.copy()
        d["crash"] = _in_crashes(_from_index(view, samples), samples)
    print(fold, len(d["crop"]), len(d["ncrop"]), len(d["ecrop"]), len(jpegs), sum(map(len, jpegs)) / 2**20, flush=True)
pickle.dump({"jpegs": jpegs, "data": data}, open(HERE / "pack.pkl", "wb"))

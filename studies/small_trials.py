"""Trials of the recipe `altered` with `small`: train on three people, answer the fourth's frames.

FOLDER=trials LOGS=sessions python studies/small_trials.py indexes
FOLDER=trials LOGS=sessions python studies/small_trials.py VARIANT SEEDS [PEOPLE]

A variant is one or several of these words, joined by +: base, aux, window, adamw, no_ALTERATION, wide, wide200, pre,
side, 20epochs. small_trials_pre.py and small_trials_side.py prepare `pre` and `side`.
"""
import sys, os, time, copy, json
from pathlib import Path
import numpy as np, torch
torch.set_num_threads(1)
import cv2; cv2.setNumThreads(1)
import pyarrow.parquet as pq
from dataset import IndexConfig, Loader, Samples, build_index
from dataset.config import EPOCH_ALTERATIONS
from dataset.prediction_targets import STEERING_ONLY
from model.adam import Adam
from model.config import TrainConfig
from model.network.choice import choose_network, chosen_picture
from model.training.averaged_weights import AveragedWeights
from model.training.natural_frequency import NaturalFrames
from model.evaluation.predict import as_input, predict
from model.evaluation.evaluate import _from_index, _in_crashes
from model.runs.answer_scale import AnswerScale

HERE = Path(os.environ["FOLDER"]).resolve(); LOGS = sorted(Path(os.environ["LOGS"]).resolve().glob("*.mcap"))
OFFSETS = (0.1, 0.2, 0.3, 0.4, 0.5)

def indexes():
    for log in LOGS:
        name = HERE / "indexes" / log.stem
        if not (name / "samples.parquet").exists():
            build_index([o for o in LOGS if o != log], name, IndexConfig(validation_share=0.1))
        ev = HERE / "eval" / log.stem
        if not (ev / "samples.parquet").exists():
            build_index([log], ev, IndexConfig(validation=(log.stem,), balance=False, flip=False, labels="as-recorded"))

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

def train(variant, fold, seed, epochs=10):
    network_name = "small"
    index = HERE / "indexes" / fold
    config = TrainConfig(network=network_name, seed=seed, threads=1)
    choice = choose_network(config); picture = chosen_picture(config, choice)
    outputs = 1
    words = variant.split("+")
    if "aux" in words or "auxheavy" in words: outputs = 1 + len(OFFSETS)
    from dataclasses import replace
    choice = replace(choice, outputs=outputs)
    with Samples(index) as samples:
        table = samples.of_split("train", None)
        names = tuple(n for n in EPOCH_ALTERATIONS if f"no_{n}" not in words)
        if "wide" in words: picture = replace(picture, width_px=160, height_px=80)
        if "wide200" in words: picture = replace(picture, width_px=200, height_px=66)
        rows = samples.rows_of_split("train")
        if "side" in words or "centre" in words:
            corrections = json.loads((HERE / "side.json").read_text())[fold] if "side" in words else {}
        loader = Loader(samples, rows, batch=256, seed=seed, threads=1, seen=picture, alter_each_epoch=names)
        if "side" in words:
            cam = np.asarray(table["camera"].cast("string")); ses = np.asarray(table["session"].cast("string")); flip = np.asarray(table["flip"])
            sign = np.select([cam == "left", cam == "right"], [1.0, -1.0], 0.0) * np.where(flip, -1.0, 1.0)
            c = np.array([corrections[x] for x in ses])
            side_delta = (sign * (c - 0.2)).astype(np.float32)
        aux = later(index, table, OFFSETS).astype(np.float32) if outputs > 1 else None
        main = None
        if "window" in words: main = later(index, table, np.arange(0, 0.41, 0.05)).mean(1).astype(np.float32)
        if "window2" in words: main = later(index, table, np.arange(-0.2, 0.41, 0.05)).mean(1).astype(np.float32)
        teachers = []
        if "distil" in words:
            teachers = [torch.load(HERE / "nets" / f"base-{fold}-{s}.pt", weights_only=False) for s in range(5)]
        if "distil" in words or "learn" in words: pass
        natural = NaturalFrames(samples, 64, 1, picture, keeps_pictures=True)
        torch.manual_seed(seed)
        net = choice.build()
        if "wide" in words or "wide200" in words:
            with torch.no_grad(): n_in = net.features(torch.zeros(1, 3, picture.height_px, picture.width_px)).numel()
            net.head[1] = torch.nn.Linear(n_in, 64)
            torch.nn.init.xavier_uniform_(net.head[1].weight); torch.nn.init.zeros_(net.head[1].bias)
        if "pre" in words: net.features.load_state_dict(torch.load(HERE / "nets" / f"pretrained-all-{seed}.pt"))
        net = net.to(memory_format=torch.channels_last)
        avg = AveragedWeights(net, 100); avg.begin(net)
        rate = config.rate
        opt = Adam(net.parameters(), rate)
        weights = torch.tensor([1.0] + [0.2 if "aux" in words else 1.0] * (outputs - 1))
        if "20epochs" in words: epochs = 20
        if "30epochs" in words: epochs = 30
        step = 0
        for epoch in range(1, epochs + 1):
            net.train(); total = 0.0; n = 0; begun = time.time()
            for part, batch in zip(loader.parts(epoch), loader.epoch(epoch), strict=True):
                labels = torch.from_numpy(batch.labels)
                if 'side' in words: labels = labels + torch.from_numpy(side_delta[part])
                shift = labels - torch.from_numpy(loader.rows.label[part])
                if main is not None: labels = torch.from_numpy(main[part]) + shift
                pics = as_input(batch.pictures)
                if teachers:
                    with torch.inference_mode():
                        t = torch.stack([te(pics) for te in teachers]).mean(0)
                    labels = 0.5 * labels + 0.5 * t
                    labels = labels.clone()
                if aux is not None:
                    labels = torch.cat([labels[:, None], torch.from_numpy(aux[part]) + shift[:, None]], 1)
                step += 1
                torch.manual_seed(seed * 100003 + step)
                opt.zero_grad()
                for p, l in zip(pics.split(64), labels.split(64)):
                    out = net(p)
                    if "huber" in words: loss = torch.nn.functional.smooth_l1_loss(out, l, beta=0.1, reduction="sum") * 0.1
                    else: loss = ((out - l) ** 2 * (weights if outputs > 1 else 1)).sum()
                    (loss / len(labels)).backward(); total += float(loss.detach())
                n += len(labels)
                opt.step()
                if "adamw" in words:
                    with torch.no_grad():
                        for q in net.parameters():
                            if q.dim() > 1: q.mul_(1 - rate * 1.0)
                avg.update(net, step)
            print(f"{variant} {fold} {seed} epoch {epoch} loss {total/n:.4f} {time.time()-begun:.0f} s", flush=True)
        final = avg.network
        if outputs > 1:
            last = final.head[-1]; cut = torch.nn.Linear(last.in_features, 1); cut.weight.data = last.weight.data[:1].clone(); cut.bias.data = last.bias.data[:1].clone()
            final.head[-1] = cut; final.outputs = 1
        scale = natural.fit(final)
    return final, scale, picture

def answer(net, scale, picture, fold):
    net.eval()
    with Samples(HERE / "eval" / fold) as samples:
        view = samples.driving_view("validation")
        loader = Loader(samples, view, batch=64, budget_bytes=0, seen=picture, threads=1)
        learnt, recorded = predict(net, loader)
        crash = _in_crashes(_from_index(view, samples), samples)
    return learnt, np.asarray(scale.natural(learnt)), recorded, crash

def main():
    variant, seeds = sys.argv[1], [int(s) for s in sys.argv[2].split(",")]
    folds = sys.argv[3].split(",") if len(sys.argv) > 3 else [l.stem for l in LOGS]
    for d in ("out", "nets"): (HERE / d).mkdir(exist_ok=True)
    for seed in seeds:
        for fold in folds:
            out = HERE / "out" / f"{variant}-{fold}-{seed}.npz"
            if out.exists(): continue
            lock = out.with_suffix(".lock")
            try: os.close(os.open(lock, os.O_CREAT | os.O_EXCL))
            except FileExistsError: continue
            net, scale, picture = train(variant, fold, seed)
            torch.save(net, HERE / "nets" / f"{variant}-{fold}-{seed}.pt")
            learnt, natural, recorded, crash = answer(net, scale, picture, fold)
            np.savez(out, learnt=learnt, natural=natural, recorded=recorded, crash=crash)
if __name__ == "__main__":
    indexes() if sys.argv[1] == "indexes" else main()

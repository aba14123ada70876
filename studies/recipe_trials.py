"""Trials of recipes on a GPU: trains on three people, answers the fourth's frames.

OUT=FOLDER python studies/recipe_trials.py FOLDER/pack.pkl PERSON SECONDS     # one process for each person
"""
import os, pickle, sys, time
import cv2, numpy as np, torch
from model.adam import Adam
from model.network.original import SteeringNetwork
from model.runs.answer_scale import AnswerScale
from model.training.altered_on_device import AlteredOnDevice
from model.training.averaged_weights import AveragedWeights
from model.training.step import training_step
from dataset.config import EPOCH_ALTERATIONS
from dataset.epoch_alterations import EpochAlterations
pack, fold, stop_s = sys.argv[1], sys.argv[2], float(sys.argv[3])
OUT = os.environ.get("OUT", "/tmp"); begun = time.time()
dev = torch.device("cuda:0" if torch.cuda.is_available() else "cpu")
DT = torch.bfloat16
torch.set_num_threads(2)
if dev.type == "cuda": torch.set_float32_matmul_precision("high")
loaded = pickle.load(open(pack, "rb")); d = loaded["data"][fold]
SMALL = int(os.environ.get("SMALL", 0))
if SMALL:
    for k in ("crop", "flip", "label", "aux", "window"): d[k] = d[k][:SMALL]
need = np.unique(np.concatenate([d["crop"], d["ncrop"], d["ecrop"]]))
at = {int(n): i for i, n in enumerate(need)}
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(3) as pool:
    decoded = list(pool.map(lambda n: cv2.imdecode(np.frombuffer(loaded["jpegs"][n], np.uint8), 1), need.tolist()))
crops = torch.from_numpy(np.stack(decoded)).to(dev); del decoded, loaded
def index(numbers): return torch.tensor([at[int(n)] for n in numbers], device=dev)
crop, flip = index(d["crop"]), torch.from_numpy(d["flip"]).to(dev)
ncrop, nflip, ecrop, eflip = index(d["ncrop"]), torch.from_numpy(d["nflip"]).to(dev), index(d["ecrop"]), torch.from_numpy(d["eflip"]).to(dev)
N = len(crop)
print(fold, N, len(need), f"loaded in {time.time()-begun:.1f} s", flush=True)

def pictures(c, f):
    p = crops.index_select(0, c)
    return torch.where(f[:, None, None, None], p.flip(2), p).permute(0, 3, 1, 2)

@torch.inference_mode()
def answers(net, c, f, mirror=False):
    net.eval()
    out = [net(pictures(c[i:i+256], f[i:i+256] ^ mirror)).float() for i in range(0, len(c), 256)]
    out = torch.cat(out).cpu().numpy().astype(np.float64)
    out = out if out.ndim == 1 else out[:, 0]
    return -out if mirror else out

results = {}
def keep(key, net):
    scale = AnswerScale.fit(answers(net, ncrop, nflip), d["nlabel"].astype(np.float64))
    learnt = answers(net, ecrop, eflip)
    results[key] = {"learnt": learnt.astype(np.float32), "natural": np.asarray(scale.natural(learnt)).astype(np.float32),
                    "mirror": np.asarray(scale.natural((learnt + answers(net, ecrop, eflip, True)) / 2)).astype(np.float32)}
    pickle.dump({"results": results, "recorded": d["elabel"], "crash": d["crash"]}, open(f"{OUT}/{fold}.part", "wb"))
    os.replace(f"{OUT}/{fold}.part", f"{OUT}/{fold}.pkl")

nets = {}
def train(variant, seed, epochs, measure):
    words = variant.split("+")
    names = tuple(n for n in EPOCH_ALTERATIONS if f"no_{n}" not in words)
    light = "seen" not in words
    outputs = 6 if "aux" in words else 1
    torch.manual_seed(seed)
    net = SteeringNetwork(0.5, outputs=outputs, standardized=light); net.outputs = outputs
    net = net.to(dev, memory_format=torch.channels_last)
    avg = AveragedWeights(net, 100); avg.begin()
    opt = Adam(net.parameters(), 1e-4)
    alterations = EpochAlterations(names, seed, 0.2)
    base = d["window"] if "window" in words else d["label"]
    if "taught" in words:
        mean = np.mean([teach[s] for s in teach], 0).astype(np.float32)
        base = (0.5 * base + 0.5 * mean).astype(np.float32)
    weights = torch.tensor([1.0] + [0.2] * 5, device=dev) if outputs > 1 else None
    step, start = 0, time.time()
    for epoch in range(1, epochs + 1):
        net.train()
        order = np.random.default_rng((seed, epoch)).permutation(np.arange(N, dtype=np.uint32)).astype(np.int64)
        labels = alterations.labels(base[order], epoch, order)
        if outputs > 1:
            delta = labels - base[order]
            labels = np.concatenate([labels[:, None], d["aux"][order] + delta[:, None]], 1).astype(np.float32)
        labels = torch.from_numpy(np.ascontiguousarray(labels)).to(dev)
        altered = AlteredOnDevice(alterations.draw(epoch, order, 128, 128), 128, 128, dev)
        oc, of = crop[torch.from_numpy(order).to(dev)], flip[torch.from_numpy(order).to(dev)]
        for a in range(0, N, 256):
            p = crops.index_select(0, oc[a:a+256]); f = of[a:a+256]
            p = torch.where(f[:, None, None, None], p.flip(2), p)
            p = altered.pictures(p, a).permute(0, 3, 1, 2)
            step += 1
            torch.default_generator.manual_seed(seed * 100003 + step)
            if dev.type == "cuda": torch.cuda.default_generators[0].manual_seed(seed * 100003 + step)
            s = training_step(net, opt, p, labels[a:a+256], dtype=DT, micro_batch=256, weights=weights)
            if "adamw" in words:
                with torch.no_grad(): torch._foreach_mul_([q for q in net.parameters() if q.dim() > 1], 1 - 1e-4)
            avg.update(step)
        if epoch in measure: keep((variant, seed, epoch), avg.network)
    print(f"{fold} {variant} {seed} {epochs} epochs {time.time()-start:.1f} s, {time.time()-begun:.0f} s since start, loss {float(s)/len(labels[a:a+256]):.4f}", flush=True)
    return avg.network

teach = {}
jobs = [("base", s, 14, (6, 10, 14)) for s in range(5)]
jobs += [(v, s, 10, (10,)) for v in ("aux", "taught", "window") for s in (0, 1, 2)]
jobs += [(f"no_{n}", 0, 10, (10,)) for n in EPOCH_ALTERATIONS]
jobs += [("adamw", s, 10, (10,)) for s in (0, 1, 2)]
jobs += [(f"no_{n}", s, 10, (10,)) for s in (1, 2) for n in EPOCH_ALTERATIONS]
longest = 0.0
for variant, seed, epochs, measure in jobs:
    if SMALL: epochs, measure = min(epochs, 1), (1,)
    if time.time() - begun + longest * epochs * 1.05 > stop_s:
        print(f"{fold} stops before {variant} {seed}", flush=True); break
    t = time.time()
    # teachers must not be the students' seeds' own: seeds 3 and 4 teach, and 0 to 2 of base by their answers
    net = train(variant, seed, epochs, measure)
    longest = (time.time() - t) / epochs
    if variant == "base": teach[seed] = answers(net, crop, flip)

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
from model.training.training_steps import TrainingSteps
from model.device import Machine
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
    for k in ("crop", "flip", "label", "aux", "window", "asrec"): d[k] = d[k][:SMALL]
need = np.unique(np.concatenate([d["crop"], d["ncrop"], d["ecrop"]]))
at = {int(n): i for i, n in enumerate(need)}
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(3) as pool:
    decoded = list(pool.map(lambda n: cv2.imdecode(np.frombuffer(loaded["jpegs"][n], np.uint8), 1), need.tolist()))
raw = decoded; del loaded
def sized(w, h):
    with ThreadPoolExecutor(3) as pool: return torch.from_numpy(np.stack(list(pool.map(lambda c: cv2.resize(c, (w, h), interpolation=cv2.INTER_LINEAR), raw)))).to(dev)
crops = sized(128, 128); W, H = 128, 128
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
    global crops, W, H
    size = (160, 80) if "wide" in words else (200, 66) if "wide200" in words else (128, 128)
    if (W, H) != size: W, H = size; crops = None; crops = sized(W, H)
    groups = {"no_geometry": ("move", "zoom", "turn"), "no_light": ("contrast", "brightness", "colours"), "no_cover": ("shadow", "box")}
    names = tuple(n for n in names if not any(n in groups[w] for w in words if w in groups))
    light = "seen" not in words
    outputs = 6 if "aux" in words else 1
    torch.manual_seed(seed)
    net = SteeringNetwork(0.5, outputs=outputs, standardized=light); net.outputs = outputs
    if size != (128, 128):
        with torch.no_grad(): n_in = net.features(torch.zeros(1, 3, H, W)).numel()
        net.head[2] = torch.nn.Linear(n_in, 1164)
        torch.nn.init.xavier_uniform_(net.head[2].weight); torch.nn.init.zeros_(net.head[2].bias)
    net = net.to(dev, memory_format=torch.channels_last)
    avg = AveragedWeights(net, 100); avg.begin(net)
    opt = Adam(net.parameters(), 1e-4)
    alterations = EpochAlterations(names, seed, 0.2)
    base = d["window"] if "window" in words else d["asrec"] if "asrec" in words else d["label"]
    if "taught" in words:
        mean = np.mean([teach[s] for s in teach], 0).astype(np.float32)
        base = (0.5 * base + 0.5 * mean).astype(np.float32)
    weights = torch.tensor([1.0] + [0.2] * 5, device=dev) if outputs > 1 else None
    step, start = 0, time.time()
    steps = TrainingSteps(net, opt, Machine(dev, DT, 256), 256, weights, can_record=True)
    for epoch in range(1, epochs + 1):
        net.train()
        order = np.random.default_rng((seed, epoch)).permutation(np.arange(N, dtype=np.uint32)).astype(np.int64)
        labels = alterations.labels(base[order], epoch, order)
        if outputs > 1:
            delta = labels - base[order]
            labels = np.concatenate([labels[:, None], d["aux"][order] + delta[:, None]], 1).astype(np.float32)
        labels = torch.from_numpy(np.ascontiguousarray(labels)).to(dev)
        altered = AlteredOnDevice(alterations.draw(epoch, order, H, W), H, W, dev)
        oc, of = crop[torch.from_numpy(order).to(dev)], flip[torch.from_numpy(order).to(dev)]
        for a in range(0, N, 256):
            p = crops.index_select(0, oc[a:a+256]); f = of[a:a+256]
            p = torch.where(f[:, None, None, None], p.flip(2), p)
            p = altered.pictures(p, a).permute(0, 3, 1, 2)
            step += 1
            torch.default_generator.manual_seed(seed * 100003 + step)
            if dev.type == "cuda": torch.cuda.default_generators[0].manual_seed(seed * 100003 + step)
            s = steps.take(p, labels[a:a+256], len(p))
            if "adamw" in words:
                with torch.no_grad(): torch._foreach_mul_([q for q in net.parameters() if q.dim() > 1], 1 - 1e-4)
            avg.update(net, step)
        if epoch in measure: keep((variant, seed, epoch), avg.network)
    print(f"{fold} {variant} {seed} {epochs} epochs {time.time()-start:.1f} s, {time.time()-begun:.0f} s since start, loss {float(s)/len(labels[a:a+256]):.4f}", flush=True)
    return avg.network

teach = {}
jobs = [(v, s, 10, (10,)) for v in ("base", "wide", "asrec", "adamw", "no_noise", "wide200") for s in (0, 1, 2)]
jobs += [(v, s, 10, (10,)) for s in (0, 1, 2) for v in ("no_cover", "no_geometry", "no_light")]
longest = 0.0
for variant, seed, epochs, measure in jobs:
    if SMALL: epochs, measure = min(epochs, 1), (1,)
    if time.time() - begun + longest * epochs * 1.05 > stop_s:
        print(f"{fold} stops before {variant} {seed}", flush=True); break
    t = time.time()
    # teachers must not be the students' seeds' own: seeds 3 and 4 teach, and 0 to 2 of base by their answers
    net = train(variant, seed, epochs, measure)
    longest = (time.time() - t) / epochs

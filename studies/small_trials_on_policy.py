"""On-policy samples inside recordings: after 10 and 15 of 20 epochs, the network drives the three recordings on warped
pictures. What it sees off the line, with steering that leads back within a second, is a fifth of later batches.

OLD=FOLDER_OF_COMMIT_7b644a35 FOLDER=trials LOGS=sessions python studies/small_trials_on_policy.py onp|long SEEDS

`long`: as many epochs without these samples.
"""
import sys, os, subprocess, time, json
from small_trials import *
def plain(fold):
    name = HERE / "plain" / fold
    if not (name / "samples.parquet").exists():
        build_index([o for o in LOGS if o.stem != fold], name, IndexConfig(validation_share=0.1, balance=False, flip=False, cameras=("center",)))
    table = pq.read_table(name / "samples.parquet")
    out = {}
    for s, r, l, c, sp in zip(table["session"].cast("string").to_pylist(), table["row"].to_pylist(), table["label"].to_pylist(), table["camera"].cast("string").to_pylist(), table["split"].cast("string").to_pylist()):
        if c == "center" and sp == "train": out[s, r] = l
    speed = {}
    for log in LOGS:
        if log.stem == fold: continue
        f = pq.read_table(name / "frames" / f"{log.stem}.parquet")
        for r, v in zip(f["row"].to_pylist(), f["speed_mph"].to_pylist()): speed[log.stem, r] = v * 0.44704
    return out, speed
def drive(net, scale, logs, key, depart=1.5):
    net.eval(); ts = HERE / "nets" / f"{key}.ts"
    net = net.to(memory_format=torch.contiguous_format)
    with torch.inference_mode(): torch.jit.trace(net, torch.zeros(1, 3, 48, 96, dtype=torch.uint8), check_trace=False).save(str(ts))
    net.to(memory_format=torch.channels_last)
    out = HERE / "onp" / f"{key}.npz"; out.parent.mkdir(exist_ok=True)
    subprocess.run([sys.executable, str(Path(__file__).with_name("small_trials_drive.py")), str(ts), f"{scale.scale},{scale.curve},{scale.offset}", str(out), str(depart), *map(str, logs)], check=True, env={**os.environ, "PYTHONPATH": os.environ["OLD"]}, cwd=os.environ["OLD"])
    return np.load(out)
def pool_of(z, labels, speed, fold):
    pics, want = [], []
    for log in LOGS:
        if log.stem == fold: continue
        n = log.stem; y, th, rows = z[n+"/y"], z[n+"/turn"], z[n+"/row"]; crops = z[n+"/crop"]
        for i in range(len(y)):
            l = labels.get((n, int(rows[i])))
            if l is None or abs(y[i]) < 0.15 and abs(th[i]) < 0.026: continue
            d = max(5.0, speed[n, int(rows[i])])
            delta = 2 * (y[i] + d * th[i]) / d**2 * 3.0 / np.tan(np.deg2rad(25))
            pics.append(crops[i]); want.append(np.clip(l + np.clip(delta, -0.6, 0.6), -1, 1))
    return np.stack(pics), np.array(want, np.float32)
def run(variant, fold, seed):
    from dataset.epoch_alterations import EpochAlterations
    labels, speed = plain(fold)
    config = TrainConfig(network="small", seed=seed, threads=1); choice = choose_network(config); picture = chosen_picture(config, choice)
    train_logs = [l for l in LOGS if l.stem != fold]; test_log = [l for l in LOGS if l.stem == fold]
    report = {}
    with Samples(HERE / "indexes" / fold) as samples:
        loader = Loader(samples, samples.rows_of_split("train"), batch=256, seed=seed, threads=1, seen=picture, alter_each_epoch=EPOCH_ALTERATIONS)
        natural = NaturalFrames(samples, 64, 1, picture, keeps_pictures=True)
        torch.manual_seed(seed); net = choice.build().to(memory_format=torch.channels_last)
        avg = AveragedWeights(net, 100); avg.begin(net); opt = Adam(net.parameters(), config.rate); step = 0
        altered = EpochAlterations(EPOCH_ALTERATIONS, seed + 1000, 0.2)
        pools = []
        for epoch in range(1, int(os.environ.get("EPOCHS", 21))):
            net.train(); begun = time.time(); total = n = 0
            for batch in loader.epoch(epoch):
                l = torch.from_numpy(batch.labels); p = batch.pictures
                step += 1
                if pools:
                    rng = np.random.default_rng((seed, step)); allp, alll = pools[-1]
                    ids = rng.integers(0, len(alll), 64); flip = rng.random(64) < 0.5
                    ep, el = allp[ids].copy(), alll[ids].copy()
                    ep[flip] = ep[flip][:, :, ::-1]; el[flip] *= -1
                    numbers = ids.astype(np.int64) * 4 + flip
                    altered.alter(epoch, ep, numbers); el = altered.labels(el, epoch, numbers)
                    p = np.concatenate([p, ep]); l = torch.cat([l, torch.from_numpy(el)])
                pics = as_input(p)
                torch.manual_seed(seed * 100003 + step); opt.zero_grad()
                for a, b in zip(pics.split(64), l.split(64)):
                    loss = ((net(a) - b) ** 2).sum(); (loss / len(l)).backward(); total += float(loss.detach())
                n += len(l); opt.step(); avg.update(net, step)
            print(variant, fold, seed, "epoch", epoch, f"loss {total/n:.4f} {time.time()-begun:.0f} s", flush=True)
            if epoch in (10, 15) and variant == "onp":
                scale = natural.fit(avg.network)
                z = drive(avg.network, scale, train_logs, f"{variant}-{fold}-{seed}-{epoch}")
                new = pool_of(z, labels, speed, fold)
                pools.append(new if not pools else tuple(np.concatenate(x) for x in zip(pools[-1], new)))
                print("pool", len(pools[-1][1]), "label deviation", pools[-1][1].std().round(3), flush=True)
            if epoch in (10, 15, 20):
                scale = natural.fit(avg.network)
                z = drive(avg.network, scale, test_log, f"{variant}-{fold}-{seed}-test{epoch}", 1.5)
                learnt, nat, recorded, crash = answer(avg.network, scale, picture, fold)
                tag = {10: "onp10", 15: f"{variant}15", 20: f"{variant}20"}[epoch]
                np.savez(HERE / "out" / f"{tag}-{fold}-{seed}.npz", learnt=learnt, natural=nat, recorded=recorded, crash=crash, interventions=z[fold+"/interventions"], offset=z[fold+"/offset"])
if __name__ == "__main__":
    for seed in map(int, sys.argv[2].split(",")):
        for l in LOGS:
            lock = HERE / "out" / f"{sys.argv[1]}20-{l.stem}-{seed}.lock"
            try: os.close(os.open(lock, os.O_CREAT | os.O_EXCL))
            except FileExistsError: continue
            run(sys.argv[1], l.stem, seed)

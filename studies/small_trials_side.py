"""side.py: each session's side correction, by networks that saw only the centre camera (moved pictures tell how to return)."""
from small_trials import *
res = {}
for log in LOGS:
    fold = log.stem
    index = HERE / "centre" / fold
    if not (index / "samples.parquet").exists(): build_index([o for o in LOGS if o != log], index, IndexConfig(validation_share=0.1, cameras=("center",)))
    config = TrainConfig(network="small", seed=0, threads=1); choice = choose_network(config); picture = chosen_picture(config, choice)
    with Samples(index) as samples:
        loader = Loader(samples, samples.rows_of_split("train"), batch=256, seed=0, threads=1, seen=picture, alter_each_epoch=EPOCH_ALTERATIONS)
        torch.manual_seed(0); net = choice.build().to(memory_format=torch.channels_last); opt = Adam(net.parameters(), config.rate)
        for epoch in range(1, 13):
            net.train()
            for batch in loader.epoch(epoch):
                l = torch.from_numpy(batch.labels); opt.zero_grad()
                for p, q in zip(as_input(batch.pictures).split(64), l.split(64)): (((net(p) - q) ** 2).sum() / len(l)).backward()
                opt.step()
        scale = NaturalFrames(samples, 64, 1, picture, keeps_pictures=True).fit(net)
    net.eval(); res[fold] = {}
    for o in LOGS:
        if o == log: continue
        plain = HERE / "three" / o.stem
        if not (plain / "samples.parquet").exists(): build_index([o], plain, IndexConfig(validation_share=0.01, balance=False, flip=False, labels="as-recorded"))
        with Samples(plain) as samples:
            rows = samples.rows_of_split("train"); table = samples.of_split("train", None)
            loader = Loader(samples, rows, batch=256, threads=1, seen=picture, budget_bytes=0)
            learnt, _ = predict(net, loader); cam = np.asarray(table["camera"].cast("string"))
            import re
            mean = {c: float(np.median(learnt[cam == c])) for c in ("left", "center", "right")}
            c = (mean["left"] - mean["right"]) / 2
            res[fold][o.stem] = float(np.clip(c, 0.05, 0.5)); print(fold, o.stem, {k: round(v, 3) for k, v in mean.items()}, round(c, 3), flush=True)
(HERE / "side.json").write_text(json.dumps(res))

"""pre.py FOLD SEED: features learn which picture is mirrored, from all four recordings without labels."""
import sys, time
from small_trials import *
def main():
    index = HERE / "unlabelled"
    if not (index / "samples.parquet").exists(): build_index(LOGS, index, IndexConfig(validation_share=0.01, balance=False, flip=True, labels="as-recorded"))
    seed = int(sys.argv[1]); out = HERE / "nets" / f"pretrained-all-{seed}.pt"
    if out.exists(): return
    config = TrainConfig(network="small", seed=seed, threads=1); choice = choose_network(config); picture = chosen_picture(config, choice)
    with Samples(index) as samples:
        table = samples.of_split("train", None); flip = np.asarray(table["flip"]).astype(np.float32)
        loader = Loader(samples, samples.rows_of_split("train"), batch=256, seed=seed, threads=1, seen=picture, alter_each_epoch=EPOCH_ALTERATIONS)
        torch.manual_seed(seed); net = choice.build().to(memory_format=torch.channels_last); opt = Adam(net.parameters(), config.rate)
        print(len(flip), "pictures", flip.mean())
        for epoch in range(1, 6):
            net.train(); total = n = right = 0; begun = time.time()
            for part, batch in zip(loader.parts(epoch), loader.epoch(epoch), strict=True):
                l = torch.from_numpy(flip[part]); opt.zero_grad(); pics = as_input(batch.pictures)
                for p, q in zip(pics.split(64), l.split(64)):
                    o = net(p); loss = torch.nn.functional.binary_cross_entropy_with_logits(o, q, reduction="sum")
                    (loss / len(l)).backward(); total += float(loss.detach()); right += int(((o > 0) == (q > 0.5)).sum())
                n += len(l); opt.step()
            print("pre", seed, epoch, f"{total/n:.4f} right {right/n:.3f} {time.time()-begun:.0f} s", flush=True)
    torch.save(net.features.state_dict(), out)
main()

"""Trials of settings of a pass that `bc-train` does not have: python studies/speedrun_trials.py NAME SEED INDEX RUNS
[warm=0.1 decay=linear init=he huber=0.2 beta2=0.95 wd=0.1 dropout=0.2 alter=none ...]"""
import json, sys, time, functools, math
from dataclasses import replace
from pathlib import Path
import torch
from torch import nn
from torch.nn import functional as F
import model.training.loop as loop_module
from model.training.loop import TrainingLoop
import model.training.step as step
import model.adam as adam_module
from model import TrainConfig, train
from model.evaluation.evaluate import evaluate
name, seed, index, runs = sys.argv[1], int(sys.argv[2]), sys.argv[3], Path(sys.argv[4])
opt = dict(a.split('=') for a in sys.argv[5:])
g = lambda k, d: type(d)(opt.get(k, d))
batch, rate = g('batch', 64), g('rate', 1e-3)
warm, decay = g('warm', 0.0), opt.get('decay', 'const')
end = g('end', 0.0)
old = TrainingLoop._train_batch
def new(self, b, pictures, labels):
    total = self.loader.batches * self.config.epochs
    at = (self.position.epoch - 1) * self.loader.batches + b - 0.5
    t = at / total
    if warm and t < warm: f = t / warm
    else:
        u = (t - warm) / (1 - warm)
        f = {'const': 1, 'linear': 1 - u, 'cos': (1 + math.cos(math.pi * u)) / 2, 'late': min(1, 2*(1-u))}[decay]
        f = end + (1 - end) * f
    self.optimizer.rate = rate * f
    return old(self, b, pictures, labels)
TrainingLoop._train_batch = new
if 'huber' in opt:
    d = float(opt['huber'])
    def loss(predicted, labels, weights): return F.huber_loss(predicted, labels, reduction='sum', delta=d) / d * 1.0
    step._squared_error = loss
if 'beta2' in opt or 'beta1' in opt or 'wd' in opt or 'eps' in opt:
    a = adam_module.adam
    def wrapped(*args, **kw):
        kw['beta2'] = g('beta2', 0.999); kw['beta1'] = g('beta1', 0.9); kw['eps'] = g('eps', 1e-8)
        if 'wd' in opt:
            with torch.no_grad(): torch._foreach_mul_(args[0], 1 - kw['lr'] * float(opt['wd']))
        return a(*args, **kw)
    adam_module.adam = wrapped
if 'init' in opt:
    import model.network.original as o
    def he(network):
        layers = [l for l in network.modules() if isinstance(l, (nn.Conv2d, nn.Linear))]
        for l in layers:
            if 'he' in opt['init']: nn.init.kaiming_normal_(l.weight, nonlinearity='relu')
            else: nn.init.xavier_uniform_(l.weight)
            nn.init.zeros_(l.bias)
        if 'zero' in opt['init']: nn.init.zeros_(layers[-1].weight)
    o.glorot_weights = he
if 'ema1' in opt:
    import model.training.averaged_weights as aw
    aw._FIRST_STEPS = float(opt['ema1'])
config = TrainConfig(batch=batch, rate=rate, epochs=g('epochs', 1), seed=seed, threads=g('threads', 1), average_steps=g('avg', 100), dropout=g('dropout', 0.5),
   alter_each_epoch=tuple(opt.get('alter','all').split('+')))
run = runs / f'{name}-{seed}'
if not run.exists():
    t0 = time.time()
    tr = train(index, run, config, show_progress=False)
    sec = time.time() - t0
    ep = tr.epochs[-1]; m = ep.measures
    out = dict(name=name, seed=seed, opt=opt, seconds=round(sec,1), epoch_s=round(ep.seconds,1), rmse=round(m.network.rmse_deg,3), turn=round(m.network.turning_mae_deg,3), corr=round(m.network.correlation,4), de=round(m.driving_error,3), lde=round(ep.learnt_driving_error,3), loss=round(ep.training_loss,4))
    print(json.dumps(out), flush=True)

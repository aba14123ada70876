"""The table of small_trials.py: RMSE and MAE on turns as shares of the mean's, and the correlation."""
import numpy as np, glob, sys, re, collections
import os
HERE=os.environ["FOLDER"]+"/out/"
from pathlib import Path
FOLDS=["jungle_linux","lake_14hz","lake_windows","mountain_linux"]
def m(p, r):
    mean=np.full(len(r), r.mean()); turn=np.abs(r)>0.05  # as in metrics? close
    return np.sqrt(np.mean((p-r)**2))/np.sqrt(np.mean((mean-r)**2)), np.abs(p-r)[turn].mean()/np.abs(mean-r)[turn].mean(), np.corrcoef(p,r)[0,1]
def load(v,f,s):
    z=np.load(f"{HERE}{v}-{f}-{s}.npz"); k=~z["crash"]; return z["natural"][k], z["recorded"][k]
d=collections.defaultdict(lambda: collections.defaultdict(dict))
for p in glob.glob(HERE+"*.npz"):
    v,f,s=re.match(r"(.+)-([a-z_0-9]+)-(\d+)$",Path(p).stem).groups(); d[v][int(s)][f]=1
for v in sorted(d):
    rows=[]
    for s in sorted(d[v]):
        if len(d[v][s])==4:
            rows.append((s,np.mean([m(*load(v,f,s)) for f in FOLDS],0)))
        else: 
            fs=[f for f in FOLDS if f in d[v][s]]; print("  part",v,s,{f:np.round(m(*load(v,f,s)),3).tolist() for f in fs})
    for s,r in rows: print(f"{v:12s} {s:3d} {r.round(3)}")
    if rows: print(f"{v:12s} mean {np.mean([r for _,r in rows],0).round(3)}  ({len(rows)} seeds)")
    if len(rows)>1:
        e=[]
        for f in FOLDS:
            ps=[load(v,f,s) for s,_ in rows]; e.append(m(np.mean([p for p,_ in ps],0), ps[0][1]))
        print(f"{v:12s} ensemble of {len(rows)}: {np.mean(e,0).round(3)}")

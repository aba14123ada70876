"""python studies/recipe_trials_table.py FOLDER"""
import sys
import pickle, numpy as np, collections
FOLDS=["jungle_linux","lake_14hz","lake_windows","mountain_linux"]
P={f:pickle.load(open(f"{sys.argv[1]}/{f}.pkl","rb")) for f in FOLDS}
def m(p,r):
    mean=np.full(len(r),r.mean()); t=np.abs(r)>0.05
    return np.array([np.sqrt(np.mean((p-r)**2))/np.sqrt(np.mean((mean-r)**2)), np.abs(p-r)[t].mean()/np.abs(mean-r)[t].mean(), np.corrcoef(p,r)[0,1]])
def get(f,k,what="natural"):
    k0=~P[f]["crash"]; return P[f]["results"][k][what][k0].astype(float), P[f]["recorded"][k0].astype(float)
keys=collections.defaultdict(dict)
for f in FOLDS:
    for (v,s,e) in P[f]["results"]: keys[v,e].setdefault(s,set()).add(f)
for (v,e),by in sorted(keys.items()):
    full=[s for s in sorted(by) if len(by[s])==4]
    for what in ("natural","mirror"):
        rows=[np.mean([m(*get(f,(v,s,e),what)) for f in FOLDS],0) for s in full]
        if not rows: print(v,e,"incomplete",{s:len(b) for s,b in by.items()}); break
        print(f"{v:8s} {e:3d} {what:8s} seeds {full} mean {np.mean(rows,0).round(3)} each RMSE {[round(r[0],3) for r in rows]} corr {[round(r[2],3) for r in rows]}")
    if len(full)>1:
        ens=np.mean([m(np.mean([get(f,(v,s,e))[0] for s in full],0), get(f,(v,full[0],e))[1]) for f in FOLDS],0)
        print(f"{'':12s} ensemble of {len(full)}: {ens.round(3)}")

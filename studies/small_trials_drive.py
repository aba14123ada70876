"""Drives logs on warped pictures with the code of commit 7b644a35, and keeps what the network saw."""
import sys
from pathlib import Path
import numpy as np, torch, cv2
torch.set_num_threads(1); cv2.setNumThreads(1)
import dataset.loader.log_views as lv
from model.evaluation.recorded_drive import drive_recording
lv.preprocess = lambda picture: picture
def crop(p):
    h = p.shape[0]
    return cv2.resize(p[round(h*50/160):h-round(h*20/160)], (96, 48), interpolation=cv2.INTER_LINEAR)
net = torch.jit.load(sys.argv[1]); s, c, o = map(float, sys.argv[2].split(",")); out = {}; 
for log in sys.argv[5:]:
    seen = []
    @torch.inference_mode()
    def predict(p):
        k = crop(p); seen.append(k)
        x = float(net(torch.from_numpy(k).permute(2, 0, 1)[None])[0])
        return s * x + c * x * abs(x) + o
    d = drive_recording(predict, Path(log), departure_m=float(sys.argv[4]), car="udacity")
    name = Path(log).stem
    print(name, "rows", d.rows, "interventions", d.interventions, "autonomy", round(d.autonomy_percent,1), "offset", round(d.mean_offset_m,3), "s", round(d.driven_s), flush=True)
    out[name+"/crop"] = np.stack(seen); out[name+"/row"] = np.array([m.row for m in d.moments]); out[name+"/y"] = np.array([m.left_m for m in d.moments]); out[name+"/turn"] = np.array([m.turn_rad for m in d.moments])
    out[name+"/interventions"] = d.interventions; out[name+"/offset"] = d.mean_offset_m
np.savez(sys.argv[3], **out)

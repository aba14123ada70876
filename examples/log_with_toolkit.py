"""Reads run.mcap as Arrow tables, and its sharpest left turn as a picture."""

import cv2
import numpy as np

from recorder import Log

with Log("run.mcap") as log:
    frames = log.frames()  # pyarrow.Table: row, camera, log_time_ns, offset, length, chunk
    vehicle = log.vehicle()  # pyarrow.Table: row, log_time_ns, steering, throttle, brake, speed_mph
    steering = vehicle["steering"].to_numpy()
    sharpest = vehicle["row"][int(steering.argmin())].as_py()  # left is negative
    jpeg = log.picture(sharpest, "center")
    print(log.metadata["source"], log.counts)

picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)  # BGR
print(f"{len(vehicle)} rows, {len(frames)} pictures, mean steering {steering.mean():+.4f}")
print(f"sharpest left turn: row {sharpest}, steering {steering.min():+.4f}, picture {np.asarray(picture).shape}")

samples = frames.join(vehicle.drop_columns(["log_time_ns"]), "row")  # a picture and its label in each row
print(samples.num_rows, "samples")

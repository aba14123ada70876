"""A network drives an unseen road of the built-in simulator, as a Gymnasium environment."""

import gymnasium
import numpy as np

from model import load_pilot

env = gymnasium.make("simulator:bc/Random-v0", seed=7)
pilot = load_pilot("runs/first")
observation, info = env.reset(options={"start_m": 0.0})
road_m, steps, is_over = 0.0, 0, False
while not is_over:
    bgr = np.ascontiguousarray(observation["center"][..., ::-1])  # as the network has learnt
    steering = pilot.predict(pilot.crop(bgr))
    throttle = 0.1 * (10.0 - observation["speed_mph"][0])  # at 10 mph
    action = np.array([steering, throttle], np.float32)
    observation, reward, terminated, truncated, info = env.step(action)
    road_m += float(reward)
    steps += 1
    is_over = terminated or truncated
print(f"{road_m:.0f} m in {steps} steps, {info['lap']:.2f} laps, success: {info['success']}")

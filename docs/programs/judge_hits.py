# Judge hits that were computed elsewhere, along any rays.
import numpy as np

import caster
import mitsuba_ref

rays = np.zeros((4, 8), np.float32)  # o (3), d (3), t_min, t_max
rays[:, :3], rays[:, 3:6], rays[:, 7] = (0, 0, 9), [(x, 0, -9) for x in range(4)], np.inf
scene = caster.load_scene("scene.toml")
hits = caster.cast(scene, rays[:, :3], rays[:, 3:6])
print(mitsuba_ref.judge_hits(scene, rays, {"t": hits.t}, precision="float32"))

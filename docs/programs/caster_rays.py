# Rays of one's own: one origin, many directions.
import numpy as np

import caster

scene = caster.load_scene("scenes/teapot.toml")
directions = np.random.default_rng(1).normal(size=(1000, 3))
hits = caster.cast(scene, (0.0, 0.0, 1.0), directions, t_min=0.01)
print(hits, hits.t[hits.hit].min(), hits.position[hits.hit].mean(axis=0), hits.prim_id[:4])
covered = caster.occluded(scene, hits.position[hits.hit], (0.0, 0.0, 1.0), t_min=1e-6)
print(f"{covered.sum()} of {len(covered)} points have something above them")

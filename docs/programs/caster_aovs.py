# AOVs as NumPy arrays.
import numpy as np

import caster

scene = caster.load_scene("scenes/teapot.toml").with_film(width=320, height=240)
aovs = caster.render(scene, aovs=("depth", "normal"))
print(aovs)
print(f"nearest {aovs.depth.min():.3f}, farthest {aovs.depth[aovs.hit].max():.3f} scene units")
np.savez("teapot.npz", hit=aovs.hit, depth=aovs.depth, normal=aovs.normal)

# Look at every failing pixel, and at both images.
from mine import trace

import mitsuba_ref

verdict = mitsuba_ref.validate("scene.toml", candidate=trace, precision="float64")
for scene in verdict.scenes:
    print(scene.name, scene.counts, scene.classes.shape)
    for pixel in scene.failing_pixels():
        print(pixel.x, pixel.y, pixel.verdict, pixel.check, pixel.subject, pixel.reference, pixel.bound)
    depth = {who: image["depth"][scene.images["ours"].hit] for who, image in scene.images.items()}
    print((depth["ours"] - depth["reference"]).std())

# Another camera, or the same one from elsewhere.
import caster

scene = caster.load_scene("scenes/teapot.toml")
nearer = scene.with_camera(eye=(2.0, -5.0, 3.0))
around = scene.with_camera(caster.Fisheye(eye=(2.0, -5.0, 3.0), look_at=(0.0, 0.0, 1.0), fov=200.0))
for view in (scene, nearer, around):
    print(view, caster.render(view, aovs=("depth",)))

# Compare two images: EXR files, or arrays.
import caster
import mitsuba_ref

scene = caster.load_scene("scene.toml")
ours = caster.render(scene, aovs=("depth", "normal"))
reference, versions = mitsuba_ref.render_reference(scene, aovs=("depth", "normal"))
allowed = mitsuba_ref.Tolerances(max_pixels=5)  # on edges, rounding allows two answers
result = mitsuba_ref.compare_exr(ours, reference, tolerances=allowed)
print(result, result.ok, result.differing_pixels)
print(mitsuba_ref.compare_exr("ours.exr", {"depth": ours["depth"]}, tolerances=allowed))

import caster

scenes = {}


def trace(v, f, o, d, t_min, t_max):
    key = v.tobytes(), f.tobytes()
    if key not in scenes:
        scenes.clear()
        mesh = {"type": "mesh", "vertices": v.tolist(), "faces": f.tolist(), "face_normals": True}
        camera = {"type": "ray", "origin": [0, 0, 0], "direction": [0, 0, 1]}
        scenes[key] = caster.Scene.model_validate({"camera": camera, "shape": [mesh]})
    hits = caster.cast(scenes[key], o, d, t_min=t_min, t_max=t_max)
    return hits.t, hits.normal

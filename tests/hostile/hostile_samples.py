"""Valid files of every kind that the product reads, and the command lines that read each.

A command line names its file FILE. Folders beside it: in/ holds the samples, out/ what an earlier run left; all paths
are relative to the folder that both are in.
"""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ply_files import ply_mesh

ROOT = Path(__file__).resolve().parents[2]
HEAD = """[film]
width = 8
height = 6

[camera]
type = "pinhole"
eye = [0.4, 0.7, 4.2]
look_at = [0.1, 0, 0]
fov = 38.5

[[light]]
type = "point"
position = [2.71, 3.14, 3.57]
intensity = [55, 52, 47]

"""
SPHERE = """[material.red]
reflectance = [0.62, 0.14, 0.11]

[[shape]]
type = "sphere"
name = "ball"
material = "red"
center = [0.137, -0.071, 0.019]
radius = 1.173

[[shape]]
type = "triangle"
vertices = [[-1, 0, 1], [1, 0, 1], [0, 1, 1.5]]
to_world = [{ rotate = { axis = [0, 0, 1], degrees = 30 } }, { translate = [0.1, 0, 0] }]
"""
COURSE = """PerspectiveCamera { center 0 0 10 direction 0 0 -1 up 0 1 0 angle 30 }
Lights { numLights 1 DirectionalLight { direction 0 0 -2 color 1 0.5 0 } }
Background { color 0.2 0 0.6 ambientLight 0.1 0.1 0.1 }
Materials { numMaterials 2
  PhongMaterial { diffuseColor 1 0 0 specularColor 1 1 1 exponent 20 }
  Material { diffuseColor 0 1 0 }
}
Group { numObjects 3 MaterialIndex 0
  Sphere { center 1 2 3 radius 0.5 }
  MaterialIndex 1 TriangleMesh { obj_file mesh.obj }
  Transform { Translate 1 2 3 Scale 1 1 2 Group { numObjects 1 Plane { normal 0 2 0 offset -4 } } }
}
"""
MITSUBA = """<scene version="3.0.0">
<default name="spp" value="1"/>
<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0.4, 0.7, 4.2" target="0.1, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film>
<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler></sensor>
<bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.6, 0.1, 0.1"/></bsdf>
<emitter type="point"><point name="position" value="2.7, 3.1, 3.6"/><rgb name="intensity" value="55, 52, 47"/></emitter>
<shape type="sphere"><float name="radius" value="1.2"/><ref id="red"/></shape>
<shape type="obj"><string name="filename" value="mesh.obj"/>
<transform name="to_world"><scale value="2"/><translate x="1" y="2" z="3"/></transform></shape>
</scene>
"""
OBJ = """# a bent square
o one
v -1 -1 0
v 1 -1 1e-1
v 1 1 0
v -1.0 1.0 0.25
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
usemtl x
f 1/1/1 2/2/1 3/3/1 4/1/1
f -1 -2 \\
-3
"""
VERTICES = [(-1.0, -1.0, 0.0), (1.0, -1.0, 0.1), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.25)]
KEPT = """# Found by mitsuba-ref fuzz --seed 0 --examples 41..41: there is a hit by exact arithmetic, ours is a miss.
# fuzz: missed t_min=0.0 t_max=inf
"""
CAMPAIGN = """seeds = [1]

[[job]]
type = "fuzz"
families = ["edges"]
examples = 1
judge_every = 0
"""
COPY = "sh -c 'cp in/answer{0} $0' {{{1}}}"  # a candidate that answers with a file


def read_by(*lines: str) -> tuple[str, ...]:
    return lines


# File -> command lines. Those of `costly` start Mitsuba where the file turns out to be valid.
READERS: dict[str, tuple[str, ...]] = {
    "in/scene.toml": read_by(
        "caster check FILE",
        "caster render FILE -o out/o.exr --explain",
        "caster probe FILE 3 3 --json",
        "mitsuba-ref rays FILE -o out/r.npz --kind features --count 20",
        "mitsuba-ref export FILE -o out/x",
        "mitsuba-ref compare in/image.exr in/other.exr --scene FILE",
        "mitsuba-ref render FILE -o out/o.exr",
        "mitsuba-ref validate FILE --out out/v --json out/v.json --junit out/v.xml --summary-md out/v.md",
        "mitsuba-ref probe FILE 3 3 --save out/ray.toml",
        "mitsuba-ref judge --scene FILE --rays in/rays.npz --hits in/hits.npz --out out/j",
        "mitsuba-ref judge --scene FILE --rays in/rays.npz --spawned in/rays.npz",
        "mitsuba-ref versions FILE --mitsuba in/no-python",
    ),
    "in/scene.json": read_by(
        "caster check FILE", "caster render FILE -o out/o.exr", "caster doctor --warm FILE", "mitsuba-ref validate FILE"
    ),
    "in/meshes.toml": read_by("caster check FILE", "caster check FILE --mesh-dir in"),
    "in/mesh.obj": read_by(
        "mitsuba-ref bench --list in/mesh.obj",
        "caster check in/obj.toml",
        "caster render in/obj.toml -o out/o.exr",
        "mitsuba-ref judge --scene FILE --rays in/rays.npz --hits in/hits.npz",
        "mitsuba-ref validate in/obj.toml --out out/v",
        "mitsuba-ref import in/mitsuba.xml -o out/i.toml",
    ),
    "in/ascii.ply": read_by("caster check in/ascii.toml", "mitsuba-ref export in/ascii.toml -o out/x"),
    "in/little.ply": read_by("caster check in/little.toml", "mitsuba-ref validate in/little.toml"),
    "in/big.ply": read_by(
        "caster check in/big.toml", "mitsuba-ref rays in/big.toml -o out/r.npz --kind features --count 9"
    ),
    "in/course.txt": read_by(
        "caster 6837 -input FILE -size 9 7 -output out/o.png -depth 8 12 out/d.tga -normals out/n.png",
        "mitsuba-ref import FILE -o out/i.toml --size 9 7",
    ),
    "in/mitsuba.xml": read_by(
        "mitsuba-ref import FILE -o out/i.toml -D spp=4", "mitsuba-ref import FILE -o out/i.toml"
    ),
    "in/image.exr": read_by(
        "caster info FILE --json",
        "caster info FILE",
        "caster preview FILE -o out/o.png",
        "mitsuba-ref compare FILE in/other.exr --html out/d",
        "mitsuba-ref compare in/other.exr FILE --json",
        "mitsuba-ref validate in/scene.toml --candidate FILE",
    ),
    "in/foreign.exr": read_by(
        "mitsuba-ref compare in/image.exr FILE --map depth=depth.Z --depth distance --miss 0 --json",
        "caster preview FILE -o out/o.png",
    ),
    "in/answer.exr": read_by(
        f'mitsuba-ref validate in/scene.toml --candidate "{COPY.format(".exr", "exr")} {{toml}}"',
        f'mitsuba-ref probe in/scene.toml 3 3 --candidate "{COPY.format(".exr", "exr")} {{toml}}"',
    ),
    "in/answer.raw": read_by(
        f'mitsuba-ref validate in/scene.toml --out out/v --candidate "{COPY.format(".raw", "hits")} {{rays}}"',
        f'mitsuba-ref probe in/scene.toml 3 3 --candidate "{COPY.format(".raw", "hits")} {{rays}}"',
    ),
    "in/rays.npz": read_by(
        "mitsuba-ref judge --scene in/scene.toml --rays FILE --hits in/hits.npz --out out/j --html out/h"
    ),
    "in/hits.npz": read_by(
        "mitsuba-ref judge --scene in/scene.toml --rays in/rays.npz --hits FILE --row 3 --precision float32"
    ),
    "in/expected.toml": read_by(
        f'mitsuba-ref validate in/scene.toml --candidate "{COPY.format(".raw", "hits")} {{rays}}" --expected FILE'
    ),
    "in/shards/verdict.json": read_by(
        "mitsuba-ref merge FILE --json out/m.json --junit out/m.xml --summary-md out/m.md",
        "mitsuba-ref merge in/shards --json out/m.json",
        "mitsuba-ref merge FILE FILE",
    ),
    "out/verdict.json": read_by("mitsuba-ref validate in/scene.toml --out out"),
    "out/scene.ours.exr": read_by("mitsuba-ref validate in/scene.toml --out out --html out/h"),
    "in/references/scene.exr": read_by("mitsuba-ref compare in/references in/references --json"),
    "in/campaign.toml": read_by("mitsuba-ref campaign FILE --history out/h.sqlite -j 1 --json out/c.json"),
    "in/campaign.history.sqlite": read_by("mitsuba-ref campaign FILE --html out/c.html --json out/c.json"),
    "in/kept.toml": read_by("mitsuba-ref fuzz --replay FILE", "mitsuba-ref fuzz --replay in/kept"),
}

# Commands without an input file: their options alone are hostile.
WITHOUT_FILES = (
    "caster schema",
    "caster doctor",
    "mitsuba-ref doctor",
    "mitsuba-ref schema verdict",
    "mitsuba-ref init c out/start",
    "mitsuba-ref docs jit",
    "mitsuba-ref stress --list --json out/s.json",
    "mitsuba-ref stress tangency --rays 2 --json out/s.json",
    "mitsuba-ref bench --list",
    "mitsuba-ref fuzz --examples 2 --judge-every 0 --out out/f --keep 1",
    "mitsuba-ref fuzz --rays 100 --examples 1 --judge-every 0 --out out/f",
)


def write_samples(folder: Path, run: Callable[[str], int]) -> None:
    """Write all files of READERS below a folder. run: a command line in that folder, its exit code."""
    source = folder / "in"
    for each in (source, folder / "out", source / "shards", source / "kept"):
        each.mkdir(parents=True)
    files = {
        "scene.toml": HEAD + SPHERE,
        "course.txt": COURSE,
        "mitsuba.xml": MITSUBA,
        "mesh.obj": OBJ,
        "kept.toml": KEPT + HEAD + SPHERE,
        "campaign.toml": CAMPAIGN,
    }
    shape = '[[shape]]\ntype = "mesh"\nname = "m{0}"\nfile = "{0}"\n'
    meshes = {"obj": "mesh.obj", "ascii": "ascii.ply", "little": "little.ply", "big": "big.ply"}
    files |= {f"{name}.toml": HEAD + shape.format(mesh) for name, mesh in meshes.items()}
    files["meshes.toml"] = HEAD + "".join(map(shape.format, meshes.values()))
    for name, text in files.items():
        (source / name).write_text(text)
    (source / "kept" / "a.toml").write_text(files["kept.toml"])
    for name, encoding in (("ascii", "ascii"), ("little", "binary_little_endian"), ("big", "binary_big_endian")):
        (source / f"{name}.ply").write_bytes(
            ply_mesh(encoding, VERTICES, [(0, 1, 2, 3), (0, 1, 2)], extra=["comment c"])
        )

    def succeed(line: str) -> None:
        assert run(line) == 0, line

    succeed("caster render in/scene.toml -o in/image.exr")
    succeed("caster render in/scene.toml -o in/foreign.exr --aov depth,normal")
    succeed("mitsuba-ref render in/scene.toml -o in/other.exr")
    (source / "references").mkdir()
    (source / "references/scene.exr").write_bytes((source / "other.exr").read_bytes())
    succeed("mitsuba-ref validate in/scene.toml --out out")
    succeed("mitsuba-ref rays in/scene.toml -o in/rays.npz")
    succeed("mitsuba-ref campaign in/campaign.toml")
    import caster

    scene = caster.load_scene(source / "scene.toml")
    (source / "scene.json").write_text(json.dumps(tomllib.loads(HEAD + SPHERE)))
    with np.load(source / "rays.npz") as stored:
        rows = stored["rays"]
    hits = caster.cast(scene, rows[:, :3].astype(float), rows[:, 3:6].astype(float))
    n = np.where(np.isfinite(hits.t)[:, None], hits.normal, 0.0)
    t = hits.t
    np.savez(source / "hits.npz", t=t.astype("f4"), n=n.astype("f4"))
    (source / "expected.toml").write_text('[[failure]]\nscene = "scene"\nchecks = ["depth"]\npixels = 3\nwhy = "x"\n')
    (source / "answer.raw").write_bytes(np.column_stack([t, n]).astype("<f4").tobytes())
    (source / "answer.exr").write_bytes((source / "image.exr").read_bytes())
    verdict = (folder / "out" / "verdict.json").read_bytes()
    (source / "shards" / "verdict.json").write_bytes(verdict)

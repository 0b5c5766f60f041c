"""`mitsuba-ref render`, `export` and `import`: scenes to Mitsuba, and from its XML or files of MIT 6.837."""

import os
from argparse import Namespace
from pathlib import Path

from caster.classroom.course_files import load_course_scene
from caster.classroom.course_images import with_window_behind_scene
from caster.cli.shared_arguments import AOV_NAMES, check_exr_suffix, check_film_size, comma_separated
from caster.description.errors import SceneError, suggestion
from caster.image.channels import write_render
from caster.scene.export import to_toml
from caster.scene.model import Scene
from caster.scene.textures import Bitmap
from caster.shapes import Mesh
from caster.system.atomic_files import check_folder, write_bytes, write_text
from caster.system.process import DIFFERENCES, OK
from caster.system.terminal import printable
from mitsuba_ref.cli.options import load_scene_or_original, opening_of
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import MitsubaError
from mitsuba_ref.reference.original_files import ImportedScene, import_xml
from mitsuba_ref.reference.rendering import REFERENCE_AOVS, render_reference
from mitsuba_ref.reference.shared_input import export_scene, packed_float32
from mitsuba_ref.report.output import plural, print_lines
from mitsuba_ref.scene_xml.elements import ply_bytes, safe_name
from mitsuba_ref.subjects.subject import scene_as_traced

COURSE_FILM = (256, 256)  # pixels; a scene text of the course has no film


def run_render(args: Namespace) -> int:
    """Render with Mitsuba and write the file; 1 when Mitsuba ends without an answer."""
    check_exr_suffix(args.output)
    scene, names = load_scene_or_original(args), tuple(comma_separated(args.aov))
    for name in names:
        if name not in REFERENCE_AOVS:
            raise SceneError(f"--aov {name!r}: unknown{suggestion(name, REFERENCE_AOVS)}; known are {AOV_NAMES}")
    variants.require_variants()
    try:
        images, versions = render_reference(scene, names, timeout=args.timeout)
    except MitsubaError as crash:
        print_lines(f"{args.scene}: {crash}")
        return DIFFERENCES
    more = {f"caster/reference/{name}": version for name, version in versions.items()}
    write_render(args.output, scene, [images], args.scene, more)
    height, width = images.hit.shape
    print(f"{args.output}: {width} x {height} pixels, {int(images.hit.sum())} hit; {', '.join(names)}")
    print_lines(", ".join(f"{name} {version}" for name, version in versions.items()))
    return OK


def run_import(args: Namespace) -> int:
    """Convert a scene, and list its parts that were left out. Raises SceneError, FileMissing, OutputError."""
    suffix = Path(args.file).suffix.lower()
    if Path(args.output).suffix.lower() != ".toml":
        raise SceneError(f"-o {args.output}: expected a name that ends in .toml")
    if suffix not in (".xml", ".txt"):
        raise SceneError(f"{args.file}: expected Mitsuba's .xml, or .txt of MIT 6.837")
    if suffix == ".xml":
        parameters, sensor, _ = opening_of(args)
        found = import_xml(args.file, parameters, args.mesh_dir, sensor=sensor, size=args.size)
    else:
        found = from_course(args)
    target = Path(args.output).resolve()
    folder, scene = target.parent, with_files(found.scene, target.with_suffix(""))
    head = [f"{Path(args.file).name}, by `mitsuba-ref import`.", *found.left_out]
    comment = "".join(f"# {printable(line, keep='')}\n" for line in head)
    write_text(args.output, comment + to_toml(scene, folder))
    for line in found.left_out:
        print_lines(line)
    print(f"{args.output}: {plural(len(found.scene.shapes), 'shape')}, {len(found.left_out)} left out or changed")
    folders = {Path(file).parent for file in files_of(found.scene)}
    for outside in sorted(str(each) for each in folders if not each.is_relative_to(folder)):
        print_lines(f"note: meshes are in {outside}: add --mesh-dir {outside} where the scene is used")
    return OK


def with_files(scene: Scene, folder: Path) -> Scene:
    """The scene with meshes of arrays as PLY files, and bitmaps of 8 bits a channel as PNG files, in a folder.

    Raises OutputError.
    """
    shapes, materials, packed = list(scene.shapes), dict(scene.materials), packed_float32(scene)
    for i, shape in enumerate(shapes):
        if isinstance(shape, Mesh) and shape.file is None:
            check_folder(folder)
            path = folder / f"{i:04d}-{safe_name(shape.name)}.ply"
            write_bytes(path, ply_bytes(packed.parts[i]))
            shapes[i] = shape.model_copy(update=dict.fromkeys(Mesh.ARRAYS) | {"file": str(path), "to_world": ()})
    for i, (name, material) in enumerate(materials.items()):
        texture = material.texture
        if isinstance(texture, Bitmap) and texture.file is None and (png := texture.as_png()):
            check_folder(folder)
            path = folder / f"{i:04d}-{safe_name(name)}.png"
            content, raw = png
            write_bytes(path, content)
            change = {"file": str(path), "data": None, "raw": raw}
            materials[name] = material.model_copy(update={"reflectance": texture.model_copy(update=change)})
    return scene.model_copy(update={"shapes": shapes, "materials": materials})


def from_course(args: Namespace) -> ImportedScene:
    """Read a file of MIT 6.837. The window of an orthographic camera is moved back if something is behind it."""
    if args.define:
        raise SceneError(f"-D {args.define[0]}: a text of MIT 6.837 has no parameters")
    size = args.size or COURSE_FILM
    check_film_size("--size", *size)
    course = load_course_scene(args.file, *size, mesh_dirs=args.mesh_dir)
    scene, back = with_window_behind_scene(course.scene)
    where = f"{args.file}:1:1: left out: "
    moved = f"rays from infinitely far: the window stands {back:g} farther back, and depths count from there"
    color = " ".join(f"{c:g}" for c in course.background)
    notes = [f"{where}the background color {color}: ours is black"] if any(course.background) else []
    notes += [where + moved] if back else []
    return ImportedScene(scene, (*course.left_out, *notes))


def files_of(scene: Scene) -> list[str]:
    """The files of its shapes."""
    return [file for shape in scene.shapes if (file := getattr(shape, "file", None))]


def run_export(args: Namespace) -> int:
    """Write the files and print their names. Raises SceneError, FileMissing, OutputError."""
    scene = load_scene_or_original(args)
    exported = export_scene(scene)
    inputs = files_of(scene)
    for target in (os.path.join(args.output, name) for name in exported.meshes):
        if os.path.exists(target) and any(os.path.samefile(target, file) for file in inputs if os.path.exists(file)):
            raise SceneError(f"-o {args.output}: expected another folder: the scene reads {target}")
    folder = Path(args.output)
    path = exported.write(folder)
    print(f"{path}: {len(scene.shapes)} shapes, {len(exported.meshes)} mesh files")
    if args.toml:
        home = folder.resolve()  # so that the scene names its meshes relative to itself
        write_text(folder / "scene.toml", to_toml(scene_as_traced(scene, packed_float32(scene), home), home))
        print(f"{folder / 'scene.toml'}: the same with the float32 values that are traced")
    for note in exported.notes:
        print_lines(f"note: {note}")
    return OK
